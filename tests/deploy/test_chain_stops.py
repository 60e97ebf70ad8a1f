"""The whole chain, stopped, interrupted, killed and silenced: the arm rests within its limits."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from robot_servers import describe
from scripted_runs import Scripted
from sent_motion import assert_limits_kept, chunks_of

from skewmi.child import child_command
from skewmi.cli.main import main
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import (
    decode_joint_states,
    decode_status,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.policy_io import Array
from skewmi.trajectory import GRID_NS

SUPPORT = Path(__file__).parents[1] / "support"
PATIENT_MS = 100.0
"""Lead of runs that nothing but what is tried shall stop, on a busy machine, too."""


def test_skewmi_stop_stops_a_run_within_limits(
    robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    codes = []
    stopper = threading.Thread(target=lambda: codes.append(main(["stop", "--connect", robot])))

    def begin_to_stop(action: Array) -> Array:
        stopper.start()
        return action

    path = tmp_path / "run.mcap"
    options = DeployOptions(episodes=3, connect=robot, record=path, lead_ms=PATIENT_MS)
    report = run_deploy(Scripted(8, begin_to_stop), options)
    stopper.join()
    assert codes == [0]
    assert "disarmed" in capsys.readouterr().out
    (episode,) = report.episodes  # nobody who stopped the arm wants it to go on by itself
    assert episode.outcome == "stopped"
    assert "skewmi stop" in episode.reason
    assert episode.steps > 3
    assert_limits_kept(path)


def test_interrupt_stops_smoothly(robot: str, tmp_path: Path) -> None:
    stop = threading.Event()

    def interrupt(action: Array) -> Array:
        stop.set()
        return action

    path = tmp_path / "run.mcap"
    options = DeployOptions(episodes=3, connect=robot, record=path, lead_ms=PATIENT_MS)
    report = run_deploy(Scripted(8, interrupt), options, stop=stop)
    assert report.interrupted
    assert [episode.outcome for episode in report.episodes] == ["stopped"]
    assert describe(robot).state == "disarmed"
    assert_limits_kept(path)


DOOMED = """
import sys
sys.path.insert(0, sys.argv[2])
from scripted_open_press_close import ScriptedOpenPressClose
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.run import run_deploy
from skewmi.sim.tasks.open_press_close.definition import make_layout
print("ready", flush=True)
run_deploy(ScriptedOpenPressClose(make_layout()), DeployOptions(connect=sys.argv[1]))
"""


def test_killed_session_leaves_the_arm_at_rest_within_limits(robot: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Recorder.start(path, TransportConfig.for_client(robot)) as recorder:
        session = subprocess.Popen(
            [sys.executable, "-c", DOOMED, robot, str(SUPPORT)], stdout=subprocess.PIPE
        )
        with Link.open(TransportConfig.for_client(robot), "watcher") as link:
            states = link.subscribe(topics.YUMI_JOINT_STATES)
            deadline = time.monotonic() + 60.0
            speed = 0.0
            began = 0.0
            while not (speed > 0.15 and began and time.monotonic() - began > 0.7):
                assert time.monotonic() < deadline, "the arm never moved"
                moving = decode_joint_states(states.wait(5.0).payload)
                speed = float(np.abs(moving.velocity[:7]).max())
                if speed > 0.05 and not began:
                    began = time.monotonic()
            os.kill(session.pid, signal.SIGKILL)
            session.wait()
            time.sleep(0.6)
            resting = decode_joint_states(states.wait(5.0).payload)
        assert np.abs(resting.velocity[:7]).max() < 0.01
        # Another session may take over once the lease of the dead one has run out.
        deadline = time.monotonic() + 5.0
        while describe(robot).state != "disarmed":
            assert time.monotonic() < deadline
            time.sleep(0.1)
    # On a busy machine states may be lost; that no chunk is, the next line sees to.
    recorder.close()
    assert_limits_kept(path)
    last = chunks_of(path)[-1]
    statuses = [decode_status(m.payload) for m in read_recording(path).messages["/yumi/status"]]
    ends = [s for s in statuses if s.values.get("event") == "at rest"]
    # The arm rested exactly where the last chunk's tail ends: told when that sample was executed,
    # with the time when the next one is due.
    assert ends[-1].stamp_ns == last.stamp_ns + last.time_from_start_ns[-1] + GRID_NS


def test_silent_robot_server_stops_the_run_as_stale(tmp_path: Path) -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "skewmi.cli.main", "robot", "--listen", locator, "--json"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        assert server.stdout is not None
        server.stdout.readline()

        def suspend(action: Array) -> Array:
            server.send_signal(signal.SIGSTOP)
            threading.Timer(0.5, lambda: server.send_signal(signal.SIGCONT)).start()
            return action

        path = tmp_path / "run.mcap"
        options = DeployOptions(connect=locator, record=path, lead_ms=60.0)
        report = run_deploy(Scripted(15, suspend), options)
        (episode,) = report.episodes
        assert episode.outcome == "stopped"
        assert "no new joint state" in episode.reason
        assert describe(locator).state == "disarmed"
        assert_limits_kept(path)
        server.send_signal(signal.SIGTERM)
        assert server.wait(10.0) == 0
    finally:
        server.kill()
        server.wait()


def test_second_session_is_refused_and_the_first_goes_on(robot: str) -> None:
    """The second is a process of its own: its preparations would hold up the first's loop."""
    second: list[subprocess.Popen[str]] = []

    class First(Scripted):
        """Stays where it is until the second has been refused: done within an episode, or the
        arm would be free for a moment, as it is between two of them."""

        def act(self, observation: Array) -> Array:
            if self.count == 10 and not second:
                command = child_command("-m", "skewmi.cli.main", "deploy", "open_press_close")
                second.append(
                    subprocess.Popen(
                        [*command, "--connect", robot, "--json"], stdout=subprocess.PIPE, text=True
                    )
                )
            if second and second[0].poll() is not None:
                raise ValueError("enough")
            return np.zeros_like(super().act(observation))

    options = DeployOptions(episodes=10, connect=robot, lead_ms=PATIENT_MS)
    first = run_deploy(First(), options)
    assert second[0].stdout is not None
    refused = json.loads(second[0].stdout.read())["per_episode"][0]
    assert "enough" in first.episodes[-1].reason
    assert first.episodes[0].steps > 10
    assert refused["steps"] == 0
    assert "holds the arm" in refused["reason"]
