"""Named limits on joint motion.

ABB publishes joint positions and speeds, but no joint acceleration, jerk or torque. The profiles
below are therefore choices, NOT data: **none of them has been verified on hardware**. Raise a
profile only after watching the real robot follow it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians

import numpy as np

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import Array

POSITION_MARGIN = radians(2.0)
"""How far every profile stays inside the controller's own position bounds, rad. The controller
faults at its bounds; the margin leaves room for tracking error and encoder offsets (one lab
reports up to 52 mrad, mostly below 20)."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of the seven joints of one arm, chain order; both arms have the same.

    Attributes:
        name: Name of the profile.
        position_lower: rad. Shape (7,).
        position_upper: rad. Shape (7,).
        velocity: Largest |velocity|, rad/s. Shape (7,).
        acceleration: Largest |acceleration|, rad/s^2. Shape (7,).
        jerk: Largest |jerk|, rad/s^3. Shape (7,).
        torque: Largest |torque| including gravity, N m; second-hand [C]. Shape (7,).
    """

    name: str
    position_lower: Array
    position_upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array

    def __post_init__(self) -> None:
        for field in _VECTORS:
            value = np.array(getattr(self, field), dtype=np.float64)
            if value.shape != (7,) or not np.all(np.isfinite(value)):
                raise ConfigurationError(
                    f"limit profile {self.name!r}: {field} must be 7 finite numbers, got {value}"
                )
            value.flags.writeable = False
            object.__setattr__(self, field, value)
        if not np.all(self.position_lower < self.position_upper):
            raise ConfigurationError(
                f"limit profile {self.name!r}: position_lower {self.position_lower} must be below "
                f"position_upper {self.position_upper}"
            )
        for field in _VECTORS[2:]:
            if not np.all(getattr(self, field) > 0.0):
                raise ConfigurationError(
                    f"limit profile {self.name!r}: {field} must be positive, "
                    f"got {getattr(self, field)}"
                )

    def no_faster(self, joint_speed: float) -> JointLimits:
        """The same with no joint faster than that, rad/s; inf changes nothing."""
        return replace(self, velocity=np.minimum(self.velocity, joint_speed))


_VECTORS = ("position_lower", "position_upper", "velocity", "acceleration", "jerk", "torque")


def _profile(name: str, *, speed: float, acceleration: float, jerk: float) -> JointLimits:
    return JointLimits(
        name=name,
        position_lower=yumi.POSITION_LOWER + POSITION_MARGIN,
        position_upper=yumi.POSITION_UPPER - POSITION_MARGIN,
        velocity=speed * yumi.VELOCITY,
        acceleration=np.full(7, acceleration),
        jerk=np.full(7, jerk),
        torque=yumi.TORQUE,
    )


PROFILES: dict[str, JointLimits] = {
    # Half the data sheet's speed. 15 rad/s^2 is below the 20 rad/s^2 that the data sheet's
    # 11 m/s^2 tool acceleration implies on a shoulder axis at full stretch [C]; with 800 rad/s^3
    # it is reached in 19 ms, about the lag of the EGM interface.
    "lab": _profile("lab", speed=0.5, acceleration=15.0, jerk=800.0),
    # 1.7 rad/s^2 is what Lund University's YuMi library uses on the robot [B]. It stops from
    # 10 % of the data sheet's speed (0.31 rad/s) in 0.22 s and 35 mrad, 2 cm at full stretch;
    # more speed would make stops longer than that.
    "careful": _profile("careful", speed=0.1, acceleration=1.7, jerk=50.0),
}
"""The named profiles; none is verified on hardware."""


def profile(name: str) -> JointLimits:
    """The profile of that name.

    Raises:
        NotFoundError: There is none; the message lists the names.
    """
    try:
        return PROFILES[name]
    except KeyError:
        raise NotFoundError(
            f"no limit profile {name!r}; profiles are {', '.join(PROFILES)}"
        ) from None
