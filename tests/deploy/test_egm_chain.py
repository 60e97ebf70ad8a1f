"""Session's side, robot server, EGM bridge, UDP, emulated controller and its scene, together."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from skewmi.cli.egm_flags import task_facts
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.egm_emulator.emulator import Emulator, EmulatorOptions
from skewmi.deploy.robot.egm_emulator.scene_link import NODE_NAME
from skewmi.deploy.robot.gripper.fixed import FixedGripper
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.robot.run import serve_robot
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.policies import bundled
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi

PATIENT = ProgramSettings(comm_timeout_s=5.0)
"""A busy machine is no reason to end a session."""


class Chain:
    """Where bridge and emulator meet; each can be started and ended."""

    def __init__(self) -> None:
        self.locator = f"tcp/127.0.0.1:{free_port()}"
        self.right, self.left = (f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}" for _ in range(2))

    @contextmanager
    def bridge(self) -> Iterator[None]:
        stop, ready = threading.Event(), threading.Event()
        facts = task_facts("open_press_close")
        options = BackendOptions(
            task=facts.task,
            egm=EgmOptions(listen=self.right, listen_left=self.left, program=PATIENT),
            facts=facts,
            gripper=FixedGripper(facts.workspace.gripper_opening),
        )
        config = TransportConfig.for_robot(self.locator)
        lab = joint_limits.profile("lab")
        thread = threading.Thread(
            target=serve_robot, args=("egm", options, config, lab, stop, lambda _: ready.set())
        )
        thread.start()
        assert ready.wait(60.0)
        try:
            yield
        finally:
            stop.set()
            thread.join(30.0)
            assert not thread.is_alive()

    @contextmanager
    def emulator(self, *, left: bool = True) -> Iterator[Emulator]:
        options = EmulatorOptions(
            remote=self.right, remote_left=self.left if left else None, program=PATIENT
        )
        stop = threading.Event()
        with Emulator.open(options, TransportConfig.for_client(self.locator)) as emulator:
            thread = threading.Thread(target=emulator.run, args=(stop,))
            thread.start()
            try:
                yield emulator
            finally:
                stop.set()
                thread.join(30.0)

    @contextmanager
    def client(self) -> Iterator[Link]:
        with Link.open(TransportConfig.for_client(self.locator), "test") as link:
            link.wait_for_robot(20.0)
            yield link


def describe(link: Link) -> RobotDescription:
    return RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 10.0).message)


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture(scope="module")
def chain() -> Iterator[tuple[Chain, Emulator, Link]]:
    """The emulator first: it runs without a robot server, and finds one that comes later."""
    where = Chain()
    with where.emulator() as emulator:
        until(lambda: emulator.controller.arms["right"].sessions > 0)
        assert emulator.scene is not None
        assert not emulator.scene.connected
        with where.bridge(), where.client() as link:
            until(lambda: describe(link).ready and describe(link).resettable)
            yield where, emulator, link


def test_the_bridge_describes_itself(chain: tuple[Chain, Emulator, Link]) -> None:
    description = describe(chain[2])
    assert description.backend == "egm"
    assert not description.simulated
    assert not description.lock_step
    assert description.ready
    assert description.not_ready == ""
    assert description.cycle_ns == 4_032_000
    assert description.limits["flange_speed"][0] < 0.25
    assert description.joint_names == yumi.joint_names("right")


def test_scene_states_have_the_robot_servers_clock(chain: tuple[Chain, Emulator, Link]) -> None:
    link = chain[2]
    joints = link.subscribe(topics.YUMI_JOINT_STATES, depth=None)
    scene = link.subscribe(topics.YUMI_SCENE_STATES, depth=None)
    joint_stamps: set[int] = set()
    scene_stamps: set[int] = set()

    def heard() -> bool:
        # The scene's first: they answer joint states, which must all be there then.
        scene_stamps.update(decode_joint_states(s.payload).stamp_ns for s in scene.drain())
        joint_stamps.update(decode_joint_states(s.payload).stamp_ns for s in joints.drain())
        return len(scene_stamps) > 20

    until(heard)
    assert {stamp for stamp in scene_stamps if stamp >= min(joint_stamps)} <= joint_stamps
    # Every 20 ms, of a robot whose cycle is 4.032 ms.
    assert np.median(np.diff(sorted(joint_stamps))) == pytest.approx(20.16e6, rel=0.05)


def test_the_bridge_announces_who_publishes_the_scene(
    chain: tuple[Chain, Emulator, Link],
) -> None:
    _, _, link = chain
    scene = link.subscribe(topics.YUMI_SCENE_STATES).wait(20.0)
    assert describe(link).publishers[topics.YUMI_SCENE_STATES.name] == (scene.gid.hex(),)
    assert link.graph.node_of(scene.gid) == NODE_NAME


def test_both_arms_are_told(chain: tuple[Chain, Emulator, Link]) -> None:
    joints = chain[2].subscribe(topics.YUMI_JOINT_STATES)
    names = yumi.joint_names("right") + yumi.finger_names("right")[:1] + yumi.joint_names("left")

    def told() -> bool:
        sample = joints.take()
        return sample is not None and decode_joint_states(sample.payload).names == names

    until(told)


def test_status_tells_of_the_controller(chain: tuple[Chain, Emulator, Link]) -> None:
    reader = chain[2].subscribe(topics.YUMI_STATUS, depth=None)
    found: list[RobotStatus] = []

    def heard() -> bool:
        found.extend(s for s in (RobotStatus.decode(x.payload) for x in reader.drain()) if s)
        return bool(found)

    until(heard)
    told = found[-1].told
    assert told["egm"] == "guiding"
    assert told["mci"] == "running"
    assert "at home" in told["left_arm"]
    keys = {"rate_hz", "jitter_ms", "missed", "late_fraction", "runs_on_mm", "utilization"}
    assert keys <= set(told)


def test_a_reset_goes_through_the_robot_server_and_needs_a_new_arming(
    chain: tuple[Chain, Emulator, Link],
) -> None:
    _, emulator, link = chain
    sessions = emulator.controller.arms["right"].sessions
    gids = bytes(range(32))
    assert link.call(topics.YUMI_ARM, 10.0, gids).success
    reply = link.call(topics.YUMI_SCENE_RESET, 10.0, b"3")
    assert reply.success, reply.message
    until(lambda: emulator.controller.arms["right"].sessions > sessions)
    until(lambda: describe(link).ready)
    assert describe(link).state == "disarmed"
    assert link.call(topics.YUMI_ARM, 10.0, gids).success
    assert link.call(topics.YUMI_STOP, 10.0).success


def test_an_emulator_that_goes_away_is_told_and_one_that_comes_is_found() -> None:
    where = Chain()
    with where.bridge(), where.client() as link:
        assert not describe(link).ready
        assert "no packet" in describe(link).not_ready
        assert not describe(link).resettable
        refused = link.call(topics.YUMI_SCENE_RESET, 10.0, b"0")
        assert not refused.success
        assert "real" in refused.message
        with where.emulator(left=False):
            until(lambda: describe(link).ready)
            until(lambda: describe(link).resettable)
        until(lambda: "no packet" in describe(link).not_ready, seconds=10.0)
        assert not link.call(topics.YUMI_ARM, 10.0, bytes(32)).success
        with where.emulator(left=False):
            until(lambda: describe(link).ready)


def test_a_bridge_that_comes_again_is_found_by_the_scene() -> None:
    where = Chain()
    with where.emulator(left=False):
        for _ in range(2):
            with where.bridge(), where.client() as link:
                until(lambda: describe(link).ready)
                until(lambda: describe(link).resettable)


@pytest.mark.slow
def test_one_word_swaps_the_simulated_robot_for_the_emulated_controller() -> None:
    policy = str(bundled()["open_press_close"])
    command = [sys.executable, "-m", "skewmi.cli.main", "deploy", policy]
    # Four processes that have to be on time: the lead is for a computer that is slow or busy.
    command += ["--robot", "egm-emulator", "--episodes", "2", "--lead-ms", "60", "--json"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    assert report["robot"] == "egm-emulator"
    assert report["successes"] >= 1, report["stops"]
    assert report["contact"], "what the scene of another process has measured"
