"""An excitation that is stopped or killed at any moment: the arm rests, and kept its limits."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest
from executed_limits import assert_kept, start_calibration, wait_for, wait_for_state

from skewmi.cli.main import main
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.wire.transport import TransportConfig


def start(robot: str, out: Path) -> subprocess.Popen[bytes]:
    return start_calibration(robot, "excite", "--seconds", "10", "--out", str(out))


@pytest.mark.slow
@pytest.mark.parametrize("phase", [b"moving to where", b"moving for", b"moving back"])
def test_a_killed_excitation_ends_at_rest_within_limits(
    robot: str, tmp_path: Path, phase: bytes
) -> None:
    path = tmp_path / "watched.mcap"
    with Recorder.start(path, TransportConfig.for_client(robot)) as recorder:
        child = start(robot, tmp_path / "own.mcap")
        wait_for(phase, child)
        # Ways take a second or two, the motion ten.
        longest = 6.0 if phase == b"moving for" else 1.0
        time.sleep(random.Random(str(tmp_path)).uniform(0.3, longest))
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        wait_for_state(robot, "disarmed")
        time.sleep(0.5)
    recorder.close()
    assert_kept(path, robot)


@pytest.mark.slow
def test_stopping_an_excitation_is_told(robot: str, tmp_path: Path) -> None:
    path = tmp_path / "watched.mcap"
    with Recorder.start(path, TransportConfig.for_client(robot)) as recorder:
        child = start(robot, tmp_path / "own.mcap")
        wait_for(b"moving for", child)
        time.sleep(1.0)
        assert main(["stop", "--connect", robot]) == 0
        assert child.wait(20.0) == 1
        wait_for_state(robot, "disarmed")
        time.sleep(0.5)
    recorder.close()
    assert_kept(path, robot)
    # What was recorded until then is a recording.
    assert read_recording(tmp_path / "own.mcap").complete
