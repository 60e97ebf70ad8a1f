"""What a session keeps to in a workspace other than the task's, from what the robot server says."""

from __future__ import annotations

from skewmi.deploy.robot.description import FLANGE_SPEED, RobotDescription
from skewmi.deploy.safety.checks import SpaceChecks
from skewmi.deploy.safety.flange_space import TASK, TOUCH, FlangeSpace
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT
from skewmi.deploy.safety.obstacles import scene_obstacles
from skewmi.deploy.wire.scene_geometry import SceneGeometry
from skewmi.errors import ConfigurationError
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.obstacle import Obstacle


def obstacles_before(description: RobotDescription, margin: float = 0.0) -> tuple[Obstacle, ...]:
    """What a robot server says that stands before it; nothing if it tells no scene.

    Args:
        description: Asked for with its scene.
        margin: See `open_space`.
    """
    if not description.scene:
        return ()
    parts = SceneGeometry.from_json(description.scene).parts
    return scene_obstacles(parts, margin, description.base_frame)


def open_space(
    description: RobotDescription, workspace: str, limits: JointLimits, *, margin: float = 0.0
) -> SpaceChecks:
    """Checks of all motion in a workspace, its box, and the scene's boxes as obstacles.

    Args:
        description: Of the robot server, asked for with its scene (`describe(with_scene=True)`).
        workspace: Its name; for "touch" the scene is no obstacle.
        limits: Of the joints, to plan with.
        margin: Added to the scene's boxes on every side, m: for a scene that is not exactly where
            it is said to be.

    Raises:
        ConfigurationError: The robot server does not offer it, or its scene was not asked for.
    """
    offered = {name: told for name, told in description.workspaces.items() if name != TASK}
    if workspace not in offered:
        raise ConfigurationError(
            f"the robot server offers no workspace {workspace!r}; it offers: "
            f"{', '.join(offered) or 'none besides the task'}"
        )
    if not description.scene:
        raise ConfigurationError(
            "the description has no scene: ask the robot server for it, as without it nobody knows "
            "what the arm must stay clear of"
        )
    obstacles = () if workspace == TOUCH else obstacles_before(description, margin)
    speed = description.limits.get(FLANGE_SPEED, (TCP_SPEED_LIMIT,))[0]
    space = FlangeSpace.from_numbers(workspace, offered[workspace])
    return SpaceChecks(limits, space, obstacles, speed)
