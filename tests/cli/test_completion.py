"""Completion as a person gets it: a shell in a pseudo-terminal, and the tab key."""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import signal
import time
from pathlib import Path

import pytest

from skewmi.cli.completion_scripts import bash_script, fish_script, zsh_script
from skewmi.cli.completion_words import Entry, every_entry
from skewmi.cli.main import COMMANDS

SHELLS = {
    "bash": (["bash", "--norc", "--noprofile", "-i"], bash_script),
    "zsh": (["zsh", "-f", "-i"], zsh_script),
    "fish": (["fish", "--no-config", "-i"], fish_script),
}
_CONTROL = re.compile(r"\x1b\[[0-9;?=>]*[a-zA-Z]|\x1b[=>()][0-9A-B]?|[\x07\r]")


@pytest.fixture(scope="module")
def entries() -> list[Entry]:
    return every_entry()


class Shell:
    """A shell that believes to talk to a person.

    Args:
        name: Which.
        script: File with its completion.
    """

    def __init__(self, name: str, script: Path) -> None:
        self._pid, self._terminal = pty.fork()
        if not self._pid:
            command = SHELLS[name][0]
            environment = {**os.environ, "TERM": "xterm", "PS1": "> ", "COLUMNS": "200"}
            os.chdir(script.parent)
            os.execvpe(command[0], command, environment)
        self.type(f"source {script}; echo rea''dy\n", until="ready")

    def type(self, keys: str, until: str = "", seconds: float = 60.0) -> str:
        """What is shown after some keys, until certain words have come or nothing more does."""
        os.write(self._terminal, keys.encode())
        shown, deadline = "", time.monotonic() + seconds
        while time.monotonic() < deadline:
            if select.select([self._terminal], [], [], 0.2)[0]:
                try:
                    raw = os.read(self._terminal, 65536)
                except OSError:
                    break
                if b"\x1b[c" in raw or b"\x1b[0c" in raw:
                    os.write(self._terminal, b"\x1b[?1;2c")  # fish asks who we are
                shown += _CONTROL.sub("", raw.decode(errors="replace"))
            elif until in shown:
                return shown
        pytest.fail(f"no {until!r} after {keys!r}: {shown[-400:]!r}")

    def close(self) -> None:
        os.kill(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)
        os.close(self._terminal)


@pytest.mark.parametrize("name", SHELLS)
def test_tab_completes_commands_options_and_values(
    name: str, entries: list[Entry], tmp_path: Path
) -> None:
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed")
    script = tmp_path / f"skewmi.{name}"
    script.write_text(SHELLS[name][1](entries), encoding="utf-8")
    (tmp_path / "episodes.mcap").write_bytes(b"")
    shell = Shell(name, script)
    try:
        for keys, meant in (
            ("skewmi depl", "skewmi deploy"),
            ("skewmi calibrate sce", "skewmi calibrate scene"),
            ("skewmi calibrate scene --force", "--force-limit"),
            ("skewmi deploy --spe", "--speed"),
            ("skewmi deploy open_pr", "open_press_close"),
            ("skewmi deploy --robot egm-e", "egm-emulator"),
            ("skewmi home --to ho", "home --to home"),
            ("skewmi replay epis", "episodes.mcap"),
            ("skewmi certificates --ho", "--host"),
        ):
            shell.type(f"{keys}\t", until=meant)
            shell.type("\x15")
    finally:
        shell.close()


def test_every_command_has_its_own_options(entries: list[Entry]) -> None:
    by_command = {entry.command: entry for entry in entries}
    assert {command[0] for command in by_command if command} == set(COMMANDS)
    assert ("calibrate", "excite") in by_command
    names = {
        command: {name for flag in entry.flags for name in flag.names}
        for command, entry in by_command.items()
    }
    assert "--force-limit" in names["calibrate", "scene"]
    assert "--force-limit" not in names["calibrate", "excite"]
    assert "--episodes" in names[("deploy",)]
    assert "--episodes" not in names[("stop",)]
    assert all("--help" in flags for command, flags in names.items() if command)
