"""Runs of the planner alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.deploy.motion.planner import Planner
from skewmi.policy_io import Array
from skewmi.robot_models import frames, yumi
from skewmi.robot_models.frames import rotation_vector
from skewmi.robot_models.kinematics import ArmKinematics

START = np.array(yumi.TABLE_CONFIGURATION)
KINEMATICS = ArmKinematics("right")


@dataclass
class Run:
    """What was executed and commanded, on the grid, from the start on."""

    q: Array
    a: Array
    hand_w: Array
    tilt: Array
    command_w: Array
    continued: int


def follow(
    planner: Planner, targets: list[Array], *, duration_s: float = 0.1, settle_cycles: int = 50
) -> Run:
    """Give one target per `duration_s`, then none, executing every cycle in time."""
    cycles = round(duration_s / 0.02)
    q, a, command, continued = [], [], [], 0
    for cycle in range(len(targets) * cycles + settle_cycles):
        if cycle % cycles == 0 and cycle // cycles < len(targets):
            planner.set_target(targets[cycle // cycles], duration_s)
        begin = planner.command_position
        chunk = planner.step()
        share = np.arange(5)[:, None] / 5
        command.append(begin + share * (planner.command_position - begin))
        q.append(chunk.q[:5])
        a.append(chunk.a[:5])
        continued += planner.held_back is not None
    position, rotation = KINEMATICS.forward(np.vstack(q))
    tilt = rotation_vector(np.swapaxes(rotation, -1, -2) @ frames.HAND_DOWN)
    return Run(
        np.vstack(q),
        np.vstack(a),
        position + np.array(planner.workspace.base_position),
        np.linalg.norm(tilt, axis=1),
        np.vstack(command),
        continued,
    )
