"""`skewmi train` and `skewmi figures` as a user runs them, on the maze, for a few hundred steps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from skewmi.cli.main import main
from skewmi.train.history import visited_states
from skewmi.train.log import read_metrics

SHORT = ["--task", "point_maze", "--num-envs", "2", "--steps", "800", "--quiet"]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "maze"
    assert main(["train", "--run-dir", str(folder), *SHORT, "--seed", "5"]) == 0
    return folder


def test_json_is_one_document(tmp_path, capsys) -> None:
    assert main(["train", "--run-dir", str(tmp_path / "run"), *SHORT, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["steps"] == 800
    assert result["trajectories"] == 4
    assert result["stopped_by"] == "steps"


def test_resume_needs_only_the_directory(run_dir: Path, capsys) -> None:
    arguments = ["train", "--run-dir", str(run_dir), "--resume", "--steps", "1200", "--json"]
    assert main([*arguments, "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["trajectories"] == 6
    assert read_metrics(run_dir)["step"] == [400.0, 800.0, 1200.0]


def test_visited_states_are_the_mazes(run_dir: Path) -> None:
    states, rewards = visited_states(run_dir)
    assert states.shape[1:] == (201, 2)
    assert rewards.shape == (*states.shape[:1], 200)
    np.testing.assert_allclose(states[:, 0], 0.0, atol=1e-6)  # every episode starts there
    # Steps of at most 0.12 m per axis.
    assert np.abs(np.diff(states, axis=1)).max() <= 0.12 + 1e-5


def test_figures_show_the_run(run_dir: Path, tmp_path, capsys) -> None:
    import imageio.v3 as iio

    assert main(["figures", str(run_dir), "--out", str(tmp_path), "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert [Path(f).name for f in files] == ["curves.png", "learning.png", "coverage.png"]
    for file in files:
        picture = iio.imread(file)
        assert picture.shape[0] > 300
        assert picture[..., :3].std() > 5.0  # not one colour


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "--task", "door"], "presets are"),
        (["train"], "no run directory"),
        (["train", "--task", "point_maze", "--steps", "0"], "total_steps"),
        (["figures"], "no run directory"),
    ],
)
def test_bad_input_is_one_line(tmp_path, capsys, arguments: list[str], message: str) -> None:
    place = [str(tmp_path / "run")] if arguments[0] == "figures" else [
        "--run-dir", str(tmp_path / "run"),
    ]  # fmt: skip
    assert main([*arguments, *place]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_run_is_not_overwritten(run_dir: Path, capsys) -> None:
    assert main(["train", "--run-dir", str(run_dir), *SHORT]) == 2
    assert "--resume" in capsys.readouterr().err


def test_numbers_of_the_preset_can_be_set(tmp_path, capsys) -> None:
    folder = tmp_path / "run"
    changes = ["--set", "sac.n_step=1", "skew.sigma=1.5", 'skew.trajectory_density="whole"']
    assert main(["train", "--run-dir", str(folder), *SHORT, *changes]) == 0
    config = json.loads((folder / "config.json").read_text())["config"]
    assert (config["sac"]["n_step"], config["skew"]["sigma"]) == (1, 1.5)
    assert config["skew"]["trajectory_density"] == "whole"
    again = ["train", "--run-dir", str(folder), "--resume", "--set", "sac.n_step=3", "--quiet"]
    assert main(again) == 2
    assert "leave --set out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("sac.n_steps=1", "it has hidden"),
        ("n_step=1", "SECTION.NAME=VALUE"),
        ("sac.n_step", "SECTION.NAME=VALUE"),
        ("sac.n_step=one", "not JSON"),
        ("sac.n_step=0", "needs at least 1"),
        ("task_options.no_such=1", "no_such"),
    ],
)
def test_settings_that_mean_nothing_are_refused(tmp_path, capsys, setting, says) -> None:
    folder = tmp_path / "run"
    assert main(["train", "--run-dir", str(folder), *SHORT, "--set", setting]) == 2
    assert says in capsys.readouterr().err
    assert not folder.exists()


def test_a_run_can_begin_with_another_ones_networks_and_replay(
    run_dir: Path, tmp_path, capsys
) -> None:
    folder = tmp_path / "second"
    begin = read_metrics(run_dir)["step"][-1]
    arguments = ["train", "--run-dir", str(folder), "--start-from", str(run_dir), "--seed", "6"]
    assert main([*arguments, "--steps", str(int(begin) + 400), "--json", "--quiet"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["steps"] == begin + 400
    config = json.loads((folder / "config.json").read_text())["config"]
    assert config["seed"] == 6
    assert config["started_from"] == f"{run_dir.name}, step {int(begin)}"
    ours, _ = visited_states(folder)
    theirs, _ = visited_states(run_dir)
    np.testing.assert_array_equal(ours[: len(theirs)], theirs)
    # It is a run of its own: it resumes without the other one.
    again = ["train", "--run-dir", str(folder), "--resume", "--steps", str(int(begin) + 800)]
    assert main([*again, "--quiet"]) == 0


def test_what_a_run_began_with_cannot_be_changed(run_dir: Path, tmp_path, capsys) -> None:
    arguments = ["train", "--run-dir", str(tmp_path / "x"), "--start-from", str(run_dir)]
    assert main([*arguments, "--num-envs", "3", "--quiet"]) == 2
    assert "leave out" in capsys.readouterr().err
    assert main([*arguments[:-1], str(tmp_path / "none"), "--quiet"]) == 2
    assert "none" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
