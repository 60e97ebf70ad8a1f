"""Deployment needs nothing that extras bring: it runs and records where no module of theirs is."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from skewmi.extras import MODULES

ROOT = Path(__file__).parents[2]
OF_EXTRAS = sorted({module for modules in MODULES.values() for module in modules} | {"imageio"})
"""By import name. scipy comes with mink's solvers, too, which a deployment does not load."""
DEPLOY = "deploy open_press_close --robot sim --episodes 1 --seed 0 --lock-step --json"

# Refuses by name, before any finder looks: an installed torch is as absent as a missing one.
WITHOUT = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {modules!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}} (refused)", name=name)
sys.meta_path.insert(0, Refuse())
"""


def skewmi(python: str | Path, arguments: list[str], folder: Path, env: dict[str, str]) -> str:
    """Standard output of a `skewmi` command that must succeed."""
    code = "import sys; from skewmi.cli.main import main; sys.exit(main())"
    done = subprocess.run(
        [str(python), "-c", code, *arguments],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def deploy(python: str | Path, folder: Path, env: dict[str, str]) -> None:
    """Deploy, record and look at the recording with what needs no view."""
    out = skewmi(
        python,
        [*DEPLOY.split(), "--record", "run.mcap"],
        folder,
        env,
    )
    report = json.loads(out)
    assert (report["episodes"], report["successes"], report["faulted"]) == (1, 1, False)
    assert report["stops"] == []
    shares = report["limit_fractions"]
    assert all(0.0 < shares[name] <= 1.0 for name in ("velocity", "acceleration", "jerk"))
    told = json.loads(skewmi(python, ["info", "run.mcap", "--json"], folder, env))
    assert told["complete"]
    assert told["messages"]["/yumi/joint_states"] > 100


def refused(python: str | Path, arguments: list[str], folder: Path, env: dict[str, str]) -> str:
    """What a `skewmi` command says that needs an extra."""
    code = "import sys; from skewmi.cli.main import main; sys.exit(main())"
    done = subprocess.run(
        [str(python), "-c", code, *arguments],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.strip().splitlines()
    return line


def test_deploys_and_records_where_nothing_of_an_extra_can_be_imported(tmp_path: Path) -> None:
    # sitecustomize, so that the simulated robot and the recorder, processes of their own, are
    # under the same ban.
    ban = tmp_path / "ban"
    ban.mkdir()
    (ban / "sitecustomize.py").write_text(WITHOUT.format(modules=OF_EXTRAS))
    env = os.environ | {"PYTHONPATH": os.pathsep.join((str(ban), str(ROOT)))}
    for module in OF_EXTRAS:
        done = subprocess.run(
            [sys.executable, "-c", f"import {module}"], env=env, capture_output=True, text=True
        )
        assert "refused" in done.stderr
    work = tmp_path / "elsewhere"
    work.mkdir()
    deploy(sys.executable, work, env)
    install = f"pip install -e '{ROOT}[view]'"
    for command in (
        ["replay", "run.mcap"],
        ["export-dataset", "run.mcap", "--out", "set"],
        ["deploy", "open_press_close", "--live-out", "run.rrd"],
    ):
        line = refused(sys.executable, command, work, env)
        assert line.endswith(install), line
        assert "(extra 'view')" in line
    assert sorted(path.name for path in work.iterdir()) == ["run.mcap"]


@pytest.mark.slow
def test_deploys_from_a_fresh_environment_without_extras(tmp_path: Path) -> None:
    environment = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True, timeout=120)
    python = environment / "bin" / "python"
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    install = subprocess.run(
        [str(python), "-m", "pip", "install", "-q", str(ROOT)],
        env=env,
        capture_output=True,
        text=True,
        timeout=900,
    )
    if install.returncode and "Could not find a version" in install.stderr:
        probe = subprocess.run(
            [str(python), "-m", "pip", "download", "-q", "--no-deps", "-d", str(tmp_path), "tyro"],
            env=env,
            capture_output=True,
        )
        if probe.returncode:
            pytest.skip("no package index can be reached")
    assert install.returncode == 0, install.stderr
    for module in ("torch", "rerun", "matplotlib", "PIL"):
        absent = subprocess.run(
            [str(python), "-c", f"import {module}"], env=env, capture_output=True, text=True
        )
        assert f"No module named '{module}'" in absent.stderr
    work = tmp_path / "elsewhere"
    work.mkdir()
    where = subprocess.run(
        [str(python), "-c", "import skewmi; print(skewmi.__file__)"],
        cwd=work, env=env, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert str(environment) in where.stdout, "the installed package, not the checkout"
    deploy(python, work, env)
