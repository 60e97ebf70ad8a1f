"""The scene's stamps are the robot server's time, whoever else tells joint states."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robot_servers import NAMES, description
from strangers import FALSE, LATER_NS, joints

from skewmi.deploy.robot.backend import SceneState
from skewmi.deploy.robot.backends.egm.scene import (
    EMULATOR_RESET,
    EMULATOR_STATUS,
    SCENE_PUBLISHER,
    ResetRequest,
)
from skewmi.deploy.robot.egm_emulator.scene_link import SceneLink
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import LatestReader, Publisher
from skewmi.deploy.wire.messages import TriggerReply, decode_joint_states, decode_status
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.trajectory import Array

SCENE = SceneState(("lid_hinge",), np.zeros(1), np.zeros(1))
PATIENCE_S = 10.0
QUIET_S = 0.4
"""More than what a robot server may say nothing before it is told of no publisher."""


@dataclass
class Server:
    """What a scene needs of a robot server, and what that hears."""

    link: Link
    joints: Publisher
    scene: LatestReader
    status: LatestReader

    def named(self) -> list[str]:
        """Publishers of the scene that an emulator has named since the last call."""
        statuses = (decode_status(sample.payload) for sample in self.status.drain())
        return [status.values[SCENE_PUBLISHER] for status in statuses]

    def stamps(self) -> list[int]:
        """Of scene states that came since the last call."""
        return [decode_joint_states(sample.payload).stamp_ns for sample in self.scene.drain()]


@contextmanager
def server(locator: str, *, names_publisher: bool = True) -> Iterator[Server]:
    with Link.open(TransportConfig.for_robot(locator), "robot") as link:
        told = link.publisher(topics.YUMI_JOINT_STATES)
        named = {topics.YUMI_JOINT_STATES.name: (told.gid.hex(),)} if names_publisher else {}
        answer = TriggerReply(True, description(publishers=named).to_json())
        link.service(topics.YUMI_DESCRIBE, lambda request: answer)
        scene = link.subscribe(topics.YUMI_SCENE_STATES, depth=None)
        yield Server(link, told, scene, link.subscribe(EMULATOR_STATUS, depth=None))


@contextmanager
def scene_at(
    locator: str, reset: Callable[[int], Array] = lambda seed: np.zeros(7)
) -> Iterator[SceneLink]:
    link = SceneLink.open(TransportConfig.for_client(locator), lambda: SCENE, dict, reset)
    try:
        yield link
    finally:
        link.close()


@contextmanager
def stranger_at(locator: str) -> Iterator[Publisher]:
    with Link.open(TransportConfig.for_client(locator), "stranger") as link:
        yield link.publisher(topics.YUMI_JOINT_STATES)


def until(what: Callable[[], object], each: Callable[[], None]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline
        each()
        time.sleep(0.004)


def serve_for(seconds: float, scene: SceneLink) -> None:
    ended = time.monotonic() + seconds
    while time.monotonic() < ended:
        scene.serve()
        time.sleep(0.004)


def test_stamps_are_of_the_robot_server_alone() -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        robot = stack.enter_context(server(locator))
        scene = stack.enter_context(scene_at(locator))
        stranger = stack.enter_context(stranger_at(locator))
        told: list[int] = []
        heard: list[int] = []

        def cycle() -> None:
            stranger.put(FALSE[topics.YUMI_JOINT_STATES.name])
            told.append(len(told) + 1)
            robot.joints.put(joints(NAMES, stamp_ns=told[-1]))
            # And behind the robot server's, where only the newest would be looked at.
            stranger.put(joints(NAMES, stamp_ns=LATER_NS + told[-1]))
            scene.serve()
            heard.extend(robot.stamps())

        until(lambda: len(heard) > 50, cycle)
    assert set(heard) <= set(told)
    assert heard == sorted(set(heard))


def test_stranger_alone_is_no_robot_server() -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        robot = stack.enter_context(server(locator, names_publisher=False))
        scene = stack.enter_context(scene_at(locator))
        stranger = stack.enter_context(stranger_at(locator))
        ended = time.monotonic() + 1.0
        while time.monotonic() < ended:
            stranger.put(FALSE[topics.YUMI_JOINT_STATES.name])
            scene.serve()
            assert not scene.connected
            assert robot.stamps() == []
            time.sleep(0.004)


def hear(scene: SceneLink, locator: str, *, others: bool) -> None:
    """One life of a robot server, until the scene's states come in its time."""
    with ExitStack() as stack:
        robot = stack.enter_context(server(locator))
        stranger = stack.enter_context(stranger_at(locator)) if others else None
        heard: list[int] = []

        def cycle() -> None:
            robot.joints.put(joints(NAMES, stamp_ns=time.monotonic_ns()))
            if stranger is not None:
                stranger.put(FALSE[topics.YUMI_JOINT_STATES.name])
            scene.serve()
            heard.extend(robot.stamps())

        until(lambda: len(heard) > 5, cycle)
    assert max(heard) < LATER_NS


@pytest.mark.parametrize("others", [False, True], ids=["alone", "beside a stranger"])
def test_robot_server_that_was_started_again_is_found(others: bool) -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    with scene_at(locator) as scene:
        hear(scene, locator, others=others)
        hear(scene, locator, others=others)


def test_publisher_that_is_about_to_be_replaced_is_not_named() -> None:
    """Sessions of a robot server that was started again would wait for it in vain."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    with scene_at(locator) as scene:
        hear(scene, locator, others=False)
        # No process is started in less; a server of this one would be there within that time.
        serve_for(QUIET_S, scene)
        with server(locator) as robot:
            until(lambda: robot.link.graph.publishers(EMULATOR_STATUS), scene.serve)
            serve_for(0.5, scene)
            assert robot.named() == []
            named: list[str] = []

            def cycle() -> None:
                robot.joints.put(joints(NAMES, stamp_ns=time.monotonic_ns()))
                scene.serve()
                named.extend(robot.named())

            until(lambda: named, cycle)
            there = robot.link.graph.publishers(topics.YUMI_SCENE_STATES)
            assert set(named) <= {gid.hex() for gid in there}


def asked_for(scene: SceneLink, link: Link, request: bytes) -> TriggerReply:
    """What a scene that is served meanwhile answers."""
    answers: list[TriggerReply] = []
    thread = threading.Thread(
        target=lambda: answers.append(link.call(EMULATOR_RESET, PATIENCE_S, request))
    )
    thread.start()
    until(lambda: answers, scene.serve)
    thread.join()
    return answers[0]


def test_a_scene_is_put_back_for_the_robot_server_alone() -> None:
    locator, seeds = f"tcp/127.0.0.1:{free_port()}", list[int]()

    def reset(seed: int) -> Array:
        seeds.append(seed)
        return np.full(7, 0.5)

    with ExitStack() as stack:
        robot = stack.enter_context(server(locator))
        scene = stack.enter_context(scene_at(locator, reset))
        other = stack.enter_context(Link.open(TransportConfig.for_client(locator), "other"))
        until(lambda: scene.connected, scene.serve)
        # So that it is known where this client is before it passes for somebody else.
        until(lambda: other.graph.session_of(robot.joints.gid), scene.serve)
        for request in (
            b"",
            b"7",
            ResetRequest(7, other.session_id).to_json(),
            ResetRequest(7, robot.link.session_id).to_json(),
        ):
            refused = asked_for(scene, other, request)
            assert not refused.success
            assert seeds == []
        assert "/yumi/scene/reset" in refused.message
        answer = asked_for(scene, robot.link, ResetRequest(7, robot.link.session_id).to_json())
        assert answer.success, answer.message
        assert json.loads(answer.message) == [0.5] * 7
    assert seeds == [7]


@given(st.integers(0, 10**18 - 1), st.text(min_size=1))
def test_a_request_for_a_reset_is_read_as_it_was_written(seed: int, session: str) -> None:
    asked = ResetRequest(seed, session)
    assert ResetRequest.from_json(asked.to_json()) == asked


@given(
    st.binary()
    | st.recursive(st.none() | st.integers() | st.text(), st.lists).map(
        lambda value: json.dumps(value).encode()
    )
)
def test_anything_else_is_no_request(request: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        ResetRequest.from_json(request)
