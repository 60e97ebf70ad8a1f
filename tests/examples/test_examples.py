"""The examples do what they say, each as a user starts it: a program in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from skewmi.deploy.policy import OnnxPolicy
from skewmi.sweep.sweep_file import parse_sweep

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MOST_LINES = 40
LONGER = {"press_button_task.py", "calibrate_and_deploy.sh"}
"""A whole task, and a whole way: they have their own bounds, or are read step by step."""


def run(*command: object, cwd: Path, **environment: str) -> str:
    """What a program prints that has to succeed."""
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        cwd=cwd,
        env={**os.environ, "MPLBACKEND": "Agg", **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def source_files() -> list[Path]:
    found = [path for path in EXAMPLES.rglob("*") if path.suffix in (".py", ".sh", ".ipynb")]
    return sorted(path for path in found if "build" not in path.parts)


def test_examples_are_short() -> None:
    files = [path for path in source_files() if path.suffix != ".ipynb"]
    assert len(files) >= 8
    for path in files:
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert lines <= MOST_LINES or path.name in LONGER, f"{path} has {lines} lines"


def test_every_example_is_in_the_table() -> None:
    table = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    for path in source_files():
        assert f"({path.relative_to(EXAMPLES)})" in table


def notebooks_code() -> str:
    """The notebook's code cells, one below the other."""
    notebook = json.loads((EXAMPLES / "first_look.ipynb").read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    for cell in cells:
        assert (cell["outputs"], cell["execution_count"]) == ([], None), "strip the outputs"
    return "\n\n".join("".join(cell["source"]) for cell in cells)


def test_the_notebook_is_small_and_has_no_outputs() -> None:
    compile(notebooks_code(), "first_look.ipynb", "exec")
    assert (EXAMPLES / "first_look.ipynb").stat().st_size < 20_000


@pytest.mark.slow
def test_the_notebooks_cells_run_in_order(tmp_path: Path) -> None:
    (tmp_path / "cells.py").write_text(notebooks_code(), encoding="utf-8")
    printed = run("cells.py", cwd=tmp_path)
    assert "1 of 1 succeeded" in printed


@pytest.mark.slow
def test_another_learner_trains_on_a_task(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3", reason="it is in the dev extra")
    # Too short to learn anything: an episode's goals, hindsight, updates and evaluation are passed.
    printed = run(EXAMPLES / "gymnasium_sb3.py", 1_050, cwd=tmp_path, OMP_NUM_THREADS="1")
    assert "goals reached: " in printed


@pytest.mark.slow
def test_a_policy_of_ones_own_is_exported_and_deployed(tmp_path: Path) -> None:
    printed = run(EXAMPLES / "own_policy.py", cwd=tmp_path)
    assert "of 3 succeeded; stops: []" in printed
    assert OnnxPolicy.load(tmp_path / "own.onnx").metadata["method"] == "mine"


@pytest.mark.slow
def test_a_recording_becomes_data_frames(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas", reason="it is in the dev extra")
    record = ("deploy", "open_press_close", "--lock-step", "--record", "episode.mcap")
    run("-m", "skewmi.cli.main", *record, cwd=tmp_path)
    printed = run(EXAMPLES / "read_recording.py", "episode.mcap", "tables", cwd=tmp_path)
    assert "largest distance from the reference" in printed
    joints = pandas.read_parquet(tmp_path / "tables" / "joint_states.parquet")
    seen = pandas.read_parquet(tmp_path / "tables" / "observations.parquet")
    assert joints.index.name == "time_s"
    assert joints.shape[1] >= 8
    assert not joints.isna().any(axis=None)
    assert list(seen.columns) == list(OnnxPolicy.load("open_press_close").layout.observation_names)


@pytest.mark.slow
def test_a_sweep_runs_on_two_nodes(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="it is in the cluster extra")
    pandas = pytest.importorskip("pandas", reason="it is in the dev extra")
    try:
        run(EXAMPLES / "sweep_on_ray.py", "ray", cwd=tmp_path)
    except AssertionError as error:
        if "timed out during startup" in str(error):
            pytest.skip("a node of Ray's was not up within Ray's own 30 s: the computer is busy")
        raise
    results = pandas.read_csv(tmp_path / "ray" / "sweep" / "results.csv")
    assert sorted(results["seed"]) == [0, 1]
    assert set(results["state"]) == {"done"}


def test_the_sweep_is_one_that_is_taken() -> None:
    """The file that the example writes, where there is no Ray."""
    text = (EXAMPLES / "sweep_on_ray.py").read_text(encoding="utf-8")
    (group,) = parse_sweep(text.split('"""')[3], "maze.yaml").groups
    assert (group.tasks, group.seeds) == (("point_maze",), (0, 1))
