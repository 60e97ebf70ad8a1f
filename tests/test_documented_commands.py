"""Every command line of README and pages is one that the program takes, flags and values alike."""

from __future__ import annotations

import importlib
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import skewmi
from skewmi.cli.main import COMMANDS, main

ROOT = Path(skewmi.__file__).parents[1]
PAGES = (
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "examples").rglob("*.py")),
)
ENDS = re.compile(r"\s(?:#|&&|\||>|;)(?:\s|$)|;")


def commands_of(page: Path) -> list[str]:
    """The lines of its code blocks that run `skewmi`, without comments; continued lines joined.

    Of an example, the lines of its docstring.
    """
    found = []
    blocks = r'"""(.*?)"""' if page.suffix == ".py" else r"```[a-z]*\n(.*?)```"
    for block in re.findall(blocks, page.read_text(), flags=re.DOTALL):
        for line in re.sub(r"\\\n\s*", " ", block).splitlines():
            text = line.strip().removeprefix("$ ").removeprefix(".venv/bin/")
            # The task of examples/press_button_task has to be installed first.
            if text.startswith("skewmi ") and "..." not in text and "press_button" not in text:
                found.append(ENDS.split(text)[0].strip())
    return found


LINES = [
    pytest.param(line, id=f"{page.name}: {line}")
    for page in PAGES
    for line in dict.fromkeys(commands_of(page))
]


def test_pages_have_command_lines() -> None:
    assert len(LINES) > 50


@pytest.mark.parametrize("line", LINES)
def test_command_line_is_taken(
    line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, *arguments = shlex.split(line)
    name = arguments[0]
    if name.startswith("-"):
        return
    assert name in COMMANDS
    stem = name.replace("-", "_")
    taken = []
    module = importlib.import_module(f"skewmi.cli.{stem}")
    monkeypatch.setattr(module, f"run_{stem}", lambda options: taken.append(options) or 0)
    try:
        code = main(arguments)
    except SystemExit as error:
        # --help ends so, and so does a command line that is refused.
        code = int(error.code or 0)
        taken.append(None)
    told = capsys.readouterr().err
    # What a command line goes on from is not there, but it was understood.
    assert code == 0 or "is no run directory" in told, told
    assert taken or code


@pytest.mark.slow
def test_readmes_python_runs(tmp_path: Path) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    (tmp_path / "example.py").write_text(block)
    done = subprocess.run(
        [sys.executable, "example.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1.0", "1"]
