"""Records of training runs, their picture, and the document that aggregates several."""

from __future__ import annotations

import json
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.colors import to_hex
from PIL import Image

from skewmi.cli.main import main
from skewmi.cli.train_options import starting_config
from skewmi.errors import CheckpointError
from skewmi.evaluation import learning
from skewmi.evaluation.learning import RunRecord, draw_learning, median_curve, read_record
from skewmi.sim import tasks
from skewmi.train.config import TrainConfig
from skewmi.train.run import run_train

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "open_press_close.py"
STEPS = 800


def read_picture(path: Path) -> Any:
    """Its values. Shape (height, width, channels)."""
    with Image.open(path) as image:
        return np.asarray(image)


def short(seed: int) -> TrainConfig:
    """Two iterations of two environments."""
    config = starting_config("open_press_close", "improved")
    rollout = replace(config.rollout, num_envs=2, evaluation_envs=1)
    return replace(config, seed=seed, rollout=rollout, total_steps=STEPS)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    torch.set_num_threads(1)
    folders = []
    for seed in (4, 3):
        config = short(seed)
        env = tasks.make_batch(
            config.task, 2, num_threads=1, seed=seed, **dict[str, Any](config.task_options)
        )
        folders.append(tmp_path_factory.mktemp("press") / f"s{seed}")
        run_train(config, env, folders[-1], progress=False)
    return folders


@pytest.mark.parametrize("count", [1, 6, 7, 12, 30])
def test_no_two_runs_have_one_colour(count: int) -> None:
    colours = {to_hex(colour) for colour in learning._colours(count)}
    assert len(colours) == count


def with_curve(record: RunRecord, curve: dict[int, float]) -> RunRecord:
    table = {"trajectories": [float(x) for x in curve], "evaluation_fraction": list(curve.values())}
    return replace(record, table=table)


def test_record_is_what_the_run_did(runs: list[Path]) -> None:
    record = read_record(runs[0])
    assert record.config == short(4)
    assert record.trajectories == 4
    assert record.converged_at is None
    assert set(record.discoveries) >= {"button pressed", "reward"}
    assert record.discoveries["reward"] is None
    x, y = record.curve
    assert x.tolist() == [2.0, 4.0]
    assert y.tolist() == [0.0, 0.0]
    first = record.seconds_at(2)
    assert first is not None
    assert 0.0 < first < record.seconds
    assert record.seconds_at(3) == record.seconds_at(4) == record.seconds
    assert record.seconds_at(5) is None


def test_median_curve_holds_ended_runs_and_skips_gaps(runs: list[Path]) -> None:
    record = read_record(runs[0])
    curves = [
        {10: 0.0, 20: 1.0},
        {10: 0.0, 20: float("nan"), 30: 0.5},
        {20: 0.2, 40: 0.4},
    ]
    grid, share = median_curve([with_curve(record, curve) for curve in curves])
    assert grid.tolist() == [10.0, 20.0, 30.0, 40.0]
    # At 10 the third run counts with its first value.
    assert share.tolist() == [0.0, 0.2, 0.5, 0.5]


@pytest.mark.parametrize(
    ("changed", "converged_at", "held"),
    [
        ({}, None, False),
        ({"total_steps": STEPS // 2}, None, True),
        ({"stop_on_convergence": True}, None, False),
        ({"stop_on_convergence": True}, 3, True),
        ({"stop_on_convergence": False}, 3, False),
        ({"minutes": 1.0}, None, True),
    ],
)
def test_median_curve_holds_no_run_that_goes_on(
    runs: list[Path], changed: dict[str, Any], converged_at: int | None, held: bool
) -> None:
    """Of a run at half its steps: whether its last value counts beyond it."""
    record = read_record(runs[0])
    short = replace(
        with_curve(record, {10: 0.0, 20: 0.0}),
        config=replace(record.config, **changed),
        state={**record.state, "step": STEPS // 2, "converged_at": converged_at},
    )
    ended = with_curve(record, {10: 1.0, 20: 1.0, 30: 1.0})
    grid, share = median_curve([short, ended])
    assert grid.tolist() == [10.0, 20.0, 30.0]
    assert share.tolist() == [0.5, 0.5, 0.5 if held else 1.0]


def test_figures_of_an_arm_run_show_learning(
    runs: list[Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["figures", str(runs[0]), "--out", str(tmp_path), "--json"]) == 0
    files = json.loads(capfd.readouterr().out)["files"]
    assert [Path(file).name for file in files] == ["curves.png", "learning.png", "coverage.png"]
    records = [read_record(run) for run in runs]
    alone, both = (
        read_picture(draw_learning(chosen, tmp_path / "again.png", 100))
        for chosen in (records[:1], records)
    )
    assert alone.shape == both.shape
    assert (alone != both).any()
    # Marks in the colour of the second run, which the first does not have.
    second = np.array([0xE0, 0xA1, 0x3C])
    near = [(np.abs(p[..., :3].astype(int) - second).sum(-1) < 12).sum() for p in (alone, both)]
    assert near[1] > near[0] + 20


def test_a_run_without_a_checkpoint_is_refused(runs: list[Path], tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text((runs[0] / "config.json").read_text())
    with pytest.raises(CheckpointError, match=r"no readable metrics\.csv"):
        read_record(tmp_path)


def benchmark(
    *arguments: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> tuple[int, str, str]:
    """Exit code and what is said; in this process, because importing torch takes seconds."""
    monkeypatch.setattr(sys, "argv", [str(BENCHMARK), *arguments])
    monkeypatch.syspath_prepend(BENCHMARK.parent)
    capfd.readouterr()
    try:
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(BENCHMARK), run_name="__main__")
    finally:
        sys.modules.pop("common", None)
    code = ended.value.code
    assert isinstance(code, int)
    return code, *capfd.readouterr()


def test_document_keeps_failures(
    runs: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "result.json"
    arguments = ["--runs", *map(str, runs), "--episodes", "2", "--out", str(out), "--json"]
    arguments += ["--concurrent", "2"]
    code, said, error = benchmark(*arguments, monkeypatch=monkeypatch, capfd=capfd)
    assert code == 0, error
    document = json.loads(said)
    assert document == json.loads(out.read_text())
    assert (document["converged_runs"], document["runs_in_all"]) == (0, 2)
    assert document["medians"]["converged_after_trajectories"] is None
    assert document["medians"]["first_discoveries"]["reward"] is None
    assert document["timing"]["runs_side_by_side"] == 2
    for seed, run in zip((3, 4), document["runs"], strict=True):
        assert run["seed"] == seed
        assert run["environment_steps"] == STEPS
        assert run["converged_after_seconds"] is None
        assert run["evaluation"]["episodes"] == 2
        assert run["evaluation"]["success_rate"] == 0.0
        assert run["evaluation"]["contact"]["hand_force_peak_n"]["max"] >= 0.0
        assert run["variation"] == "nominal"
    assert read_picture(tmp_path / "result.png").std() > 5.0


def test_runs_that_do_not_belong_together_are_refused(
    runs: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    arguments = ("--runs", str(runs[0]), str(runs[0]), "--out", str(tmp_path / "x.json"))
    code, _, error = benchmark(*arguments, monkeypatch=monkeypatch, capfd=capfd)
    assert code == 2
    assert "repeat" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "x.json").exists()
