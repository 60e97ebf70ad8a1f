"""The whole chain in two processes over Zenoh: policy, planner, guard, link, simulated robot."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scripted_open_press_close import ScriptedOpenPressClose

from skewmi.cli.interrupt import ENDING_SIGNALS
from skewmi.cli.main import main
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.process import free_port, simulated_robot_process
from skewmi.deploy.run import run_deploy
from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import (
    decode_chunk,
    decode_joint_states,
    decode_status,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError, LayoutMismatchError, TransportError
from skewmi.policy_io import Array
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import GRID_NS, TrajectoryChunk

LAB = joint_limits.profile("lab")
SUPPORT = Path(__file__).parents[1] / "support"


class Scripted(ScriptedOpenPressClose):
    """The script, with something that happens at one of its steps."""

    def __init__(self, at_step: int = -1, what=None) -> None:
        super().__init__(make_layout())
        self._at_step, self._what = at_step, what

    def reset(self) -> None:
        super().reset()
        self.count = 0

    def act(self, observation: Array) -> Array:
        self.count += 1
        action = super().act(observation)
        return self._what(action) if self.count == self._at_step else action


@pytest.fixture(scope="module")
def lock_step_robot() -> Iterator[str]:
    with simulated_robot_process("open_press_close", "lab", lock_step=True) as locator:
        yield locator


@pytest.fixture(scope="module")
def robot() -> Iterator[str]:
    with simulated_robot_process("open_press_close", "lab", lock_step=False) as locator:
        yield locator


def chunks_of(path: Path) -> list[TrajectoryChunk]:
    """Every chunk that was sent and that the robot server did not refuse."""
    recording = read_recording(path)
    messages = recording.messages[topics.YUMI_TRAJECTORY.name]
    assert [m.sequence for m in messages] == list(
        range(messages[0].sequence, messages[0].sequence + len(messages))
    ), "the recording is not complete"
    statuses = [decode_status(m.payload) for m in recording.messages[topics.YUMI_STATUS.name]]
    refused = {
        int(stamp) for s in statuses for stamp in s.values.get("refused_stamps_ns", "").split()
    }
    chunks = [decode_chunk(m.payload) for m in messages]
    return [chunk for chunk in chunks if chunk.stamp_ns not in refused]


def executed(chunks: list[TrajectoryChunk]) -> list[np.ndarray]:
    """Commanded positions on the 4 ms grid, as the messages alone say; one array per stretch.

    Each chunk replaces what older ones say from its stamp on; where nothing is said for a
    moment the arm rests at the end of the last chunk, and a new stretch begins.
    """
    stretches: list[dict[int, np.ndarray]] = []
    end = -1
    for chunk in chunks:
        if chunk.stamp_ns > end:
            stretches.append({})
        points = stretches[-1]
        for later in [t for t in points if t >= chunk.stamp_ns]:
            del points[later]
        points.update(
            zip(
                (chunk.stamp_ns + chunk.time_from_start_ns).tolist(),
                chunk.trajectory.q,
                strict=True,
            )
        )
        end = chunk.stamp_ns + int(chunk.time_from_start_ns[-1])
    for points in stretches:
        assert np.unique(np.diff(sorted(points))).tolist() == [GRID_NS]
    return [np.array([points[t] for t in sorted(points)]) for points in stretches]


def limit_shares(q: np.ndarray) -> dict[str, float]:
    """Velocity, acceleration and jerk by differences on the grid, as shares of their limits.

    The arm rests before and after, which counts, too.
    """
    h = GRID_NS / 1e9
    padded = np.concatenate([np.tile(q[0], (3, 1)), q, np.tile(q[-1], (3, 1))])
    bounds = {"velocity": LAB.velocity, "acceleration": LAB.acceleration, "jerk": LAB.jerk}
    return {
        name: float((np.abs(np.diff(padded, n=n, axis=0)) / h**n / bound).max())
        for n, (name, bound) in enumerate(bounds.items(), start=1)
    }


def assert_limits_kept(path: Path) -> dict[str, float]:
    chunks = chunks_of(path)
    checker = ChunkChecker(LAB, None, ArmKinematics("right").forward)
    for chunk in chunks:
        checker.check(
            chunk.trajectory.q,
            chunk.trajectory.v,
            chunk.trajectory.a,
            chunk.trajectory.point(0),
            joint_names=chunk.joint_names,
            time_from_start_ns=chunk.time_from_start_ns,
        )
    worst: dict[str, float] = {}
    for q in executed(chunks):
        assert (q >= LAB.position_lower).all()
        assert (q <= LAB.position_upper).all()
        for name, share in limit_shares(q).items():
            worst[name] = max(worst.get(name, 0.0), share)
            assert share <= 1.0 + 1e-6, (name, share)
    return worst


def describe(locator: str) -> RobotDescription:
    with Link.open(TransportConfig.for_client(locator), f"test_{time.monotonic_ns()}") as link:
        return RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 5.0).message)


def test_scripted_motion_solves_the_task_within_all_limits(
    lock_step_robot: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    report = run_deploy(
        Scripted(),
        DeployOptions(episodes=2, seed=3, connect=lock_step_robot, lock_step=True, record=path),
    )
    assert report.success_rate == 1.0, report.as_dict()
    assert report.missed_cycles == 0
    assert report.stops == []
    worst = assert_limits_kept(path)
    # What the session reports is what the messages say (it counts unused braking tails, too).
    assert worst["velocity"] <= report.usage.velocity + 1e-6
    assert worst["velocity"] > 0.2, "the arm hardly moved: the check above shows nothing"
    assert report.usage.jerk <= 1.0 + 1e-6

    recording = read_recording(path)
    scene = [decode_joint_states(m.payload) for m in recording.messages["/yumi/scene_states"]]
    lid = np.array([s.position[s.names.index("lid_hinge")] for s in scene])
    button = np.array([s.position[s.names.index("button_slide")] for s in scene])
    assert lid.max() > 1.5, "the lid was never open"
    assert abs(lid[-1]) < 0.035
    assert button[-1] > 0.010
    statuses = [decode_status(m.payload) for m in recording.messages["/yumi/status"]]
    session = [s.values["state"] for s in statuses if s.name == "skewmi_deploy"]
    assert session[:4] == ["to start", "running", "success", "holding"]


def test_lock_step_runs_are_repeatable(lock_step_robot: str, tmp_path: Path) -> None:
    def stop_early(action: Array) -> Array:
        raise ValueError("enough")

    recorded = []
    for name in ("first", "second"):
        path = tmp_path / f"{name}.mcap"
        options = DeployOptions(seed=7, connect=lock_step_robot, lock_step=True, record=path)
        report = run_deploy(Scripted(30, stop_early), options)
        assert report.faulted
        recorded.append(np.concatenate([chunk.trajectory.q for chunk in chunks_of(path)]))
    np.testing.assert_array_equal(*recorded)


@pytest.mark.parametrize(
    ("what", "outcome", "reason"),
    [
        (lambda action: action * np.nan, "stopped", "finite"),
        (lambda action: 1 / 0, "fault", "ZeroDivisionError"),
        (lambda action: action[:2], "fault", "Error"),
    ],
    ids=["nan", "exception", "shape"],
)
def test_broken_policy_ends_at_rest_with_the_reason(
    lock_step_robot: str, tmp_path: Path, what, outcome: str, reason: str
) -> None:
    path = tmp_path / "run.mcap"
    options = DeployOptions(connect=lock_step_robot, lock_step=True, record=path)
    report = run_deploy(Scripted(12, what), options)
    (episode,) = report.episodes
    assert episode.outcome == outcome
    assert reason in episode.reason
    assert report.stops == [episode.reason]
    assert describe(lock_step_robot).state == "disarmed"
    assert_limits_kept(path)


def test_pace_and_layout_must_agree(lock_step_robot: str) -> None:
    with pytest.raises(ConfigurationError, match="lock-step"):
        run_deploy(Scripted(), DeployOptions(connect=lock_step_robot))
    other = Scripted()
    other.layout = replace(other.layout, success_hold_steps=11)
    options = DeployOptions(connect=lock_step_robot, lock_step=True)
    with pytest.raises(LayoutMismatchError, match="layout"):
        run_deploy(other, options)
    with pytest.raises(LayoutMismatchError, match="robot model"):
        run_deploy(Scripted(), replace(options, robot_model_hash="0" * 64))


def test_nobody_there_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    nobody = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(TransportError, match="no robot server answers"):
        run_deploy(Scripted(), DeployOptions(connect=nobody))
    assert main(["stop", "--connect", nobody]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no robot server answers" in line


def test_port_in_use_is_one_line(robot: str, capsys: pytest.CaptureFixture[str]) -> None:
    handlers = {n: signal.getsignal(n) for n in ENDING_SIGNALS}
    try:
        assert main(["robot", "--listen", robot]) == 2
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    (line,) = capsys.readouterr().err.splitlines()
    assert "in use" in line


def test_skewmi_stop_stops_a_run_within_limits(
    robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    codes = []
    stopper = threading.Timer(2.5, lambda: codes.append(main(["stop", "--connect", robot])))
    stopper.start()
    path = tmp_path / "run.mcap"
    report = run_deploy(Scripted(), DeployOptions(episodes=3, connect=robot, record=path))
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
    threading.Timer(2.0, stop.set).start()
    path = tmp_path / "run.mcap"
    options = DeployOptions(episodes=3, connect=robot, record=path)
    report = run_deploy(Scripted(), options, stop=stop)
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
    with Recorder(path, TransportConfig.for_client(robot)) as recorder:
        session = subprocess.Popen(
            [sys.executable, "-c", DOOMED, robot, str(SUPPORT)], stdout=subprocess.PIPE
        )
        with Link.open(TransportConfig.for_client(robot), "watcher") as link:
            states = link.subscribe(topics.YUMI_JOINT_STATES)
            deadline = time.monotonic() + 30.0
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
    assert recorder.close().missed == 0
    assert_limits_kept(path)
    last = chunks_of(path)[-1]
    statuses = [decode_status(m.payload) for m in read_recording(path).messages["/yumi/status"]]
    ends = [s for s in statuses if s.values.get("event") == "at rest"]
    # The arm rested exactly where the last chunk's tail ends.
    assert ends[-1].stamp_ns == last.stamp_ns + last.time_from_start_ns[-1]


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
        options = DeployOptions(connect=locator, record=path)
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
    reports = {}

    def second() -> None:
        reports["second"] = run_deploy(Scripted(), DeployOptions(connect=robot))

    timer = threading.Timer(1.5, second)
    timer.start()

    def enough(action: Array) -> Array:
        raise ValueError("enough")

    reports["first"] = run_deploy(Scripted(40, enough), DeployOptions(connect=robot))
    timer.join()
    assert reports["first"].episodes[0].steps >= 39
    assert "enough" in reports["first"].episodes[0].reason
    refused = reports["second"].episodes[0]
    assert refused.steps == 0
    assert "holds the arm" in refused.reason


def test_dry_run_sends_nothing(robot: str, tmp_path: Path) -> None:
    def enough(action: Array) -> Array:
        raise ValueError("enough")

    before = describe(robot).commanded_position
    path = tmp_path / "run.mcap"
    policy = Scripted(8, enough)
    run_deploy(policy, DeployOptions(connect=robot, dry_run=True, record=path))
    assert policy.count == 8
    recording = read_recording(path)
    assert not recording.messages.get("/yumi/right/joint_trajectory")
    assert len(recording.messages["/skewmi/policy_action"]) >= 6
    assert describe(robot).commanded_position == before


@pytest.mark.slow
def test_scripted_motion_solves_the_task_in_real_time(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    report = run_deploy(Scripted(), DeployOptions(episodes=2, record=path))
    assert report.successes == 2, report.as_dict()
    assert_limits_kept(path)
