"""`skewmi deploy --live`: a view or a viewer that dies or hangs never disturbs the deployment."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from drawn import rows
from live_views import PATIENT_MS, Scripted, about_the_view, gathering_viewer
from tiny_disk import tiny_disk

from skewmi.deploy import run as deploy_run
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.replay.live import LiveView
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.deploy.session.timing import BUSY_ADVICE


def watched(monkeypatch: pytest.MonkeyPatch) -> list[LiveView]:
    """Live views that deployments open from now on."""
    views: list[LiveView] = []

    class Watched(LiveView):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            views.append(self)

    monkeypatch.setattr(deploy_run, "LiveView", Watched)
    return views


def wait_for_actions(shown: Path) -> None:
    """Until a view has drawn some."""
    deadline = time.monotonic() + 60.0
    while True:
        # It is being written.
        with contextlib.suppress(Exception):
            if rows(shown).get("/policy/action/fields", 0) >= 5:
                return
        assert time.monotonic() < deadline, "nothing is drawn"
        time.sleep(0.2)


@pytest.mark.parametrize(
    ("lock_step", "number", "steps", "note"),
    [
        pytest.param(True, signal.SIGKILL, 40, "ended early", id="lock-step-killed"),
        pytest.param(True, signal.SIGSTOP, 40, "hung", id="lock-step-hung"),
        pytest.param(
            False, signal.SIGKILL, 40, "ended early", id="real time-killed", marks=pytest.mark.slow
        ),
        # Long enough that it is ended while the arm moves.
        pytest.param(False, signal.SIGSTOP, 80, "hung", id="real time-hung"),
    ],
)
def test_view_that_dies_or_hangs_leaves_the_run_alone(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    request: pytest.FixtureRequest,
    lock_step: bool,
    number: signal.Signals,
    steps: int,
    note: str,
) -> None:
    views = watched(monkeypatch)

    def strike() -> None:
        if lock_step:  # the arm waits meanwhile
            wait_for_actions(shown)
        os.kill(views[-1].pid, number)

    robot = request.getfixturevalue("lock_step_robot" if lock_step else "robot")
    for attempt in range(3):
        shown = tmp_path / f"live{attempt}.rrd"
        options = DeployOptions(
            connect=robot,
            lock_step=lock_step,
            lead_ms=PATIENT_MS,
            live=LiveOptions(out=shown),
        )
        report = deploy_run.run_deploy(Scripted(steps, 20, strike), options)
        (episode,) = report.episodes
        # A busy computer may stop a run in real time, whatever its view does.
        if BUSY_ADVICE not in episode.reason:
            break
    assert (episode.steps, "enough" in episode.reason) == (steps, True), episode
    (told,) = about_the_view(report)
    assert note in told
    assert (report.files, report.broken_files) == ([], [str(shown)])
    if lock_step:  # what was drawn remains
        assert rows(shown)["/policy/action/fields"] >= 5


def test_file_for_which_there_is_no_room_is_not_whole(lock_step_robot: str, tmp_path: Path) -> None:
    with tiny_disk(tmp_path / "disk", "256k") as disk:
        shown = disk / "live.rrd"
        options = DeployOptions(
            connect=lock_step_robot, lock_step=True, live=LiveOptions(out=shown)
        )
        report = deploy_run.run_deploy(Scripted(40), options)
    assert report.episodes[0].steps == 40, report.as_dict()
    assert (report.files, report.broken_files) == ([], [str(shown)])
    (told,) = about_the_view(report)
    assert "No space left" in told
    assert str(shown) in told


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(signal.SIGKILL, id="killed", marks=pytest.mark.slow),
        pytest.param(signal.SIGSTOP, id="hung"),
    ],
)
def test_viewer_that_dies_or_hangs_leaves_the_run_alone(
    robot: str, tmp_path: Path, number: signal.Signals
) -> None:
    kept, steps = tmp_path / "live.rrd", 40
    with gathering_viewer(tmp_path / "viewer.rrd") as (url, child):
        policy = Scripted(steps, 15, lambda: child.send_signal(number))
        live = LiveOptions(connect=url, out=kept)
        started = time.monotonic()
        report = deploy_run.run_deploy(
            policy, DeployOptions(connect=robot, live=live, lead_ms=PATIENT_MS)
        )
        took_s = time.monotonic() - started
    assert report.episodes[0].steps == steps, report.as_dict()
    assert took_s < 150.0
    assert all("live view" in note for note in about_the_view(report))
    # The file beside the viewer is whole all the same, up to the last drawing: that one may be
    # under way when the view of a hung viewer is given up.
    assert steps - 10 <= rows(kept)["/policy/action/fields"] <= steps, report.notes
