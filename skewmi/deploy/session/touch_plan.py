"""What a run of touches is given, and what it tells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.safety.checks import SpaceChecks
from skewmi.deploy.safety.limits import LimitUsage
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import JointPoint, JointTrajectory


@dataclass(frozen=True, eq=False)
class PlannedTouch:
    """One touch, as paths that follow one another.

    Attributes:
        face: Name of what is touched.
        normal: Of it, outwards, base frame. Shape (3,).
        top: Height up to which it is there, base frame, m.
        lower: From high over the scene to just above it.
        down: From there to beside the face.
        creep: From there towards and into it.
    """

    face: str
    normal: Array
    top: float
    lower: JointPath
    down: JointPath
    creep: JointPath


@dataclass(frozen=True, eq=False)
class TouchReading:
    """What was measured at rest in contact.

    Attributes:
        touch: Which it was.
        q: Mean of the measured joints, rad. Shape (7,).
        scatter: Their standard deviation, rad. Shape (7,).
        opening: Mean of the measured travel of each finger, m.
        peak_force: Largest estimate, N.
    """

    touch: PlannedTouch
    q: Array
    scatter: Array
    opening: float
    peak_force: float


class SwitchedChecks:
    """Checks of the workspace that holds now.

    Args:
        spaces: By the workspace's name.
        flange_speed: That the robot admits, m/s.

    Attributes:
        speeds: Of flange and tips in each, m/s.
        now: Name of the workspace that holds.
    """

    def __init__(self, spaces: dict[str, SpaceChecks], flange_speed: float) -> None:
        self.spaces = spaces
        self.speeds = {name: min(s.space.speed, flange_speed) for name, s in spaces.items()}
        self.now = next(iter(spaces))

    @property
    def stages(self) -> Sequence[tuple[str, Callable[..., LimitUsage | None]]]:
        """As `SpaceChecks`."""
        return tuple((name, self._stage(name)) for name in ("check", "guard"))

    def _stage(self, name: str) -> Callable[..., LimitUsage | None]:
        def judge(
            samples: JointTrajectory, before: JointPoint, earlier: Array
        ) -> LimitUsage | None:
            return dict(self.spaces[self.now].stages)[name](samples, before, earlier)

        return judge


@dataclass(frozen=True, eq=False)
class TouchSettings:
    """How to touch.

    Attributes:
        limits: Of the joints.
        above, beside: Names of the workspaces.
        speeds: Of flange and tips in each, m/s.
        creep_speed: Towards a face, m/s.
        force_limit: N.
        opening: Of the fingers, m.
        tool_z: Of their tips on the flange's axis, m.
    """

    limits: JointLimits
    above: str
    beside: str
    speeds: dict[str, float]
    creep_speed: float
    force_limit: float
    opening: float
    tool_z: float


def require_touches(touches: Sequence[PlannedTouch]) -> None:
    """Raises ConfigurationError if paths do not follow one another."""
    for touch in touches:
        for first, second in ((touch.lower, touch.down), (touch.down, touch.creep)):
            if np.abs(first.at(first.length) - second.at(0.0)).max() > 1e-9:
                raise ConfigurationError(
                    f"the paths of a touch of the {touch.face} face do not follow one another"
                )
