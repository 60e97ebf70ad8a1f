"""How runs end: stops and interrupts between episodes, faults, silence, files that are lost."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from scripted_open_press_close import ScriptedOpenPressClose

from skewmi.cli.deploy import print_report
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording import recorder as recorder_module
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.report import DeployReport
from skewmi.deploy.robot import process as robot_process
from skewmi.deploy.robot import run as robot_run
from skewmi.deploy.robot.backend import BackendFaultError
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.process import free_port, simulated_robot_process
from skewmi.deploy.robot.run import SimulatedRobotOptions, run_simulated_robot
from skewmi.deploy.robot.server import RobotServer
from skewmi.deploy.run import run_deploy
from skewmi.deploy.session import preflight as preflight_module
from skewmi.deploy.session.pace import action_cycles
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError, SkewmiError
from skewmi.policy_io import Array
from skewmi.robot_models import limits as joint_limits
from skewmi.sim.tasks.open_press_close.definition import make_layout


class FewSteps(ScriptedOpenPressClose):
    """The script; at one of its steps something happens."""

    def __init__(self, steps: int, what) -> None:
        super().__init__(make_layout())
        self._steps, self._what, self.count = steps, what, 0

    def reset(self) -> None:
        super().reset()
        self.count = 0

    def act(self, observation: Array) -> Array:
        self.count += 1
        if self.count == self._steps:
            self._what()
        return super().act(observation)


class EnoughError(SkewmiError):
    """What ends an episode early."""


def give_up() -> None:
    raise EnoughError("enough")


@pytest.fixture(scope="module")
def lock_step_robot() -> Iterator[str]:
    with simulated_robot_process("open_press_close", "lab", lock_step=True) as locator:
        yield locator


@contextmanager
def robot_in_a_thread(*, lock_step: bool = False) -> Iterator[str]:
    """A robot server in this process, so that a test can get at its parts."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    config = TransportConfig.for_robot(locator, lock_step=lock_step)
    stop, ready = threading.Event(), threading.Event()
    options = SimulatedRobotOptions(joint_limits.profile("lab"), lock_step=lock_step)
    thread = threading.Thread(
        target=run_simulated_robot, args=(config, options, stop, lambda _: ready.set())
    )
    thread.start()
    assert ready.wait(20.0)
    try:
        yield locator
    finally:
        stop.set()
        thread.join(20.0)
        assert not thread.is_alive()


def call(locator: str, service: topics.Service, extra: bytes = b"") -> tuple[bool, str]:
    with Link.open(TransportConfig.for_client(locator), f"test_{time.monotonic_ns()}") as link:
        link.wait_for_robot(5.0)
        reply = link.call(service, 5.0, extra)
        return reply.success, reply.message


def describe(locator: str) -> RobotDescription:
    return RobotDescription.from_json(call(locator, topics.YUMI_DESCRIBE)[1])


def test_a_stop_between_two_episodes_ends_the_run(lock_step_robot: str) -> None:
    """The robot server is disarmed then: the stop changes no state that anybody could see."""

    def on_event(text: str) -> None:
        if text.startswith("episode 1"):
            assert describe(lock_step_robot).state == "disarmed"
            assert call(lock_step_robot, topics.YUMI_STOP, b"an operator")[0]

    policy = FewSteps(5, give_up)
    options = DeployOptions(episodes=3, connect=lock_step_robot, lock_step=True)
    report = run_deploy(policy, options, on_event=on_event)
    assert [episode.steps for episode in report.episodes] == [4, 0]
    assert "asked to stop" in report.episodes[1].reason
    assert policy.count == 5, "the second episode has begun"
    assert describe(lock_step_robot).state == "disarmed"
    # Whoever begins a new run has heard of it.
    assert run_deploy(FewSteps(5, give_up), options).stops == ["enough"] * 3


def test_only_the_commander_disarms(lock_step_robot: str) -> None:
    ours, other = bytes(range(16)), bytes(range(16, 32))
    assert call(lock_step_robot, topics.YUMI_ARM, ours + bytes(16))[0]
    for gid in (other, b"", other + ours):
        refused, why = call(lock_step_robot, topics.YUMI_DISARM, gid)
        assert not refused
        assert "not the commander" in why
        assert describe(lock_step_robot).state == "holding"
    assert call(lock_step_robot, topics.YUMI_DISARM, ours + bytes(16)) == (True, "disarmed")
    assert "disarmed by its commander" in describe(lock_step_robot).reason
    # Armed by nobody in particular: anybody may stop it, nobody is its commander.
    assert call(lock_step_robot, topics.YUMI_ARM)[0]
    assert not call(lock_step_robot, topics.YUMI_DISARM, bytes(16))[0]
    assert call(lock_step_robot, topics.YUMI_STOP)[0]


def test_a_run_that_lost_the_arm_does_not_stop_whoever_took_it() -> None:
    with robot_in_a_thread() as robot:
        ours = bytes(range(16))

        def hang() -> None:
            """Silent until the lease is lost and somebody else has the arm."""
            deadline = time.monotonic() + 10.0
            while describe(robot).state != "disarmed":
                assert time.monotonic() < deadline
                time.sleep(0.05)
            assert call(robot, topics.YUMI_ARM, ours)[0]

        report = run_deploy(FewSteps(5, hang), DeployOptions(connect=robot))
        assert report.episodes[0].outcome in ("stopped", "fault")
        assert describe(robot).state == "holding"


@pytest.mark.parametrize("lock_step", [True, False])
def test_an_robot_server_that_is_ended_in_a_fault_follows_the_plan_to_rest_first(
    lock_step: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended, crashes, targets = threading.Event(), [], []
    ready, fail = threading.Event(), threading.Event()

    class Failing(MujocoBackend):
        def step(self, target) -> None:
            super().step(target)
            targets.append(target.q.copy())
            if fail.is_set() and np.abs(target.v).max() > 0.05:
                fail.clear()
                targets.clear()
                ended.set()
                raise BackendFaultError("drive 3 over temperature")

    monkeypatch.setattr(robot_run, "MujocoBackend", Failing)
    locator = f"tcp/127.0.0.1:{free_port()}"
    config = TransportConfig.for_robot(locator, lock_step=lock_step)
    options = SimulatedRobotOptions(joint_limits.profile("lab"), lock_step=lock_step)

    def serve() -> None:
        try:
            run_simulated_robot(config, options, ended, lambda _: ready.set())
        except Exception as error:
            crashes.append(error)

    thread = threading.Thread(target=serve)
    thread.start()
    assert ready.wait(20.0)
    run_deploy(FewSteps(3, fail.set), DeployOptions(connect=locator, lock_step=lock_step))
    thread.join(20.0)
    assert not thread.is_alive()
    assert crashes == []
    assert len(targets) > 5, "the arm was moving when the robot server was ended"
    # Its last sample, at rest, is due when the loop ends.
    np.testing.assert_allclose(targets[-1], targets[-2], atol=1e-4)


@pytest.mark.parametrize("lock_step", [True, False])
def test_a_fault_stays_until_somebody_acknowledges_it(
    lock_step: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    hot = threading.Event()

    class Failing(MujocoBackend):
        def step(self, target) -> None:
            super().step(target)
            if hot.is_set():
                hot.clear()
                raise BackendFaultError("drive 3 over temperature")

    monkeypatch.setattr(robot_run, "MujocoBackend", Failing)
    with robot_in_a_thread(lock_step=lock_step) as robot:
        options = DeployOptions(episodes=2, connect=robot, lock_step=lock_step)
        report = run_deploy(FewSteps(10, hot.set), options)
        assert report.faulted
        assert len(report.episodes) == 1
        assert "drive 3 over temperature" in report.stops[0]
        deadline = time.monotonic() + 5.0
        while time.monotonic() < deadline:
            description = describe(robot)
            assert description.state == "fault"
            armed, why = call(robot, topics.YUMI_ARM)
            assert not armed
            assert "skewmi stop" in why
            if call(robot, topics.YUMI_STOP)[1] == "disarmed":
                break
            time.sleep(0.1)
        assert describe(robot).state == "disarmed"


def test_a_silent_scene_is_noticed_between_two_control_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At a tenth of the speed they are a second apart; 200 ms are allowed."""
    silent = threading.Event()
    publish = RobotServer._publish_states

    def publish_states(server: RobotServer) -> None:
        if silent.is_set():
            server._scene_states.put = lambda payload: None
        publish(server)

    monkeypatch.setattr(RobotServer, "_publish_states", publish_states)
    with robot_in_a_thread() as robot:
        report = run_deploy(FewSteps(3, silent.set), DeployOptions(connect=robot, speed=0.1))
    (reason,) = report.stops
    found = re.search(r"the scene state is (\d+) ms old", reason)
    assert found is not None, reason
    assert 200 <= int(found[1]) < 400


@pytest.mark.parametrize("record", [False, True])
def test_an_interrupt_before_an_episode_begins_moves_nothing_and_is_told(
    lock_step_robot: str, record: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = threading.Event()
    ways, check_way = [], preflight_module.check_way

    def check_and_interrupt(*arguments) -> None:
        ways.append(1)
        check_way(*arguments)
        if len(ways) == 2:
            stop.set()

    monkeypatch.setattr(preflight_module, "check_way", check_and_interrupt)
    path = tmp_path / "run.mcap" if record else None
    policy = FewSteps(7, give_up)
    options = DeployOptions(episodes=3, connect=lock_step_robot, lock_step=True, record=path)
    sent = describe(lock_step_robot).clock_ns
    report = run_deploy(policy, options, stop=stop)
    assert sent < describe(lock_step_robot).clock_ns  # of the first episode
    assert [episode.steps for episode in report.episodes] == [6, 0]
    assert [episode.reason for episode in report.episodes] == ["enough", "interrupted"]
    assert report.interrupted
    if path is not None:
        recording = read_recording(path)
        assert json.loads(recording.metadata["report"])["interrupted"]
        # Arming was the last thing that happened: no chunk came after it.
        armed_ns = max(
            message.log_time_ns
            for message in recording.messages[topics.YUMI_STATUS.name]
            if b"armed by" in message.payload
        )
        chunks = recording.messages[topics.YUMI_TRAJECTORY.name]
        assert max(message.log_time_ns for message in chunks) < armed_ns


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


def test_an_interrupt_while_the_robot_starts_leaves_no_timer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Interrupted:
        closed = False

        def readline(self) -> bytes:
            raise KeyboardInterrupt

        def close(self) -> None:
            self.closed = True

    children = []

    class Child(subprocess.Popen):
        def __init__(self, *arguments, **options) -> None:
            super().__init__(*arguments, **options)
            self.stdout.close()
            self.stdout = Interrupted()
            children.append(self)

    monkeypatch.setattr(robot_process.subprocess, "Popen", Child)
    with (
        pytest.raises(KeyboardInterrupt),
        simulated_robot_process("open_press_close", "lab", lock_step=True),
    ):
        pass
    assert children[0].poll() is not None
    timers = [t for t in threading.enumerate() if isinstance(t, threading.Timer)]
    assert all(timer.session for timer in timers)
    assert all(timer.finished.is_set() for timer in timers)


@given(st.floats(0.01, 1.0))
def test_no_control_step_is_shorter_than_asked_for_nor_longer_than_whole_cycles_need(
    speed: float,
) -> None:
    seconds = 0.02 * action_cycles(0.1, speed)
    assert 0.1 / speed - 1e-6 <= seconds < 0.1 / speed + 0.02 + 1e-6


def test_the_speed_that_is_reported_is_the_one_that_is_executed(lock_step_robot: str) -> None:
    report = run_deploy(
        FewSteps(3, give_up), DeployOptions(connect=lock_step_robot, lock_step=True, speed=0.9)
    )
    assert report.speed == pytest.approx(0.1 / 0.12)
    assert report.velocity_fraction == 0.9
    assert any("whole cycles" in note for note in report.notes)


def test_seeds_count_from_zero() -> None:
    with pytest.raises(ConfigurationError, match="seed is -1"):
        DeployOptions(seed=-1)


def test_people_are_told_of_a_dry_run_and_of_reduced_limits(tmp_path: Path) -> None:
    def printed(**changes) -> str:
        console = Console(file=(tmp_path / "out").open("w"), width=200)
        print_report(DeployReport("t", "sim", "lab", 1.0, lock_step=True, **changes), console)
        console.file.close()
        return (tmp_path / "out").read_text()

    assert "dry run" not in printed()
    assert "dry run: nothing was sent" in printed(dry_run=True)
    assert "(lab):" in printed()
    assert "(lab, velocity at most 30% of full):" in printed(velocity_fraction=0.3)
    assert "not whole: x.mcap" in printed(broken_files=["x.mcap"])
