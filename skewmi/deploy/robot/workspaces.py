"""Which workspaces a robot server can grant besides the task's, and whether it may now."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skewmi.deploy.robot.backend import Scene, StandsKnown
from skewmi.deploy.safety.flange_space import TASK, FlangeSpace, flange_spaces
from skewmi.deploy.safety.obstacles import scene_obstacles
from skewmi.deploy.wire.scene_geometry import SceneGeometry
from skewmi.errors import CommandRefusedError
from skewmi.robot_models.base_frame import BoxPose, base_of

HINGE_OPEN = 0.4
"""Largest reading of a hinge at which it is taken to be shut, rad: an uncalibrated one may read 20
degrees when it is."""
SLIDE_OUT = 0.010
"""The same of a slide, m."""


def spaces_of(scene: Scene | None) -> dict[str, FlangeSpace]:
    """What can be granted before a scene; nothing if its shapes or its task's box are not known."""
    if scene is None or not scene.shapes_json:
        return {}
    parts = SceneGeometry.from_json(scene.shapes_json).parts
    base = base_of(told_box(scene))
    return flange_spaces(scene.workspace, scene_obstacles(parts, base=base))


def told_box(scene: Scene | None) -> BoxPose | None:
    """Where a scene's box is known to stand; None if nobody looked for it."""
    return scene.known_box if isinstance(scene, StandsKnown) else None


def check_scene_is_shut(scene: Scene) -> None:
    """Refuse a scene that does not stand as the boxes around it were made: all joints at zero.

    A scene whose joints the robot server does not know is left to the commander.

    Raises:
        CommandRefusedError: A joint is too far from zero.
    """
    state = scene.state()
    if state is None:
        return
    kinds = {joint.name: joint.kind for joint in SceneGeometry.from_json(scene.shapes_json).joints}
    for name, position in zip(state.names, state.position, strict=True):
        hinge = kinds.get(name, "hinge") == "hinge"
        most, unit = (HINGE_OPEN, "rad") if hinge else (SLIDE_OUT, "m")
        if not np.abs(position) <= most:
            raise CommandRefusedError(
                f"{name} is at {position:.3g} {unit}; no more than {most:g} {unit} from shut is "
                "allowed outside of the task's workspace: shut it, or reset the scene; a hand that "
                "is in the way is led out by `skewmi jog --workspace task`"
            )


def workspaces_told(
    scene: Scene | None, spaces: Mapping[str, FlangeSpace]
) -> dict[str, dict[str, tuple[float, ...]]]:
    """Every workspace by name, for the description; corners from the robot base on, m.

    They are along its axes. The task's is along those of the task's frame, if that is turned:
    `yaw` (rad) tells how, in the base frame.
    """
    told = {name: space.numbers() for name, space in spaces.items()}
    workspace = None if scene is None else scene.workspace
    if workspace is None:
        return told
    base = workspace.base_position
    corners: dict[str, tuple[float, ...]] = {
        corner: tuple(c - b for c, b in zip(getattr(workspace, corner), base, strict=True))
        for corner in ("low", "high")
    }
    if workspace.base_yaw != 0.0:
        corners["yaw"] = (-workspace.base_yaw,)
    return {TASK: corners, **told}
