"""What a policy of DoorOpen sees and does, when it has succeeded, and what may vary.

Numbers are from the Skew-Explore "yumi_door" environment unless a comment says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, Ball, Field
from skewmi.robot_models import yumi
from skewmi.sim.arm.arm_task import ArmTask, SensedJoint
from skewmi.sim.arm.reach import TIP
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
)
from skewmi.sim.tasks.door_open import parts, targets
from skewmi.sim.variation import VariationKey, Variations

GRIPPER_OPENING = 0.020
"""Finger travel while the policy does not move the fingers, m (ours): the hook passes beside the
bar within the hand's box, and the gripper's own body stays clear of the panel up to its stop."""

DOOR = SensedJoint(
    "door_hinge",
    Field("door_angle", "rad", "hinge", 0.0, parts.DOOR_MAX),
    give=0.02,
    bias_key="sensors.door_bias_deg",
    noise_key="sensors.door_noise_deg",
)
"""Its stops give way when something slams into it."""

VARIATION_KEYS = (
    *SERVO_KEYS,
    joint_key("door.frictionloss", "dof_frictionloss", DOOR.name, 0.0, 2.0, "N m"),
    joint_key("door.damping", "dof_damping", DOOR.name, 0.0, 1.0, "N m s/rad"),
    mass_key("door.mass", "door", 0.01, 1.0),
    *CONTACT_KEYS,
    *pose_keys("door_pose", "door_frame"),
    *SENSOR_KEYS,
    VariationKey("sensors.door_bias_deg", -20.0, 20.0, "deg"),
    VariationKey("sensors.door_noise_deg", 0.0, 20.0, "deg"),
    *GRIPPER_KEYS,
    *MASS_KEYS,
    *LINK_KEYS,
    *COMMAND_KEYS,
)

_INSIDE = 0.004
"""How deep a point of the hand must be inside the panel to be impossible, m: contact is soft and
the hand may tilt."""


def outside_door(value: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Whether neither finger would be inside the panel; see `ArmTask.possible`."""
    y, tip, angle = value["hand_y"], value["hand_z"] - TIP, value["door_angle"]
    finger = value["gripper"] + yumi.GRIPPER.finger_size[0] / 2
    length = TIP - yumi.GRIPPER.finger_origin_z
    (_, low_y, low_z), (_, high_y, high_z) = parts.PANEL
    outside: NDArray[np.bool_] = np.ones(np.shape(tip), dtype=np.bool_)
    for side in (-1.0, 1.0):
        # Closer together than the panel is thick.
        for up in np.linspace(0.0, length, 5):
            point_y, point_z = parts.in_door(y + side * finger, tip + up, angle)
            inside = (point_y > low_y + _INSIDE) & (point_y < high_y - _INSIDE)
            inside &= (point_z > low_z + _INSIDE) & (point_z < high_z - _INSIDE)
            outside &= ~inside
    return outside


def region(angle: float) -> tuple[Ball, ...]:
    """The reward region of an angle, rad."""
    return (Ball((DOOR.field.name,), (angle,), targets.RADIUS),)


REGIONS = {name: region(angle) for name, angle in targets.TARGETS.items()}

ARM = ArmTask(
    name="door_open",
    low=(-0.1, -0.08, 0.20),
    high=(0.0, 0.03, 0.30),
    # The original starts its hand above its box and drags it there.
    start=(0.0, 0.0, 0.30),
    # The arm as it begins on the table, `yumi.TABLE_CONFIGURATION`, taken here by `solve_start` of
    # `robot_models.start_search`. Its `search` finds postures with two degrees more to the joints'
    # bounds, from which the limits of profile lab let the hand move at 130 mm/s: less than an
    # action asks for. From this one it is 198 mm/s.
    start_configuration=(
        1.587032708937,
        -0.868485492562,
        -1.310178854329,
        0.749821843101,
        -1.95844430559,
        1.512943232032,
        3.054075925045,
    ),
    joints=(DOOR,),
    add_parts=parts.add_parts,
    success=REGIONS[targets.DEFAULT],
    targets=REGIONS,
    gripper_opening=GRIPPER_OPENING,
    possible=outside_door,
    variations=Variations(VARIATION_KEYS, ("skewmi.sim.tasks.door_open",)),
)
make_layout = ARM.layout
