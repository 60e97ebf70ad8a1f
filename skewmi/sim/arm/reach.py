"""Which states OpenPressClose can be in: a cheap outer bound for goals and densities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import yumi

STOP_MARGIN = 0.003
"""How far soft stops of button and fingers and the lid's surface give way, m."""
LID_MARGIN = 0.02
"""How far the lid's stops give way when something slams into it, rad."""
HAND_MARGIN = 0.015
"""How far contact may push the hand out of its box, m: as far as the command may lead it."""

_TIP = yumi.GRIPPER.finger_origin_z + yumi.GRIPPER.finger_size[2]
"""Distance from the flange to the fingertips, m."""
_LID_TOP = 0.076
_LID_EDGE = -0.020
"""Height of the shut lid and 10 mm inside where it ends at the hinge (the hand may tilt), world,
m."""
_LID_NEARLY_SHUT = 0.2
"""Below this angle no finger gets under the lid, rad: its edge is less than 30 mm up."""


def reachable(layout: PolicyLayout, state: Array) -> NDArray[np.bool_]:
    """Whether states satisfy every bound and no fingertip would be below a shut lid.

    An outer bound: it excludes the impossible cheaply and may let some impossible states pass.

    Args:
        layout: Of the task.
        state: Fields in layout order. Shape (..., >= state_dim).

    Returns:
        Shape (...).
    """
    assert layout.workspace is not None
    state = np.asarray(state, dtype=np.float64)
    names = layout.observation_names
    value = {name: state[..., i] for i, name in enumerate(names[: layout.state_dim])}
    possible = np.ones(state.shape[:-1], dtype=np.bool_)
    margins = {"lid_angle": LID_MARGIN, "gripper": STOP_MARGIN, "button_depth": STOP_MARGIN}
    for field in layout.state_fields:
        margin = margins.get(field.name, HAND_MARGIN)
        possible &= value[field.name] >= field.low - margin
        possible &= value[field.name] <= field.high + margin
    tip = value["hand_z"] - _TIP
    inner_finger = value["hand_y"] - value["gripper"] - yumi.GRIPPER.finger_size[0]
    below_lid = (tip < _LID_TOP - STOP_MARGIN) & (inner_finger < _LID_EDGE)
    possible &= ~(below_lid & (value["lid_angle"] < _LID_NEARLY_SHUT))
    return possible
