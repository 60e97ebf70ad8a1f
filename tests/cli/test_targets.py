"""A target named on the command line: chosen, kept by the run, found by a policy's layout."""

from __future__ import annotations

from pathlib import Path

import pytest

from skewmi.cli.main import main
from skewmi.cli.policies import task_options
from skewmi.errors import ConfigurationError
from skewmi.sim import tasks
from skewmi.train.checkpoint import read_run_header
from skewmi.train.policy import load_policy


def test_the_name_of_a_target_needs_no_quotes() -> None:
    for text in ("target=t2", 'target="t2"'):
        assert task_options("door_open", None, (text,)) == {"target": "t2"}
    # Only that one: everything else is JSON.
    with pytest.raises(ConfigurationError, match="time_input=True"):
        task_options("door_open", None, ("time_input=True",))


@pytest.mark.parametrize("task", ["door_open", "point_maze"])
def test_a_policy_brings_its_target_with_its_layout(task: str) -> None:
    for name in tasks.find(task).targets[1:]:
        wanted = tasks.layout(task, target=name, time_input=True)
        assert task_options(task, wanted, ()) == {"target": name, "time_input": True}


def test_a_run_keeps_its_target(tmp_path: Path) -> None:
    run = tmp_path / "run"
    short = ["--num-envs", "2", "--steps", "400", "--quiet", "--option", "target=t2"]
    assert main(["train", "--task", "point_maze", "--run-dir", str(run), *short]) == 0
    config, layout = read_run_header(run)
    assert dict(config.task_options)["target"] == "t2"
    assert layout == tasks.layout("point_maze", target="t2", time_input=True)
    assert load_policy(run).layout == layout


def test_an_unknown_target_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    zero = ["evaluate", "--task", "point_maze", "--agent", "zero", "--episodes", "1"]
    assert main([*zero, "--option", "target=t9"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "no target 't9'; targets are t1, t2, t3, t4, t5" in line
