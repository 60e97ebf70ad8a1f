"""Which faces of a box are touched, where, and by which paths of the joints."""

from __future__ import annotations

from collections.abc import Callable
from math import pi, sin

import numpy as np

from skewmi.calibration.contact_watch import FREE_WAY, tip_jacobian
from skewmi.calibration.finger_contact import TIP
from skewmi.calibration.scene_faces import SHIFT, TURN, Face, top_of
from skewmi.cli.scene_shapes import SceneBox
from skewmi.deploy.motion.hand_line import hand_line
from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.safety.flange_space import CALIBRATION, TOUCH
from skewmi.deploy.safety.guard import Guard
from skewmi.deploy.session.open_space import open_space
from skewmi.deploy.session.touch_plan import PlannedTouch
from skewmi.deploy.touch_motion import CLOSED
from skewmi.errors import ConfigurationError, KinematicsError, LimitViolationError
from skewmi.robot_models import yumi
from skewmi.robot_models.frames import HAND_DOWN, rotation_about
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.servo import ServoParameters
from skewmi.trajectory import Array

ORDER = ("near", "far", "left", "right")
"""Of preference: a hand beside the two short sides has most room."""
FACES_TOUCHED = 3
DEPTH = 0.015
"""How far below the upper edge of a face the finger tips are, m."""
CLEAR = 0.012
"""Room between finger and face before the creep, wherever the box stands, m."""
UNTOLD = 0.004
"""More room for an arm that does not follow exactly, m: at both ends of the creep."""
INSET = 0.010
"""How far from where a face may end a finger stays, m: as much may an arm be off sideways."""
OVER = 0.006
"""How far the finger tips are over what the workspace asks for when the hand turns slow, m."""
HIGH, INWARD = 0.020, 0.5
"""How much higher the ways between touches are, m, and which part of the way to the middle."""
_FINGER_WIDTH = CLOSED + yumi.GRIPPER.finger_size[0]
_FINGER_DEPTH = yumi.GRIPPER.finger_size[1] / 2.0
_KEPT = 0.008
"""Clearance of the hand to what it does not touch, at the nominal place, m."""
_LOOKED_AT = 21
_ALIKE = 0.05
"""Configurations nearer than that to another are not tried, rad."""
_STARTS = 12
_LEAST_MARGIN, _LEAST_SINGULAR = 0.03, 0.035


class TouchPlanner:
    """Plans touches of the scene that a robot server describes.

    Args:
        described: By the robot server, with the scene.
        limits: Of the joints.
        servo: What is known of the servos: friction holds the arm off its command.
        tell: Told in words what is left out, and why.
    """

    def __init__(
        self,
        described: RobotDescription,
        limits: JointLimits,
        servo: ServoParameters,
        tell: Callable[[str], None],
    ) -> None:
        self._limits, self._servo, self._tell = limits, servo, tell
        self._above, self._beside = (
            open_space(described, name, limits).space for name in (CALIBRATION, TOUCH)
        )
        self.box = SceneBox.of(described.scene)
        self._faces = self.box.faces
        self._clearance = Guard(limits, clearance=_KEPT, obstacles=self.box.obstacles).clearance
        self._arm = ArmKinematics("right")
        self._from = np.array(described.commanded_position)
        self._random = np.random.default_rng(0)

    def touches(self) -> list[PlannedTouch]:
        """Two touches on each of three faces.

        Raises:
            ConfigurationError: Fewer faces can be touched.
        """
        planned: list[PlannedTouch] = []
        axes: list[int] = []
        for name in ORDER:
            face = self._faces[name]
            if len(axes) == FACES_TOUCHED:
                break
            if len(axes) == FACES_TOUCHED - 1 and set(axes) == {face.axis}:
                continue
            before = self._from
            try:
                both = [self._touch(face, sign) for sign in (-1.0, 1.0)]
            except ConfigurationError as error:
                self._from = before
                self._tell(f"the {name} face is not touched: {error}")
                continue
            planned += both
            axes.append(face.axis)
        if len(set(axes)) < 2:
            raise ConfigurationError(
                "the hand cannot touch two faces of the box that meet; if it stands beside the box "
                "or elsewhere than where the task starts: skewmi home; else measure "
                "points of the box by hand (--points), or a marker (--marker)"
            )
        return planned

    def _touch(self, face: Face, side: float) -> PlannedTouch:
        offset = face.sure_reach(_FINGER_WIDTH) - INSET
        if offset < 2.0 * _FINGER_WIDTH:
            raise ConfigurationError("it is too narrow for two touches apart")
        offset *= side
        top = top_of(face, self.box.standing, offset, _FINGER_WIDTH + INSET)
        flange_z = max(top - DEPTH + TIP, self._beside.low[2] + UNTOLD)
        drift = SHIFT + sin(TURN) * (abs(offset) + _FINGER_WIDTH)
        contact = face.place(offset, flange_z) + _FINGER_DEPTH * face.normal
        beside = contact + (max(CLEAR, FREE_WAY) + drift + UNTOLD) * face.normal
        inside = contact - (drift + UNTOLD) * face.normal
        above, high = beside.copy(), beside.copy()
        above[2] = self._above.fingers_above + OVER + TIP
        # Over the box, where the arm has more room than beside it: neither folded nor stretched.
        high[:2] += INWARD * (np.array(face.middle) - high[:2])
        high[2] = above[2] + HIGH
        reasons = "out of reach"
        for q in self._postures(face, beside):
            try:
                touch = self._paths(face, top, q, (high, above, beside, inside))
                self._require_clear(touch)
            except ConfigurationError as error:
                reasons = str(error)
                continue
            self._from = touch.lower.at(0.0)
            return touch
        raise ConfigurationError(reasons)

    def _postures(self, face: Face, position: Array) -> list[Array]:
        """Configurations with the fingers' narrow side to the face, those near the start first."""
        turns = (0.0, pi) if face.axis == 0 else (pi / 2.0, -pi / 2.0)
        found: list[Array] = []
        for turn in turns:
            starts = np.tile(np.array(yumi.TABLE_CONFIGURATION), (_STARTS, 1))
            starts[1:] += self._random.normal(0.0, 0.4, (_STARTS - 1, 7))
            result = self._arm.inverse(
                np.tile(position, (_STARTS, 1)),
                rotation_about(2, turn) @ HAND_DOWN,
                starts,
                posture=np.array(yumi.TABLE_CONFIGURATION),
                posture_iterations=5,
                max_iterations=40,
            )
            reached = (result.position_error < 1e-5) & (result.rotation_error < 1e-5)
            for q in result.q[reached]:
                new = all(np.abs(q - other).max() > _ALIKE for other in found)
                if new and self._is_mobile(q):
                    found.append(q)
        return sorted(found, key=lambda q: float(np.abs(q - self._from).max()))

    def _is_mobile(self, q: Array) -> bool:
        margin = np.minimum(q - self._limits.position_lower, self._limits.position_upper - q).min()
        weights = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])[:, None]
        value = np.linalg.svd(weights * self._arm.jacobian(q), compute_uv=False)[-1]
        return bool(margin > _LEAST_MARGIN and value > _LEAST_SINGULAR)

    def _paths(self, face: Face, top: float, q: Array, places: tuple[Array, ...]) -> PlannedTouch:
        """Paths of the hand through places, each off by what friction holds the arm off."""
        high, above, beside, inside = places
        down, creep = self._held_off(q, beside - above), self._held_off(q, inside - beside)
        # What is commanded over the scene keeps its height, too: a soft arm is commanded lower
        # than it goes by a centimetre and more.
        lift = np.array([0.0, 0.0, max(-float(down[2]), 0.0)])
        high, above = high + lift, above + lift
        creep_path = self._line(q, beside + down, inside + creep)
        up = self._line(q, beside + down, above + down)
        raised = self._line(up.at(up.length), above + down, high + down)
        down_path, lower = up.reversed(), raised.reversed()
        return PlannedTouch(face.name, face.normal, top, lower, down_path, creep_path)

    def _held_off(self, q: Array, way: Array) -> Array:
        """What to add to commands of the hand along a way so that it goes there, m.

        A joint that turns is friction / kp behind its command; one that turns by less than twice
        that may still be on its other side. Shape (3,).
        """
        jacobian = tip_jacobian(self._arm, q)
        turned = np.linalg.pinv(self._arm.jacobian(q))[:, :3] @ way
        behind = self._servo.frictionloss / self._servo.kp
        part = np.clip(turned / np.maximum(2.0 * behind, 1e-9), -1.0, 1.0)
        off: Array = jacobian @ (part * behind)
        return off

    def _line(self, q: Array, start: Array, end: Array) -> JointPath:
        """See `hand_line`; refused where the arm is hardly mobile."""
        try:
            return hand_line(self._arm, q, start, end, self._require_mobile)
        except KinematicsError as error:
            raise ConfigurationError(str(error)) from error

    def _require_mobile(self, q: Array) -> None:
        if not self._is_mobile(q):
            raise ConfigurationError("the arm would be stretched, or at the end of a joint")

    def _require_clear(self, touch: PlannedTouch) -> None:
        """Raises ConfigurationError if the arm comes too near something on the way there."""
        way = JointPath.line(self._from, touch.lower.at(0.0))
        try:
            for path in (touch.down, touch.lower, way):
                self._clearance.check(path.at(np.linspace(0.0, path.length, _LOOKED_AT)))
        except LimitViolationError as error:
            raise ConfigurationError(str(error)) from error
        for q in touch.creep.at(np.linspace(0.0, touch.creep.length, 5)):
            for first, second, distance in self._clearance.distances(q):
                if distance > _KEPT:
                    break
                if "finger" not in first + second:
                    raise ConfigurationError(
                        f"{first} would come within {1e3 * distance:.0f} mm of {second}"
                    )
