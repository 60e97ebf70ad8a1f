"""Workspaces for ways that begin anywhere: what is checked in each of them."""

from __future__ import annotations

from skewmi.deploy.robot.description import FLANGE_SPEED, RobotDescription
from skewmi.deploy.safety.checks import SpaceChecks
from skewmi.deploy.safety.flange_space import CALIBRATION, TASK, TOUCH, TOUCH_SPEED, FlangeSpace
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT, WORKSPACE_TOLERANCE
from skewmi.deploy.session.open_space import obstacles_before, open_space
from skewmi.errors import ConfigurationError
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import Array

_MORE = 0.001
"""The task's box counts as so much larger than the robot server takes it for, m: who passes near it
must not be held back by it."""


def way_spaces(
    description: RobotDescription, limits: JointLimits, q: Array, *, slow: bool = False
) -> dict[str, SpaceChecks]:
    """Checks of all motion, by the workspace's name, for an arm that rests somewhere.

    The scene's boxes are obstacles in all of them. In "touch", and in a slow "task", the arm may
    leave where it stands too near something, but come no nearer (`ClearanceCheck.permit_leaving`).

    Args:
        description: Of the robot server, asked for with its scene.
        limits: Of the joints, to plan with.
        q: Where the arm rests, rad. Shape (7,).
        slow: Whether flange and finger tips move as slowly in "task" as in "touch".

    Raises:
        ConfigurationError: The robot server does not offer them, or its scene was not asked for.
    """
    calibration, touch = (open_space(description, name, limits) for name in (CALIBRATION, TOUCH))
    obstacles = obstacles_before(description)
    admitted = description.limits.get(FLANGE_SPEED, (TCP_SPEED_LIMIT,))[0]
    spaces = {
        CALIBRATION: calibration,
        TOUCH: SpaceChecks(limits, touch.space, obstacles, admitted),
        TASK: SpaceChecks(limits, _task_space(description, slow), obstacles, admitted),
    }
    for name in (TOUCH, TASK) if slow else (TOUCH,):
        spaces[name].guard.clearance.permit_leaving(q)
    return spaces


def _task_space(description: RobotDescription, slow: bool) -> FlangeSpace:
    """The task's box, which holds from inside as the others do."""
    try:
        corners = description.workspaces[TASK]
        (x, y, z), (high_x, high_y, high_z) = corners["low"], corners["high"]
        (yaw,) = corners.get("yaw", (0.0,))
    except (KeyError, ValueError) as error:
        raise ConfigurationError(
            "the robot server does not tell the task's workspace; is it of another version of "
            "skewmi?"
        ) from error
    room = WORKSPACE_TOLERANCE + _MORE
    return FlangeSpace(
        TASK,
        (x - room, y - room, z - room),
        (high_x + room, high_y + room, high_z + room),
        speed=TOUCH_SPEED if slow else TCP_SPEED_LIMIT,
        yaw=yaw,
    )
