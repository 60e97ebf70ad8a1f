"""Robots of all kinds behind their server, over the wire: no scene, no cycle yet, broken ones."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from unready_robot import Unready

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot import run as robot_run
from skewmi.deploy.robot.backend import BackendFaultError, RobotState
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.trajectory import GRID_NS, TrajectoryChunk

LAB = joint_limits.profile("lab")
HOME = np.array(yumi.HOME["right"])
AWAY = HOME + np.linspace(0.3, -0.3, 7)
OURS = b"a" * 16


@contextmanager
def served(backend: HoldBackend, monkeypatch: pytest.MonkeyPatch) -> Iterator[Link]:
    """A server of a robot in a thread, and a link to it."""
    monkeypatch.setattr(robot_run, "make_backend", lambda name, options: backend)
    locator = f"tcp/127.0.0.1:{free_port()}"
    stop, ready = threading.Event(), threading.Event()
    config = TransportConfig.for_robot(locator)
    arguments = ("hold", BackendOptions(), config, LAB, stop, lambda _: ready.set())
    thread = threading.Thread(target=robot_run.serve_robot, args=arguments)
    thread.start()
    try:
        assert ready.wait(20.0)
        with Link.open(TransportConfig.for_client(locator), "test") as link:
            link.wait_for_robot(5.0)
            yield link
    finally:
        stop.set()
        thread.join(20.0)
        assert not thread.is_alive()


def describe(link: Link) -> RobotDescription:
    return RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 5.0).message)


def test_a_served_robot_without_a_scene_moves_and_tells_no_scene(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with served(HoldBackend(HOME, period_ns=4_032_000), monkeypatch) as link:
        described = describe(link)
        assert (described.backend, described.task, described.layout_hashes) == ("hold", "", ())
        assert not described.simulated
        assert not described.lock_step
        publisher = link.publisher(topics.YUMI_TRAJECTORY)
        states = link.subscribe(topics.YUMI_JOINT_STATES)
        scene = link.subscribe(topics.YUMI_SCENE_STATES)
        assert link.call(topics.YUMI_ARM, 5.0, publisher.gid).success
        motion = StartMotion(HOME, HOME + 0.02, LAB).trajectory
        soon_ns = described.clock_ns - described.clock_ns % GRID_NS + 400_000_000
        chunk = TrajectoryChunk.of(soon_ns, described.joint_names, motion)
        publisher.put(encode_chunk(chunk))
        for _ in range(500):
            states.wait(5.0)
            now = describe(link)
            if now.state == "holding" and now.commanded_position == tuple(HOME + 0.02):
                break
        assert now.commanded_position == tuple(HOME + 0.02), now
        assert scene.latest() is None


def test_before_its_first_cycle_a_robot_is_described_as_not_ready(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unready = Unready(HOME, lock_step=True)
    unready.states, unready.missing = False, "no packet from the controller yet"
    unready.lock_step = False
    with served(unready, monkeypatch) as link:
        described = describe(link)
        assert described.state == "disarmed"
        assert described.commanded_position == ()
        assert "not ready: no packet" in described.reason
        armed = link.call(topics.YUMI_ARM, 5.0, OURS)
        assert not armed.success
        assert "no packet from the controller yet" in armed.message
        unready.states, unready.missing = True, None
        assert link.call(topics.YUMI_ARM, 5.0, OURS).success
        assert describe(link).commanded_position == tuple(HOME)


def test_a_robot_that_cannot_be_read_is_a_fault_and_still_served(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Broken(HoldBackend):
        broken = False

        def read(self) -> RobotState | None:
            state = super().read()
            if self.broken:
                raise BackendFaultError("no packet from the controller for 0.1 s")
            return state

    backend = Broken(HOME)
    with served(backend, monkeypatch) as link:
        assert link.call(topics.YUMI_ARM, 5.0, OURS).success
        backend.broken = True
        link.call(topics.YUMI_DESCRIBE, 5.0)
        described = describe(link)
        assert (described.state, described.reason) == (
            "fault",
            "no packet from the controller for 0.1 s",
        )
        backend.broken = False
        assert link.call(topics.YUMI_STOP, 5.0).message == "disarmed"
