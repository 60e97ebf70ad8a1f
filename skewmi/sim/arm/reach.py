"""Which states a task with an arm can be in: a cheap outer bound for goals and densities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import yumi
from skewmi.sim.arm.arm_task import ArmTask

STOP_MARGIN = 0.003
"""How far the soft stops of the fingers give way, m."""
HAND_MARGIN = 0.015
"""How far contact may push the hand out of its box, m: as far as the following error goes."""

TIP = yumi.GRIPPER.finger_origin_z + yumi.GRIPPER.finger_size[2]
"""Distance from the flange to the fingertips, m."""


def reachable(task: ArmTask, layout: PolicyLayout, state: Array) -> NDArray[np.bool_]:
    """Whether states are within every range, and possible as far as the task tells.

    An outer bound: it excludes the impossible cheaply and may let some impossible states pass.

    Args:
        task: Whose scene.
        layout: Of the task.
        state: Fields in layout order. Shape (..., >= state_dim).

    Returns:
        Shape (...).
    """
    state = np.asarray(state, dtype=np.float64)
    value = {field.name: state[..., i] for i, field in enumerate(layout.state_fields)}
    possible = np.ones(state.shape[:-1], dtype=np.bool_)
    margins = {"gripper": STOP_MARGIN} | {joint.field.name: joint.give for joint in task.joints}
    for field in layout.state_fields:
        margin = margins.get(field.name, HAND_MARGIN)
        possible &= value[field.name] >= field.low - margin
        possible &= value[field.name] <= field.high + margin
    if task.possible is not None:
        possible &= task.possible(value)
    return possible
