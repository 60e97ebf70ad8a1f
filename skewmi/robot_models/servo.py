"""Position servos of the simulated arm: gains, force limits, friction, with where they come from.

ABB publishes none of these. They are named estimates to start from; `skewmi calibrate servo`
identifies them on a robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import Array

LINK_SIDE_INERTIA: Array = np.array([0.26, 0.51, 0.083, 0.12, 0.0038, 0.0035, 0.0002])
"""Inertia of the arm and empty gripper about each joint axis, kg m^2: median over 2000 random
poses of the estimated masses in `yumi` [C]. Shape (7,)."""

ARMATURE: Array = np.array([0.10, 0.10, 0.05, 0.05, 0.01, 0.01, 0.01])
"""Rotor inertia seen at the joint, kg m^2 [C]: about 1e-5 kg m^2 (large axes), 5e-6 and 1e-6
(wrist) times a gear ratio of 100 squared. Shape (7,)."""

STIFFNESS: Array = np.array([750.0, 750.0, 400.0, 400.0, 100.0, 100.0, 30.0])
"""Servo stiffness, N m/rad [C]: about a sixth of the joints' own measured stiffness (4400 N m/rad
on axis 1), so that the servo and not the gearbox is the soft part; some 4 kN/m at the hand
where it works at a table. Shape (7,)."""

FORCE_LIMIT: Array = np.array([12.5, 12.5, 6.0, 6.0, 2.0, 2.0, 1.0])
"""Largest servo torque beyond gravity, N m [C]: a sixth to a half of the second-hand joint
torques. At a table the hand then pushes down with 22 to 25 N standing, which suits a
collaborative robot. Gravity is compensated outside it. Shape (7,)."""

FRICTIONLOSS: Array = np.array([0.28, 0.28, 0.12, 0.12, 0.046, 0.046, 0.046])
"""Dry friction that the controller does not compensate, N m [C]: a fifth of 1.4, 0.6 and
0.23 N m, our reading of the controllers' friction feed-forward levels. Shape (7,)."""

DRY_SOLREF: tuple[float, float] = (0.008, 1.0)
DRY_SOLIMP: tuple[float, float, float, float, float] = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""MuJoCo's solver parameters of dry friction that holds a joint: time constant t of two time steps,
impedance d. Its friction constraint is soft, and below the speed R F / B it is nothing but viscous
(R = (1 - d) / d / inertia, B = 2 / (d t)): 0.1 rad/s for 2 N m in the wrist by default, so that a
joint creeps all the way under less torque than its friction. These make it 1e-4 rad/s."""


def critical_damping(stiffness: Array, armature: Array, ratio: float = 1.0) -> Array:
    """Damping of a servo of given damping ratio: 2 ratio sqrt(kp (I + armature)), N m s/rad."""
    return 2.0 * ratio * np.sqrt(stiffness * (LINK_SIDE_INERTIA + armature))


@dataclass(frozen=True)
class ServoParameters:
    """The servos of one arm, chain order, and of its fingers.

    torque = clip(kp (command - q) - kd v, ±force_limit), plus gravity compensation.

    Attributes:
        kp: N m/rad. Shape (7,).
        kd: N m s/rad. Shape (7,).
        force_limit: N m, beyond gravity. Shape (7,).
        frictionloss: Dry friction, N m. Shape (7,).
        armature: Rotor inertia at the joint, kg m^2. Shape (7,).
        finger_kp: Stiffness of the gripper, N/m: 1 mm of error gives the full grip force [C].
        finger_damping: Of the gripper's motor, N s/m: full force drives it at full speed, as a
            geared motor does; this bounds the speed physically.
        finger_force_limit: Grip force, N [A].
        finger_armature: Motor inertia as a mass at the fingers, kg [C].
        finger_frictionloss: Dry friction per finger, N [C].
        finger_lowest_command: Smallest commanded travel per finger, m: there the hook of one
            hooked finger meets the other finger.
    """

    kp: Array
    kd: Array
    force_limit: Array
    frictionloss: Array
    armature: Array
    finger_kp: float = 20_000.0
    finger_damping: float = yumi.GRIPPER.force / yumi.GRIPPER.speed
    finger_force_limit: float = yumi.GRIPPER.force
    finger_armature: float = 0.1
    finger_frictionloss: float = 0.5
    finger_lowest_command: float = yumi.GRIPPER.hook_length / 2

    def __post_init__(self) -> None:
        for name in ("kp", "kd", "force_limit", "frictionloss", "armature"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (7,) or not np.all(np.isfinite(value)) or np.any(value < 0.0):
                raise ConfigurationError(
                    f"servo {name} must be 7 finite numbers, none negative; got {value.tolist()}"
                )
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        for name in (
            "finger_kp",
            "finger_damping",
            "finger_force_limit",
            "finger_armature",
            "finger_frictionloss",
            "finger_lowest_command",
        ):
            number = getattr(self, name)
            if not (np.isfinite(number) and number >= 0.0):
                raise ConfigurationError(
                    f"servo {name} must be finite and not negative; got {number}"
                )

    def with_changes(self, **changes: Any) -> ServoParameters:
        """A copy with some fields replaced."""
        return replace(self, **changes)


DEFAULT = ServoParameters(
    kp=STIFFNESS,
    kd=critical_damping(STIFFNESS, ARMATURE),
    force_limit=FORCE_LIMIT,
    frictionloss=FRICTIONLOSS,
    armature=ARMATURE,
)
"""Where simulation starts before calibration."""

_CONTACT_STIFFNESS = np.array([300.0, 300.0, 200.0, 200.0, 600.0, 600.0, 300.0])
CONTACT_SERVO = DEFAULT.with_changes(
    kp=_CONTACT_STIFFNESS,
    kd=critical_damping(_CONTACT_STIFFNESS, ARMATURE),
    force_limit=np.array([12.5, 12.5, 6.0, 6.0, 6.0, 6.0, 6.0]),
)
"""For work in contact, what policies are trained with. A soft arm bounds the force that the
following error of the hand can build up, and a wrist that is stiff and strong for its size keeps
the hand upright under it (the joints' own wrist stiffness is above 450 N m/rad): with the wrist at
100 N m/rad and 2 N m a sideways push of 12 N at the fingertips overpowered it, and the hand tilted
by up to 40 degrees. An estimate like `DEFAULT`, to be replaced by identified values."""
