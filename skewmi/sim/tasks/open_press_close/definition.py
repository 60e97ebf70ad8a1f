"""What a policy of OpenPressClose sees and does, when it has succeeded, and what may vary.

Numbers are from the Skew-Explore "yumi_door_button" environment unless a comment says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, Ball, Field
from skewmi.robot_models import yumi
from skewmi.sim.arm.arm_task import ArmTask, SensedJoint
from skewmi.sim.arm.reach import STOP_MARGIN, TIP
from skewmi.sim.arm.variation_keys import (
    COMMAND_KEYS,
    CONTACT_KEYS,
    GRIPPER_KEYS,
    LINK_KEYS,
    MASS_KEYS,
    SENSOR_KEYS,
    SERVO_KEYS,
    joint_key,
    mass_key,
    pose_keys,
    travel_key,
)
from skewmi.sim.tasks.open_press_close import parts
from skewmi.sim.variation import VariationKey, Variations

GRIPPER_OPENING = 0.014
"""Finger travel while the policy does not move the fingers, m: the bar fits between them with
the hook behind it."""

LID_SHUT = 0.035
"""Largest lid angle that counts as shut, rad: the lid's edge is then 5 mm above its rest."""
PRESSED_MIN = 0.010
"""Smallest button depth that counts as pressed, m (the paper's 1 cm)."""
PRESSED_MAX = 0.032
"""The button's stop, with room for the softness of a simulated stop, m."""

_LID_TOP = 0.076
_LID_EDGE = -0.020
"""Height of the shut lid and 10 mm inside where it ends at the hinge (the hand may tilt), world,
m."""
_LID_NEARLY_SHUT = 0.2
"""Below this angle no finger gets under the lid, rad: its edge is less than 30 mm up."""

LID = SensedJoint(
    "lid_hinge",
    Field("lid_angle", "rad", "hinge", 0.0, parts.LID_MAX),
    give=0.02,
    bias_key="sensors.lid_bias_deg",
    noise_key="sensors.lid_noise_deg",
)
"""Its stops give way when something slams into it."""
BUTTON = SensedJoint(
    "button_slide",
    Field("button_depth", "m", "slide", 0.0, parts.BUTTON_TRAVEL),
    noise_key="sensors.button_noise",
)

VARIATION_KEYS = (
    *SERVO_KEYS,
    joint_key("lid.frictionloss", "dof_frictionloss", LID.name, 0.0, 2.0, "N m"),
    joint_key("lid.damping", "dof_damping", LID.name, 0.0, 1.0, "N m s/rad"),
    mass_key("lid.mass", "lid", 0.01, 1.0),
    joint_key("button.frictionloss", "dof_frictionloss", BUTTON.name, 0.0, 50.0, "N"),
    travel_key("button.travel", BUTTON.name, 0.012, 0.030, "m"),
    *CONTACT_KEYS,
    *pose_keys("box_pose", "box"),
    *SENSOR_KEYS,
    VariationKey("sensors.lid_bias_deg", -20.0, 20.0, "deg"),
    VariationKey("sensors.lid_noise_deg", 0.0, 20.0, "deg"),
    VariationKey("sensors.button_noise", 0.0, 0.01, "m"),
    *GRIPPER_KEYS,
    *MASS_KEYS,
    *LINK_KEYS,
    *COMMAND_KEYS,
)


def outside_shut_lid(value: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Whether no fingertip would be below a shut lid; see `ArmTask.possible`."""
    tip = value["hand_z"] - TIP
    inner_finger = value["hand_y"] - value["gripper"] - yumi.GRIPPER.finger_size[0]
    below_lid = (tip < _LID_TOP - STOP_MARGIN) & (inner_finger < _LID_EDGE)
    outside: NDArray[np.bool_] = ~(below_lid & (value["lid_angle"] < _LID_NEARLY_SHUT))
    return outside


ARM = ArmTask(
    name="open_press_close",
    low=(-0.019, -0.155, 0.190),
    high=(0.001, 0.135, 0.355),
    start=(-0.009, -0.1345, 0.270),
    start_configuration=yumi.TABLE_CONFIGURATION,
    joints=(LID, BUTTON),
    add_parts=parts.add_parts,
    success=(
        Ball(("lid_angle",), (0.0,), LID_SHUT),
        Ball(
            ("button_depth",),
            ((PRESSED_MIN + PRESSED_MAX) / 2,),
            (PRESSED_MAX - PRESSED_MIN) / 2,
        ),
    ),
    box_body="box",
    gripper_opening=GRIPPER_OPENING,
    possible=outside_shut_lid,
    variations=Variations(VARIATION_KEYS, ("skewmi.sim.tasks.open_press_close",)),
)
make_layout = ARM.layout
