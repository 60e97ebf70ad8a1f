"""From commanded hand positions to chunks of joint motion that always end at rest.

    target (10 Hz) -> Cartesian shaper -> inverse kinematics -> joint shaper -> braking tail

`docs/planner.md` has the maths. Everything but the braking tail advances on the 4 ms grid, five
steps per 20 ms cycle. Usage, once per cycle:

    planner.set_target(position_w, duration_s)    # when the policy has acted
    chunk = planner.step()                        # always

**A verified stop always exists.** A chunk is its first sample (where the previous chunk is then),
the new samples, and the fastest stop from the last of them. It is published only if all of it,
between the samples too, lies inside the position limits, and its samples inside the box (with
tolerance) and the tool's speed limit. Otherwise `step` returns the rest of the previous chunk, of
which the same is known: by induction there is always a stop that has been checked.

No lock-up: near a joint bound or a face of the box the velocities are cut beforehand to what can
be stopped, so that the check rarely fails; then the shaped command is put back to where the braking
hand is. What is tried next is slower by half, and again, until it passes: from rest the same
attempt would fail for ever.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from skewmi.deploy.motion.brake import Array
from skewmi.deploy.motion.cartesian_shaper import CartesianShaper, Reference
from skewmi.deploy.motion.differential_ik import FEEDBACK_RATE, DifferentialIk
from skewmi.deploy.motion.faces import Faces
from skewmi.deploy.motion.hand_bounds import HandBounds, derive_hand_bounds
from skewmi.deploy.motion.joint_shaper import JointShaper
from skewmi.deploy.motion.smoothing import DELAY_S, FORESEEN, SmoothedReference
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT, WORKSPACE_TOLERANCE
from skewmi.errors import ConfigurationError, KinematicsError, LimitViolationError
from skewmi.policy_io import Workspace
from skewmi.robot_models.base_frame import BaseFrame
from skewmi.robot_models.frames import rotation_from_quaternion, rotation_vector
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_TICKS, GRID_S, JointPoint, JointTrajectory

MAX_START_TILT = 0.1
"""Largest angle between the hand and its constant orientation at `reset`, rad."""

LEASH = 0.010
"""How far the shaped command may run ahead of the planned hand, m."""

TOLERANCE_SHARE = 0.95
"""Part of the checker's workspace tolerance and tool speed that plans use."""

HASTE_LOST, HASTE_REGAINED = 0.5, 1.5
"""Factors on the joints' velocities after a cycle held back, and after each other one up to 1."""

LEAST_HASTE = 2.0**-10

_REST = np.zeros(7)


class Planner:
    """Plans the right arm's motion; one instance per episode or longer.

    Args:
        workspace: Box, orientation and start of the hand.
        limits: Joint limits (already scaled to the wanted speed).
        flange_speed: That the robot admits, m/s; plans stay below.

    Raises:
        ConfigurationError: The start configuration does not belong to the start position.
        KinematicsError: A corner of the box cannot be reached.
    """

    def __init__(
        self, workspace: Workspace, limits: JointLimits, *, flange_speed: float = TCP_SPEED_LIMIT
    ) -> None:
        self.limits = limits
        self.workspace = workspace
        self._base = BaseFrame.of(workspace)
        self._low, self._high = np.array(workspace.low), np.array(workspace.high)
        self._rotation = rotation_from_quaternion(workspace.hand_quaternion_wxyz)
        self._tolerance = TOLERANCE_SHARE * WORKSPACE_TOLERANCE
        self._tcp_speed = TOLERANCE_SHARE * flange_speed
        self._kinematics = ArmKinematics("right")
        posture = np.array(workspace.start_configuration)
        self.hand_bounds = derive_hand_bounds(workspace, self._kinematics, limits, flange_speed)
        self._joints = JointShaper(limits)
        self._ik = DifferentialIk(posture, self._rotation, self._base)
        self._hand = _shaper(self._low, self._high, self.hand_bounds)
        self._faces = Faces(self._low, self._high, self._tolerance, self.hand_bounds)
        self._reference = Reference(np.array(workspace.start))
        self._smoothed = SmoothedReference(self._reference.position_w)
        # Where x was for where the arm is now: to catch up with the shaper's lag overshoots stops.
        self._shaped = deque([self._hand.position_w], 1 + self._joints.lag_steps)
        self._chunk: JointTrajectory | None = None
        self._haste = 1.0
        self.held_back: str | None = None
        """Why the last `step` gave the rest of the chunk before and nothing new, or None."""

    @property
    def command_position(self) -> Array:
        """The commanded position now, on its way to the target, world, m. Shape (3,)."""
        return self._reference.position_w.copy()

    @property
    def present(self) -> JointPoint:
        """Planned state at the end of the planned cycle, where the next chunk starts."""
        return self._joints.point

    def forward(self, q: Array) -> tuple[Array, Array]:
        """Hand positions (..., 3) in world, m, and rotations (..., 3, 3) of configurations."""
        position, rotation = self._kinematics.forward(q)
        return self._base.to_task(position), self._base.rotations_to_task(rotation)

    def reset(self, q: Array) -> None:
        """Start planning from rest at a configuration.

        Args:
            q: rad. Shape (7,).

        Raises:
            LimitViolationError: `q` is not finite or outside the position limits.
            KinematicsError: The hand is outside the box or does not point down there.
        """
        q = np.array(q, dtype=np.float64)
        _require_between(q, self._joints.hard_lower, self._joints.hard_upper)
        position, rotation = self.forward(q)
        tilt = float(np.linalg.norm(rotation_vector(rotation.T @ self._rotation)))
        outside = float(np.maximum(self._low - position, position - self._high).max())
        _require_start(outside, self._tolerance, tilt)
        self._joints.point = JointPoint(q, _REST, _REST)
        self._ik.reset()
        self._reseed(position, np.zeros(3))
        self._reference = Reference(self._hand.position_w)
        self._smoothed.rest(self._reference.position_w)
        self._chunk = JointTrajectory.resting(q, CYCLE_TICKS + 1)
        self._haste = 1.0
        self.held_back = None

    def set_target(self, position_w: Array, duration_s: float) -> None:
        """Command the hand to a position, to be reached at constant velocity.

        Call it once per policy step with the policy's next commanded position (of a
        `CommandIntegrator`) and the step's duration. The executed path follows this command with
        a lag of some 50 ms at 150 mm/s (profile `lab`), cuts its corners by a millimetre or so,
        and settles on its last position when no more come.

        Args:
            position_w: World, m; clipped to the workspace box. Shape (3,).
            duration_s: Time until it should be there, s. Longer than the control step for a
                slowed-down execution.

        Raises:
            LimitViolationError: A number is not finite, or the duration not positive.
        """
        target = np.asarray(position_w, dtype=np.float64)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise LimitViolationError("finite numbers", float("nan"), 0.0, f"target {position_w}")
        if not (np.isfinite(duration_s) and duration_s > 0.0):
            raise LimitViolationError("target duration, s", float(duration_s), 0.0)
        self._reference.set_target(np.clip(target, self._low, self._high), duration_s)

    def hold(self, position_w: Array) -> None:
        """Command the hand to rest at a position from now on, without a way there: it is held up.

        It comes back by the shaper's feedback alone: faster, a policy that pushes on would swing.

        Args:
            position_w: World, m; clipped to the workspace box. Shape (3,).

        Raises:
            LimitViolationError: A number is not finite.
        """
        self.set_target(position_w, GRID_S)
        self._reference = Reference(self._reference.target_w)
        self._smoothed.rest(self._reference.position_w)

    def step(self, splice: int = CYCLE_TICKS) -> JointTrajectory:
        """Plan the next cycle.

        Args:
            splice: Sample of the previous chunk at which this one starts, normally one cycle
                later. A larger number is what a late caller needs: the arm has then begun to
                brake on the previous chunk.

        Returns:
            The present state, the next cycle, and a stop: its first sample equals that sample
            exactly, and it ends at rest. `held_back` tells if it is nothing new.

        Raises:
            ConfigurationError: `reset` was never called, or `splice` is negative.
        """
        if self._chunk is None:
            raise ConfigurationError("a planner must be reset before it can step")
        previous = self._chunk
        if splice < 0:
            raise ConfigurationError(f"splice is {splice}; it must not be negative")
        if splice != CYCLE_TICKS:
            self._resume(previous, splice)
            # The command went on while nobody planned.
            for _ in range(min(splice - CYCLE_TICKS, 1000)):
                self._advance_reference()
        samples = [self._joints.point]
        for _ in range(CYCLE_TICKS):
            self._grid_step()
            samples.append(self._joints.point)
        tail = self._joints.stop()
        rows = np.array(samples)
        chunk = JointTrajectory(
            *(np.concatenate((rows[:, i], end)) for i, end in enumerate(tail.sample(GRID_S)))
        )
        self.held_back = self._breach(chunk, tail.extent())
        if self.held_back is not None:
            chunk = previous.rest_of(splice, CYCLE_TICKS + 1)
            self._resume(chunk, CYCLE_TICKS)
            self._haste = max(LEAST_HASTE, HASTE_LOST * self._haste)
        else:
            self._haste = min(1.0, HASTE_REGAINED * self._haste)
        self._chunk = chunk
        return chunk

    def _grid_step(self) -> None:
        joints, hand, base = self._joints, self._hand, self._base
        at = base.to_task(self._ik.place(joints.point.q))
        due_w = self._shaped[0]
        self._advance_reference()
        hand.step(self._smoothed, at, LEASH)
        self._shaped.append(hand.position_w)
        low, high = (self._haste * bound for bound in joints.velocity_bounds())
        rate = joints.feedback_rate(FEEDBACK_RATE)
        where, velocity = base.to_base(due_w), base.vectors_to_base(hand.velocity_w)
        wanted = self._ik.solve(where, velocity, low, high, rate, self._faces.outwards(at))
        joints.step(_REST if wanted is None else wanted, low, high)

    def _advance_reference(self) -> None:
        self._reference.advance(GRID_S)
        self._smoothed.follow(self._reference)

    def _resume(self, chunk: JointTrajectory, index: int) -> None:
        """Continue from a sample of a chunk, and command the hand where it then is."""
        point = chunk.point(index)
        self._joints.point = point
        velocity = self._base.vectors_to_task(self._kinematics.jacobian(point.q)[:3] @ point.v)
        self._reseed(self.forward(point.q)[0], velocity)

    def _reseed(self, position_w: Array, velocity_w: Array) -> None:
        self._hand.reseed(position_w, velocity_w)
        ages = GRID_S * np.arange(self._joints.lag_steps, -1, -1)
        self._shaped.extend(self._hand.position_w - age * self._hand.velocity_w for age in ages)

    def _breach(self, chunk: JointTrajectory, extent: tuple[Array, Array]) -> str | None:
        """Why a chunk must not be published, or None."""
        joints = self._joints
        low = np.minimum(chunk.q.min(axis=0), extent[0])
        high = np.maximum(chunk.q.max(axis=0), extent[1])
        if (low < joints.hard_lower).any() or (high > joints.hard_upper).any():
            return "a joint could not stop before its position limit"
        position, _ = self.forward(chunk.q)
        outside = np.maximum(self._low - position, position - self._high).max(axis=1)
        # A hand that rests on the tolerance itself must not be caught there by a rounding error.
        if outside.max() > max(self._tolerance, outside[0] + 1e-12):
            return "the hand could not stop inside the workspace"
        steps = np.diff(position, axis=0)
        if float((steps * steps).sum(axis=1).max()) > (self._tcp_speed * GRID_S) ** 2:
            return "the tool would be too fast"
        return None


def _require_between(q: Array, lower: Array, upper: Array) -> None:
    """Raises `LimitViolationError` unless q is a configuration between bounds; all (7,), rad."""
    if q.shape != (7,) or not np.isfinite(q).all():
        raise LimitViolationError("finite numbers", float("nan"), 0.0, f"configuration {q}")
    beyond = np.maximum(lower - q, q - upper)
    if (beyond > 0.0).any():
        worst = int(np.argmax(beyond))
        bound = lower if q[worst] < lower[worst] else upper
        raise LimitViolationError(
            "joint position", float(q[worst]), float(bound[worst]), f"joint index {worst}"
        )


def _require_start(outside: float, tolerance: float, tilt: float) -> None:
    """Raises `KinematicsError` unless the hand is in the box, m, and points down, rad."""
    if outside > tolerance or tilt > MAX_START_TILT:
        raise KinematicsError(
            f"the hand is {1e3 * max(outside, 0.0):.1f} mm outside of the workspace and tilted "
            f"by {np.degrees(tilt):.1f} deg; at most {1e3 * tolerance:.1f} mm and "
            f"{np.degrees(MAX_START_TILT):.1f} deg are allowed; move to the start first"
        )


def _shaper(low: Array, high: Array, bounds: HandBounds) -> CartesianShaper:
    numbers = {"speed": bounds.speed, "acceleration": bounds.acceleration, "jerk": bounds.jerk}
    return CartesianShaper(low, high, reference_delay_s=FORESEEN * DELAY_S, **numbers)
