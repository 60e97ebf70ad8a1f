"""`skewmi train --live`: shows what the run's directory holds, and never holds the training up."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from drawn import document, drawn, rows
from live_views import gathering_viewer
from small_files import files_at_most

from skewmi.cli import train_live
from skewmi.cli.main import main
from skewmi.cli.train_live import LiveTraining
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.deploy.robot.process import free_port
from skewmi.errors import ConfigurationError
from skewmi.train.history import visited_states
from skewmi.train.log import read_metrics

SHORT = ["--task", "point_maze", "--num-envs", "2", "--steps", "1200", "--quiet"]


def train(run_dir: Path, *options: str) -> int:
    return main(["train", "--run-dir", str(run_dir), *SHORT, *options])


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A run, and what its live view wrote."""
    folder = tmp_path_factory.mktemp("live")
    assert train(folder / "run", "--live-out", str(folder / "run.rrd")) == 0
    return folder / "run", folder / "run.rrd"


def test_what_is_drawn_is_the_run(shown: tuple[Path, Path]) -> None:
    run_dir, view = shown
    table = read_metrics(run_dir)
    for path, name in (("/success", "rewarded_fraction"), ("/coverage", "covered_cells")):
        np.testing.assert_allclose(drawn(view, f"{path}/{name}")[:, 0], table[name])
    assert rows(view)["/states/x_y/visited"] >= 1
    assert "where the exploration would go" in document(view, "/legend")


def test_drawn_points_are_visited_states(shown: tuple[Path, Path]) -> None:
    """Each is one of the run's, in percent of its field's range, the second axis upwards."""
    from rerun.chunk import RrdReader

    run_dir, view = shown
    states, _ = visited_states(run_dir)
    found = []
    for chunk in RrdReader(view).stream().to_chunks():
        if str(chunk.entity_path) == "/states/x_y/visited" and not chunk.is_static:
            batch = chunk.to_record_batch()
            (name,) = [name for name in batch.schema.names if name.endswith("positions")]
            found += [point for row in batch.column(name).to_pylist() for point in row]
    points = np.array(found)
    # Fields of the maze: x in -12..4 m, y in -6..6 m.
    low, high = np.array([-12.0, -6.0]), np.array([4.0, 6.0])
    visited = 100.0 * (states[:, 1:].reshape(-1, 2) - low) / (high - low) * (1.0, -1.0)
    nearest = np.abs(points[:, None] - visited[None]).max(2).min(1)
    assert len(points) > 100
    assert nearest.max() < 1e-3


def test_a_run_that_goes_on_shows_its_past(shown: tuple[Path, Path], tmp_path: Path) -> None:
    run_dir, _ = shown
    out = tmp_path / "again.rrd"
    arguments = ["train", "--run-dir", str(run_dir), "--resume", "--steps", "1600", "--quiet"]
    assert main([*arguments, "--live-out", str(out)]) == 0
    assert len(drawn(out, "/success/rewarded_fraction")) == 4


def test_a_later_look_shows_what_the_live_view_showed(
    shown: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    run_dir, view = shown
    out = tmp_path / "later.rrd"
    assert main(["replay", str(run_dir), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rrd"] == str(out)
    assert told["iterations"] == len(drawn(out, "/success/rewarded_fraction"))
    before = drawn(view, "/coverage/covered_cells")
    np.testing.assert_array_equal(drawn(out, "/coverage/covered_cells")[: len(before)], before)
    assert main(["replay", str(tmp_path)]) == 2
    assert "no run directory" in capsys.readouterr().err


def test_a_later_look_that_cannot_be_finished_leaves_the_old_file(
    shown: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = tmp_path / "later.rrd"
    arguments = ["replay", str(shown[0]), "--out", str(out), "--overwrite"]
    assert main(arguments) == 0
    before = out.read_bytes()
    # The last that is written is a table of some kB.
    with files_at_most(len(before) - 500):
        assert main(arguments) == 2
    assert f"skewmi replay: cannot write {out}: File too large" in capsys.readouterr().err
    assert out.read_bytes() == before


def test_files_are_not_overwritten_unless_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    there = tmp_path / "there.rrd"
    there.write_bytes(b"precious")
    assert train(tmp_path / "run", "--live-out", str(there)) == 2
    assert "exists" in capsys.readouterr().err
    assert there.read_bytes() == b"precious"
    assert not (tmp_path / "run").exists()


def test_places_that_cannot_be_shown_at_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    nobody = f"rerun+http://127.0.0.1:{free_port()}/proxy"
    for arguments, complaint in (
        (["--live-connect", nobody], "no Rerun viewer listens"),
        (["--live-connect", nobody, "--live"], "not both"),
    ):
        assert train(tmp_path / "run", *arguments) == 2
        error = capsys.readouterr().err
        assert complaint in error
        assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_view_that_dies_or_hangs_costs_the_training_nothing(
    how: signal.Signals,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    monkeypatch.setattr(train_live, "_CLOSE_TIMEOUT_S", 1.0)
    start = LiveTraining.start.__func__

    def started_and_hit(
        cls: type[LiveTraining], options: LiveOptions, run_dir: Path
    ) -> LiveTraining:
        view = start(cls, options, run_dir)
        os.kill(view.process.pid, how)
        return view

    monkeypatch.setattr(LiveTraining, "start", classmethod(started_and_hit))
    assert train(tmp_path / "run", "--live-out", str(tmp_path / "run.rrd")) == 0
    assert "the live view" in capsys.readouterr().err
    assert read_metrics(tmp_path / "run")["step"] == [400.0, 800.0, 1200.0]


def test_a_viewer_that_hangs_costs_the_training_nothing(tmp_path: Path) -> None:
    with gathering_viewer(tmp_path / "viewer.rrd") as (url, child):
        with LiveTraining.start(LiveOptions(connect=url), tmp_path / "run") as view:
            child.send_signal(signal.SIGSTOP)
            assert train(tmp_path / "run") == 0
            view.close()
        assert view.process.poll() is not None
    assert len(read_metrics(tmp_path / "run")["step"]) == 3


def test_a_view_ends_with_whoever_started_it(tmp_path: Path) -> None:
    """Its end of the pipe closes, even if nobody says good-bye."""
    view = LiveTraining.start(LiveOptions(out=tmp_path / "x.rrd"), tmp_path / "run")
    assert view.process.stdin is not None
    with contextlib.suppress(OSError):
        view.process.stdin.close()
    deadline = time.monotonic() + 60.0
    while view.process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert view.close() == ""


def test_a_view_of_nowhere_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no live view"):
        LiveTraining.start(
            LiveOptions(connect=f"rerun+http://127.0.0.1:{free_port()}/proxy"), tmp_path / "run"
        )
