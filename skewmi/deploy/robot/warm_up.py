"""Doing once what a robot server does in its cycles: first calls load code and build tables.

The first message of a type takes some 60 ms on a slow computer, and the first judgement of a chunk
is no better: 15 cycles of a controller that nobody answers, in the middle of a motion if it is the
first command to a gripper.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from skewmi.deploy.robot.backend import RobotBackend
from skewmi.deploy.robot.executor import PlanExecutor
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.safety.validation import ChunkValidator
from skewmi.deploy.wire.controller_state import ControllerState, encode_controller_state
from skewmi.deploy.wire.messages import (
    JointStates,
    decode_chunk,
    decode_joint_states,
    encode_chunk,
    encode_joint_states,
)
from skewmi.errors import CommandRefusedError
from skewmi.robot_models import yumi
from skewmi.trajectory import JointPoint, JointTrajectory, TrajectoryChunk

_STAMP_NS = 0


def warm_up(backend: RobotBackend, validator: ChunkValidator) -> None:
    """Encode, decode and judge one of everything, sending nothing.

    Args:
        backend: Gives the names of the joints; it need not be open.
        validator: Judges a chunk of an arm that rests, for each of its workspaces.
    """
    names = backend.joint_names
    zeros = np.zeros(len(names))
    decode_joint_states(encode_joint_states(JointStates(_STAMP_NS, names, zeros, zeros, zeros)))
    RobotStatus(_STAMP_NS, ServerState.DISARMED, "").encode()
    resting = JointTrajectory.resting(np.array(yumi.HOME["right"]), 2)
    payload = encode_chunk(TrajectoryChunk.of(_STAMP_NS, names, resting))
    chunk = decode_chunk(payload)
    encode_controller_state(
        ControllerState(_STAMP_NS, names, JointPoint(zeros, zeros, zeros), zeros, zeros, zeros)
    )
    plan = PlanExecutor(resting.q[0], _STAMP_NS)
    for workspace in validator.workspaces:
        # A resting arm may be in none of them; it has been looked at all the same.
        with suppress(CommandRefusedError):
            validator.check(chunk, plan, _STAMP_NS, workspace)
