"""What a run reports, whatever becomes of its files."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from scripted_runs import FewSteps, give_up

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording import recorder as recorder_module
from skewmi.deploy.run import run_deploy


def test_what_happened_is_told_even_if_the_recording_is_lost(
    lock_step_robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorders = []

    class Watched(recorder_module.ListenerProcess):
        def __init__(self, *arguments) -> None:
            super().__init__(*arguments)
            recorders.append(self.process.pid)

    monkeypatch.setattr(recorder_module, "ListenerProcess", Watched)
    path = tmp_path / "run.mcap"

    def kill_and_give_up() -> None:
        os.kill(recorders[0], signal.SIGKILL)
        give_up()

    options = DeployOptions(connect=lock_step_robot, lock_step=True, record=path)
    report = run_deploy(FewSteps(5, kill_and_give_up), options)
    assert report.stops == ["enough"]
    assert report.broken_files == [str(path)]
    assert report.files == []
    assert any("stopped early" in note for note in report.notes)


def test_the_speed_that_is_reported_is_the_one_that_is_executed(lock_step_robot: str) -> None:
    report = run_deploy(
        FewSteps(3, give_up), DeployOptions(connect=lock_step_robot, lock_step=True, speed=0.9)
    )
    assert report.speed == pytest.approx(0.1 / 0.12)
    assert report.velocity_fraction == 0.9
    assert any("whole cycles" in note for note in report.notes)
