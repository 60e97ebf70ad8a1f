"""Strangers on a link, and what they say."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.session.states import SessionEvent, SessionState
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.controller_state import ControllerState, encode_controller_state
from skewmi.deploy.wire.messages import JointStates, encode_chunk, encode_joint_states
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import JointPoint, JointTrajectory, TrajectoryChunk

PROGRAM = Path(__file__).with_name("stranger_process.py")
LATER_NS = 2_000_000_000 * 1_000_000_000
"""A stamp after everything that a robot server may tell."""


def joints(names: tuple[str, ...], *values: float, stamp_ns: int = LATER_NS) -> bytes:
    """Joint states; what is not given is 0.01."""
    position = np.array([*values, *[0.01] * (len(names) - len(values))])
    nothing = np.zeros(0)
    return encode_joint_states(JointStates(stamp_ns, names, position, nothing, nothing))


def solved_scene(stamp_ns: int = LATER_NS) -> bytes:
    """Scene states in the middle of the reward region: lid shut, button pressed."""
    centres = {
        name: centre
        for ball in make_layout().reward_region
        for name, centre in zip(ball.fields, ball.centre, strict=True)
    }
    values = centres["lid_angle"], centres["button_depth"]
    return joints(("lid_hinge", "button_slide"), *values, stamp_ns=stamp_ns)


def robot_status(state: ServerState = ServerState.FAULT) -> bytes:
    return RobotStatus(LATER_NS, state, "says a stranger", commander=bytes(16)).encode()


FALSE: dict[str, bytes] = {
    topics.YUMI_JOINT_STATES.name: joints(
        (*yumi.joint_names("right"), yumi.finger_names("right")[0])
    ),
    topics.YUMI_SCENE_STATES.name: solved_scene(),
    topics.YUMI_STATUS.name: robot_status(),
    topics.POLICY_OBSERVATION.name: joints(make_layout().observation_names),
    topics.POLICY_ACTION.name: joints(tuple(field.name for field in make_layout().action)),
    topics.YUMI_TRAJECTORY.name: encode_chunk(
        TrajectoryChunk.of(
            LATER_NS, yumi.joint_names("right"), JointTrajectory.resting(np.ones(7), 10)
        )
    ),
    topics.YUMI_GRIPPER.name: joints(yumi.finger_names("right")[:1]),
    topics.YUMI_CONTROLLER_STATE.name: encode_controller_state(
        ControllerState(
            LATER_NS,
            yumi.joint_names("right"),
            JointPoint(np.ones(7), np.ones(7), np.ones(7)),
            np.ones(7),
            np.ones(7),
            np.ones(7),
        )
    ),
}
"""Well-formed and wrong, for each topic."""

SESSION_SUCCESS = SessionNews(
    LATER_NS, SessionState.SUCCESS, "says a stranger", SessionState.RUNNING, SessionEvent.SUCCESS
).encode()


@contextmanager
def stranger(
    locator: str,
    topic: topics.Topic | str,
    payload: bytes | None = None,
    *,
    more_bytes: int = 0,
    rate: float = 200.0,
    node: str = "stranger",
    copy: str = "",
    serve: str = "",
    also: Iterable[str] = (),
) -> Iterator[str]:
    """One that publishes until the block is left; yields its global ids, hexadecimal.

    Args:
        locator: Of the robot server.
        topic: Where.
        payload: What; by default what is in `FALSE`.
        more_bytes: How many zeros follow it.
        rate: Messages a second; 0 as fast as it goes.
        node: Its name; empty for a program that announces nothing.
        copy: Use the id of whoever publishes there: "before" or "ahead" of its numbers.
        serve: Answer `/yumi/describe` with this.
        also: More topics, on which it sends what is in `FALSE`.
    """
    name = topic if isinstance(topic, str) else topic.name
    order = {
        "locator": locator,
        "topic": name,
        "payload": (FALSE[name] if payload is None else payload).hex(),
        "more_bytes": more_bytes,
        "rate": rate,
        "node": "" if copy else node,
        "copy": copy,
        "serve": serve,
        "also": {other: FALSE[other].hex() for other in also},
    }
    child = subprocess.Popen(
        [sys.executable, str(PROGRAM), json.dumps(order)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    try:
        assert child.stdout is not None
        yield child.stdout.readline().decode().strip()
        assert child.poll() is None, "the stranger has ended"
    finally:
        child.kill()
        child.communicate()


@contextmanager
def strangers_everywhere(locator: str, rate: float = 20.0) -> Iterator[dict[str, str]]:
    """A stranger that sends what is in `FALSE` on every topic; its ids by topic."""
    first, *others = FALSE
    with stranger(locator, first, rate=rate, also=others) as ids:
        yield dict(zip(FALSE, ids.split(), strict=True))
