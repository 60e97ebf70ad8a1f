"""`skewmi train` and `skewmi figures` as a user runs them, on the maze, for a few hundred steps."""

from __future__ import annotations

import json
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tiny_disk import tiny_disk

from skewmi.cli.main import main
from skewmi.cli.train_options import default_options
from skewmi.errors import ConfigurationError
from skewmi.train.checkpoint import read_run_header
from skewmi.train.history import visited_states
from skewmi.train.lock import only_training
from skewmi.train.log import read_metrics
from skewmi.train.presets import preset
from skewmi.train.runner import Runner
from skewmi.train.sac.config import SacConfig

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
    from PIL import Image

    assert main(["figures", str(run_dir), "--out", str(tmp_path), "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert [Path(f).name for f in files] == ["curves.png", "learning.png", "coverage.png"]
    for file in files:
        picture = np.asarray(Image.open(file))
        assert picture.shape[0] > 300
        assert picture[..., :3].std() > 5.0  # not one colour


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "--task", "door"], "point_maze"),
        (["train"], "no run directory"),
        (["train", "--task", "point_maze", "--steps", "0"], "--steps"),
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


def test_every_number_of_the_preset_has_a_flag(tmp_path, capsys) -> None:
    folder = tmp_path / "run"
    changes = ["--learner.n-step", "1", "--exploration.sigma", "1.5", "--learner.hidden", "16", "8"]
    changes += ["--exploration.trajectory-density", "whole", "--learner.no-layer-norm"]
    changes += ["--option", "time_input=false"]
    assert main(["train", "--run-dir", str(folder), *SHORT, *changes]) == 0
    config, _ = read_run_header(folder)
    base = preset("point_maze", "improved-return-then-explore")
    assert config.learner == replace(base.learner, n_step=1, hidden=(16, 8), layer_norm=False)
    assert config.exploration == replace(base.exploration, sigma=1.5, trajectory_density="whole")
    assert dict(config.task_options) == {"time_input": False}
    assert config.rollout == replace(base.rollout, num_envs=2, evaluation_envs=1)
    # What a run began with stays, and going on needs no flag of it.
    again = ["train", "--run-dir", str(folder), "--resume", "--quiet", "--steps", "1200"]
    assert main([*again, "--learner.n-step", "3", "--num-envs", "4"]) == 2
    assert "leave out --learner.n-step, --num-envs 4 (the run has 2)" in capsys.readouterr().err
    assert main([*again, "--learner.n-step", "1", "--num-envs", "2"]) == 0
    assert read_run_header(folder)[0] == replace(config, total_steps=1200)


@pytest.mark.parametrize("task", ["point_maze", "door_open", "open_press_close"])
def test_who_names_nothing_gets_return_then_explore(task: str) -> None:
    nothing = default_options(["--task", task]).numbers
    quickest = preset(task, "improved-return-then-explore")
    assert (nothing.learner, nothing.exploration) == (quickest.learner, quickest.exploration)
    assert nothing.rollout == quickest.rollout
    # It cannot be learned with PPO, and whoever names a part combines it with `improved`.
    combined = default_options(["--task", task, "--learner", "ppo"]).numbers
    assert combined.exploration == preset(task, "improved").exploration
    combined = default_options(["--task", task, "--exploration", "skew-fit"]).numbers
    assert combined.learner == preset(task, "improved").learner
    named = default_options(["--task", task, "--preset", "improved"]).numbers
    assert named.exploration == preset(task, "improved").exploration


def test_method_by_name_brings_its_own_numbers(tmp_path) -> None:
    begin = default_options(["--run-dir", "x", "--task", "point_maze", "--learner", "sac"])
    assert begin.numbers.learner == SacConfig()
    assert begin.numbers.exploration == preset("point_maze").exploration
    begin = default_options(["--task", "point_maze", "--preset=paper"])
    assert begin.numbers.learner == preset("point_maze", "paper").learner


def test_help_shows_the_presets_numbers(capsys) -> None:
    for name, batch in (("improved", "256"), ("paper", "1024")):
        with pytest.raises(SystemExit):
            main(["train", "--task", "point_maze", "--preset", name, "--help"])
        text = " ".join(capsys.readouterr().out.split())
        assert f"Transitions per update. (default: {batch})" in text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--learner.n-step", "0"], "needs at least 1"),
        (["--learner", "unheard-of"], "there are sac"),
        (["--exploration", "unheard-of"], "there are skew-explore"),
        (["--preset", "best"], "point_maze/improved"),
        (["--option", "no_such=1"], "no_such"),
        (["--option", "time_input"], "NAME=VALUE"),
        (["--option", "time_input=[1]"], "is not a number, a word or true or false"),
        (["--exploration.field-weights", "lid", "2"], "fields are"),
        (["--learner.learning-rate", "inf"], "learning_rate is inf, must be finite"),
        (["--learner.log-std-min", "3"], "must not be above log_std_max 2.0"),
        (["--exploration.field-weights", "x", "0"], "field_weights are {'x': 0.0}"),
        (["--rollout.noise-correlation", "2"], "noise_correlation is 2.0, must lie in [-1, 1]"),
        (["--option", "start_noise=NaN"], "nan"),
    ],
)
def test_settings_that_mean_nothing_are_refused(tmp_path, capsys, arguments, says) -> None:
    folder = tmp_path / "run"
    assert main(["train", "--run-dir", str(folder), *SHORT, *arguments]) == 2
    assert says in capsys.readouterr().err
    assert not folder.exists()


@pytest.mark.parametrize("arguments", [["--learner.n-steps", "1"], ["--learner.n-step", "one"]])
def test_flags_that_do_not_exist_are_refused(tmp_path, capsys, arguments: list[str]) -> None:
    folder = tmp_path / "run"
    with pytest.raises(SystemExit) as error:
        main(["train", "--run-dir", str(folder), *SHORT, *arguments])
    assert error.value.code == 2
    assert "learner.n-step" in capsys.readouterr().err
    assert not folder.exists()


def test_what_a_run_began_with_cannot_be_changed(run_dir: Path, tmp_path, capsys) -> None:
    arguments = ["train", "--run-dir", str(tmp_path / "x"), "--start-from", str(run_dir)]
    assert main([*arguments, "--num-envs", "3", "--quiet"]) == 2
    assert "leave out" in capsys.readouterr().err
    assert main([*arguments[:-1], str(tmp_path / "none"), "--quiet"]) == 2
    assert "none" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def resumes(run_dir: Path, *options: str) -> int:
    arguments = ["train", "--run-dir", str(run_dir), "--resume", "--steps", "800", "--quiet"]
    return main([*arguments, *options])


@pytest.mark.parametrize(
    ("flag", "other", "own"),
    [
        ("--task", "open_press_close", "point_maze"),
        ("--preset", "paper", "improved-return-then-explore"),
        ("--seed", "7", "5"),
        ("--seed", "0", "5"),
        ("--num-envs", "25", "2"),
        ("--threads", "2", "1"),
        ("--device", "cuda", "cpu"),
        ("--start-from", "elsewhere", "none"),
    ],
)
def test_resume_refuses_what_the_run_did_not_begin_with(
    flag: str, other: str, own: str, run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (run_dir / "config.json").read_bytes()
    assert resumes(run_dir, flag, other) == 2
    assert f"{flag} {other} (the run has {own})" in capsys.readouterr().err
    assert (run_dir / "config.json").read_bytes() == before


def test_the_command_line_that_started_a_run_resumes_it(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = ["--learner.n-step", "2", "--option", "start_noise=0.1", "--learner", "sac"]
    more = ["--seed", "3", "--threads", "1", "--device", "cpu", "--preset", "improved"]
    line = ["train", "--run-dir", str(tmp_path / "run"), *SHORT, *numbers, *more]
    assert main(line) == 0
    assert main([*line, "--resume"]) == 0
    assert main([*line, "--resume", "--option", "start_noise=0.2"]) == 2
    assert "the run has 0.1" in capsys.readouterr().err
    from_it = ["train", "--run-dir", str(tmp_path / "on"), "--start-from", str(tmp_path / "run")]
    assert main([*from_it, "--steps", "1200", "--quiet", "--seed", "4"]) == 0
    assert main([*from_it, "--steps", "1600", "--quiet", "--seed", "4", "--resume"]) == 0


def test_a_run_from_another_that_died_at_once_begins_with_it_again(
    run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    other, folder = tmp_path / "other", tmp_path / "run"
    shutil.copytree(run_dir, other)
    line = ["train", "--run-dir", str(folder), "--start-from", str(other), "--quiet", "--resume"]
    with monkeypatch.context() as patched:
        patched.setattr(Runner, "iterate", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        assert main([*line, "--steps", "1600"]) == 130
    assert "other" in (folder / "config.json").read_text()
    assert main(["train", "--run-dir", str(folder), "--resume", "--steps", "1600"]) == 2
    assert "--start-from" in capsys.readouterr().err
    assert main([*line, "--steps", "1600"]) == 0
    assert read_metrics(folder)["step"][0] > read_metrics(other)["step"][-1]


def test_two_trainings_do_not_share_a_directory(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run_dir, folder)
    with only_training(folder):
        assert resumes(folder) == 2
        assert str(os.getpid()) in capsys.readouterr().err
    assert resumes(folder) == 0


def test_a_refused_start_leaves_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with pytest.raises(ConfigurationError), only_training(folder):
        raise ConfigurationError("no")
    assert not folder.exists()


def test_full_disk_and_broken_tensorboard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with tiny_disk(tmp_path / "disk", "300k") as disk:
        line = ["train", "--run-dir", str(disk / "run"), *SHORT]
        assert main(line) == 2
        error = capsys.readouterr().err
        assert "No space left" in error or "StorageFull" in error
        assert str(disk / "run") in error
        assert "Traceback" not in error
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", SimpleNamespace(SummaryWriter=1))
    with pytest.warns(UserWarning, match="TensorBoard"):
        assert main(["train", "--run-dir", str(tmp_path / "run"), *SHORT]) == 0


def test_run_directory_that_cannot_be_made(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--run-dir", "/proc/none/a", *SHORT]) == 2
    assert "cannot write /proc/none/a" in capsys.readouterr().err
