"""How runs end: stops and interrupts between episodes, faults, silence."""

from __future__ import annotations

import json
import re
import threading
import time
from pathlib import Path

import pytest
from robot_servers import call, describe, robot_in_a_thread
from scripted_runs import FewSteps, give_up

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.robot.backend import BackendFaultError
from skewmi.deploy.robot.backends.mujoco import backend as mujoco_backend
from skewmi.deploy.robot.backends.mujoco.scene import MujocoScene
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.run import run_deploy
from skewmi.deploy.session import preflight as preflight_module
from skewmi.deploy.session.refused import LateChunkError
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.wire import topics


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
def test_a_fault_stays_until_somebody_acknowledges_it(
    lock_step: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    hot = threading.Event()

    class Failing(ArmSimulation):
        def step(self) -> None:
            super().step()
            if hot.is_set():
                hot.clear()
                raise BackendFaultError("drive 3 over temperature")

    monkeypatch.setattr(mujoco_backend, "ArmSimulation", Failing)
    with robot_in_a_thread(lock_step=lock_step) as robot:
        options = DeployOptions(episodes=2, connect=robot, lock_step=lock_step, lead_ms=60.0)
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
    """At a tenth of the speed they are a second apart; 200 ms are allowed, with this lead 280.

    On a busy computer a chunk may come too late in that time: the session begins anew then, and
    none of the scene states that it waits for comes.
    """
    silent = threading.Event()
    state = MujocoScene.state
    monkeypatch.setattr(
        MujocoScene, "state", lambda scene: None if silent.is_set() else state(scene)
    )
    with robot_in_a_thread() as robot:
        options = DeployOptions(connect=robot, speed=0.1, lead_ms=60.0)
        policy = FewSteps(3, silent.set)
        report = run_deploy(policy, options)
    assert policy.count == 3
    (reason,) = report.stops
    if "no scene state came, which the policy needs for" not in reason:
        found = re.search(r"the scene state is (\d+) ms old", reason)
        assert found is not None, reason
        assert 280 <= int(found[1]) < 1000


def test_a_scene_that_falls_silent_for_a_new_beginning_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After a chunk that came too late the session waits for a scene state of its own time."""
    state = MujocoScene.state
    silent = threading.Event()
    monkeypatch.setattr(
        MujocoScene, "state", lambda scene: None if silent.is_set() else state(scene)
    )

    def late(*_arguments, **_options):
        silent.set()
        raise LateChunkError("too late")

    with robot_in_a_thread() as robot:
        monkeypatch.setattr(ChunkStream, "send", late)
        report = run_deploy(FewSteps(3, give_up), DeployOptions(connect=robot, lead_ms=60.0))
    (reason,) = report.stops
    assert "no scene state came, which the policy needs for ['button_depth', 'lid_angle']" in reason


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
