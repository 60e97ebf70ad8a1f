"""A task before a robot whose box stands elsewhere: what a calibration makes of a workspace.

Simulation, session and robot server all place a workspace here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skewmi.calibration.calibration_file import Calibration
from skewmi.errors import ConfigurationError, KinematicsError
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models.base_frame import BaseFrame, BoxPose
from skewmi.robot_models.frames import rotation_from_quaternion
from skewmi.robot_models.hand_stiffness import hand_stiffness
from skewmi.robot_models.kinematics import ArmKinematics, require_converged

if TYPE_CHECKING:
    from skewmi.robot_models.start_search import Rating

LEAST_JOINT_MARGIN = np.radians(5.0)
"""That every joint keeps to its bounds in the whole box, rad."""
LEAST_SINGULAR_VALUE = 0.1
"""Of the Jacobian, length unit 0.3 m: a quarter of what it is in the tasks."""
LEAST_CLEARANCE = 0.02
"""Of the arm to table, torso and left arm in the whole box, m."""


def box_displacement(calibration: Calibration | None) -> tuple[float, float, float] | None:
    """x (m), y (m) and yaw_deg of the box that a calibration gives; None if it was not found.

    The middles of the intervals count, however wide they are.
    """
    scene = None if calibration is None else calibration.scene
    if scene is None or all(c.assumed[0] for c in (scene.x, scene.y, scene.yaw_deg)):
        return None
    return scene.x.value[0], scene.y.value[0], scene.yaw_deg.value[0]


def box_pose(
    displacement: tuple[float, float, float] | None,
    origin: tuple[float, float] | None,
    task: str,
) -> BoxPose | None:
    """A displacement of a task's box; None for none.

    Args:
        displacement: See `box_displacement`.
        origin: Middle of the box that is not displaced, task's frame, m; None if the task has
            none that is looked for.
        task: Its name, for the message.

    Raises:
        ConfigurationError: The task has no box, or the displacement is too large.
    """
    if displacement is None:
        return None
    if origin is None:
        raise ConfigurationError(
            f"the calibration says where a box stands (section scene), and task {task!r} has none: "
            "give a calibration without that section"
        )
    return BoxPose(*displacement, *origin)


def placed(workspace: Workspace, box: BoxPose | None) -> Workspace:
    """A task's workspace with the robot where it is in the frame of the calibrated box.

    The hand starts in the same pose before the box; the joints that put it there are found anew.

    Args:
        workspace: Of a box that is not displaced.
        box: Where it is known to stand; None if nobody looked for it.

    Raises:
        ConfigurationError: The arm cannot reach all of the task's box there, or comes too near to
            a joint's bound or to something.
    """
    nominal = BaseFrame.of(workspace)
    base = nominal if box is None else box.base_frame(nominal)
    if box is None or base == nominal:
        return workspace
    rotation = base.rotations_to_base(rotation_from_quaternion(workspace.hand_quaternion_wxyz))
    posture = np.array(workspace.start_configuration)
    result = ArmKinematics("right").inverse(
        base.to_base(workspace.start),
        rotation,
        posture,
        posture=posture,
        max_iterations=150,
        position_tolerance=1e-10,
        rotation_tolerance=1e-10,
    )
    try:
        require_converged(result)
    except KinematicsError as error:
        raise _refusal(box, f"the hand cannot be put at the task's start ({error})") from error
    _require_room(box, workspace, base, rotation, result.q)
    return replace(
        workspace,
        base_position=base.position,
        base_yaw=base.yaw,
        start_configuration=tuple(result.q.tolist()),
    )


def known_stiffness(calibration: Calibration | None, workspace: Workspace) -> Array | None:
    """What a command integrator takes of it, along the axes of a workspace's frame.

    Args:
        calibration: Of the robot; None if nothing is known.
        workspace: Placed where the box is known to stand. The stiffness is that at its start.

    Returns:
        See `hand_stiffness`. Shape (3, 3); None if the servos were not calibrated.
    """
    servo = None if calibration is None else calibration.servo
    if servo is None:
        return None
    matrix = hand_stiffness(np.array(servo.kp.value), np.array(workspace.start_configuration))
    base = BaseFrame.of(workspace)
    if base.yaw == 0.0:
        return matrix
    turned: Array = base.rotation @ matrix @ base.rotation.T
    return turned


def _require_room(
    box: BoxPose, workspace: Workspace, base: BaseFrame, rotation: Array, start: Array
) -> None:
    # MuJoCo, which who never meets a displaced box does without.
    from skewmi.robot_models.start_search import HandRoom, rate

    room = HandRoom(workspace.start, workspace.low, workspace.high)
    found = rate(start[None], room=room, base=base, rotation=rotation)
    if not found.reached[0]:
        raise _refusal(box, "the hand cannot reach all corners of the task's box")
    for what, value, least, unit in _figures(found):
        if not value >= least:
            bound = f"at least {least:.3g}{unit} is allowed"
            raise _refusal(box, f"{what} would be {value:.3g}{unit} at worst, {bound}")


def _figures(found: Rating) -> tuple[tuple[str, float, float, str], ...]:
    return (
        (
            "the distance of a joint to its bound",
            float(np.degrees(found.joint_margin[0])),
            float(np.degrees(LEAST_JOINT_MARGIN)),
            " degrees",
        ),
        (
            "the smallest singular value of the arm",
            float(found.singular_value[0]),
            LEAST_SINGULAR_VALUE,
            "",
        ),
        ("the arm's distance to the table", float(found.table_clearance[0]), LEAST_CLEARANCE, " m"),
        (
            "the arm's distance to torso and left arm",
            float(found.body_clearance[0]),
            LEAST_CLEARANCE,
            " m",
        ),
    )


def _refusal(box: BoxPose, why: str) -> ConfigurationError:
    return ConfigurationError(
        f"{box.words}, where the task cannot be done: {why}; put the box nearer to its place, and "
        "find it again by skewmi calibrate scene"
    )
