"""After warming up, nothing that a robot server meets for the first time builds tables."""

from __future__ import annotations

import numpy as np
import pytest
from lone_motions import LAB

from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.deploy.robot.states import ServerEvent, ServerState
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.robot.warm_up import warm_up
from skewmi.deploy.safety.checks import limit_check
from skewmi.deploy.safety.validation import ChunkValidator, ValidationRules
from skewmi.deploy.wire import controller_state, ros2_types
from skewmi.deploy.wire.controller_state import ControllerState, encode_controller_state
from skewmi.deploy.wire.messages import (
    JointStates,
    decode_chunk,
    decode_joint_states,
    encode_chunk,
    encode_joint_states,
)
from skewmi.errors import LimitViolationError, TransportError
from skewmi.robot_models import yumi
from skewmi.trajectory import GRID_NS, JointPoint, JointTrajectory, TrajectoryChunk

HOME = np.array(yumi.HOME["right"])


@pytest.fixture
def backend() -> HoldBackend:
    """A robot in a process that has met no message yet."""
    for table in (ros2_types.store, controller_state._layout):
        table.cache_clear()
    return HoldBackend(HOME)


def test_first_messages_of_every_kind_build_nothing(backend: HoldBackend) -> None:
    names = backend.joint_names
    chunk = TrajectoryChunk.of(0, names, JointTrajectory.resting(HOME, 50))
    payload = encode_chunk(chunk)  # by a session: in another process
    ros2_types.store.cache_clear()
    validator = ChunkValidator(
        ValidationRules(joint_names=names, grid_ns=GRID_NS), limit_check(LAB, None)
    )
    warm_up(backend, validator)
    built, laid_out = dict(ros2_types.store().cache), controller_state._layout.cache_info().misses
    ours = RobotStatus(7, ServerState.HOLDING, "armed", event=ServerEvent.CHUNK)
    assert RobotStatus.decode(ours.encode()) is not None
    finger = JointStates(7, ("gripper_r_joint",), HOME[:1], HOME[:1], HOME[:0])
    decode_joint_states(encode_joint_states(finger))
    with pytest.raises(TransportError):
        decode_chunk(payload[:-9])
    decode_chunk(payload)
    rest = JointPoint(HOME, HOME, HOME)
    encode_controller_state(ControllerState(7, names, rest, HOME, HOME, HOME))
    assert ros2_types.store().cache == built
    assert controller_state._layout.cache_info().misses == laid_out


def test_an_arm_that_may_be_nowhere_is_no_obstacle(backend: HoldBackend) -> None:
    asked = []

    def refuse(*_: object) -> None:
        asked.append(True)
        raise LimitViolationError("hand", 1.0, 0.0)

    rules = ValidationRules(joint_names=backend.joint_names, grid_ns=GRID_NS)
    warm_up(backend, ChunkValidator(rules, refuse, {"touch": refuse}))
    assert len(asked) == 2
