"""What a chunk of joint motion must satisfy, restated on its own.

This module imports nothing of the planner and trusts nobody: the session uses it before a chunk is
sent and the robot server uses it again before a chunk is executed.

A chunk is a list of samples (q, v, a) on a time grid of step h that ends at rest. Besides the
bounds on every sample, the samples must be consistent: they must be samples of ONE motion whose
jerk stays within J. By Taylor's theorem such a motion satisfies, from each sample to the next and
likewise backwards in time (h -> -h),

    |a1 - a0|                        <= J h
    |v1 - v0 - a0 h|                 <= J h^2 / 2
    |q1 - q0 - v0 h - a0 h^2 / 2|    <= J h^3 / 6

so a chunk cannot state harmless velocities beside positions that jump. Differences of the samples
(first, second and third of q, and so on) are averages of v, a and jerk over the grid and must obey
the same bounds; they are what a receiver that only reads positions will do with them. That holds
across the ends of a chunk, too: before its first sample there is the motion that it continues, and
after its last one there is rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.policy_io import Workspace
from skewmi.robot_models.base_frame import BaseFrame, box_from_base
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import JointPoint

Array = NDArray[np.float64]
Forward = Callable[[Array], tuple[Array, Array]]

JOINTS = 7

GRID_DT = 0.004
"""Grid step, s: the cycle of ABB's externally guided motion."""

TCP_SPEED_LIMIT = 0.25
"""Largest speed of the flange, m/s: "reduced speed" of ISO 10218-1. (ABB's own cap for the YuMi
is `robot_models.yumi.TCP_SPEED`, six times as much.)"""

WORKSPACE_TOLERANCE = 0.005
"""How far the hand may be outside the box that bounds its *command*, m: room for the deviation
of a braking arm from the straight line."""

MAX_SAMPLES = 1250
"""Longest chunk, 5 s of motion; longer ones are refused unread."""

ROUNDING = 1e-6
"""Relative excess over a bound that is put down to floating point."""

REST = 1e-9
"""Velocity (rad/s) and acceleration (rad/s^2) below which an arm is at rest."""

_REST = np.full(JOINTS, REST)

SPLICE_TOLERANCE = (1e-9, 1e-7, 1e-5)
"""Largest difference of q, v, a (rad, rad/s, rad/s^2) between a chunk's first sample and the
motion that it continues."""


@dataclass(frozen=True)
class LimitUsage:
    """Largest use of each limit, as a fraction of it: 1.0 is the limit."""

    position: float = 0.0
    """Of the half range, from its middle."""
    velocity: float = 0.0
    acceleration: float = 0.0
    jerk: float = 0.0
    """By differences of the accelerations on the grid."""
    tcp_speed: float = 0.0
    workspace: float = 0.0
    """Of the half width of the box (without tolerance), from its middle."""

    def merged(self, other: LimitUsage) -> LimitUsage:
        """The larger of both, limit by limit."""
        return LimitUsage(
            **{f.name: max(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        )

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


class ChunkChecker:
    """Checks chunks against one limit profile and, if given, one workspace box.

    Args:
        limits: Joint limits.
        workspace: Box of the hand in the task world, or None to check joints only (the motion to
            the start pose begins outside of the box).
        forward: Tool pose in the robot base frame from joint angles, (n, 7) -> (n, 3),
            (n, 3, 3); needed for box and tool speed, None leaves both out.
        grid_dt: Grid step, s.
        tcp_speed: Largest tool speed, m/s.
        workspace_tolerance: m.

    Raises:
        ConfigurationError: A workspace is given without `forward`, or a number is not positive.
    """

    def __init__(
        self,
        limits: JointLimits,
        workspace: Workspace | None = None,
        forward: Forward | None = None,
        *,
        grid_dt: float = GRID_DT,
        tcp_speed: float = TCP_SPEED_LIMIT,
        workspace_tolerance: float = WORKSPACE_TOLERANCE,
    ) -> None:
        if workspace is not None and forward is None:
            raise ConfigurationError("a workspace can only be checked with forward kinematics")
        for name, value in (("grid_dt", grid_dt), ("tcp_speed", tcp_speed)):
            if not value > 0.0:
                raise ConfigurationError(f"{name} is {value}; it must be positive")
        self.limits = limits
        self.grid_dt = grid_dt
        # Between two samples a position can exceed both by A h^2 / 8 at most.
        self._bulge = limits.acceleration * grid_dt * grid_dt / 8.0
        self._middle = (limits.position_upper + limits.position_lower) / 2.0
        self._half = (limits.position_upper - limits.position_lower) / 2.0
        self._tcp_speed = tcp_speed
        self._forward = forward
        self._box: tuple[Array, Array, BaseFrame] | None = None
        if workspace is not None:
            self._box = box_from_base(workspace)
        self._tolerance = workspace_tolerance

    def check(
        self,
        q: Array,
        v: Array,
        a: Array,
        previous: JointPoint | None = None,
        *,
        earlier: Array | None = None,
    ) -> LimitUsage:
        """Accept a chunk or raise.

        Args:
            q: Positions, rad. Shape (n, 7), n >= 2.
            v: Velocities, rad/s. Shape (n, 7).
            a: Accelerations, rad/s^2. Shape (n, 7).
            previous: The motion in progress at the time of the first sample; None if there is
                none: then the chunk must start at rest.
            earlier: Positions of the motion in progress at the three grid steps before the first
                sample, oldest first, rad; None leaves differences across the start unchecked
                unless the chunk starts at rest. Shape (3, 7).

        Returns:
            How much of each limit the chunk uses.

        Raises:
            LimitViolationError: Names the first limit that is broken.
        """
        self._check_form(q, v, a)
        self._check_ends(q, v, a, previous)
        usage = self._check_joints(q, v, a)
        self._check_consistency(q, v, a)
        if earlier is None and previous is None:
            earlier = q[[0, 0, 0]]
        self._check_across(q, earlier)
        return usage if self._forward is None else self._check_hand(q, usage)

    def _check_form(self, q: Array, v: Array, a: Array) -> None:
        for name, array in (("q", q), ("v", v), ("a", a)):
            if array.ndim != 2 or array.shape[1] != JOINTS or array.shape[0] != q.shape[0]:
                detail = f"{name} has shape {array.shape}"
                raise LimitViolationError("chunk shape", array.size, JOINTS, detail)
            if not np.isfinite(array).all():
                raise LimitViolationError("finite numbers", float("nan"), 0.0, f"in {name}")
        if not 2 <= len(q) <= MAX_SAMPLES:
            raise LimitViolationError("chunk samples", len(q), MAX_SAMPLES, "at least 2")

    def _check_ends(self, q: Array, v: Array, a: Array, previous: JointPoint | None) -> None:
        for name, array in (("velocity", v), ("acceleration", a)):
            _require(f"{name} at the end", np.abs(array[-1]), _REST, 0.0)
            if previous is None:
                _require(f"{name} at the first start", np.abs(array[0]), _REST, 0.0)
        if previous is None:
            return
        names = ("position", "velocity", "acceleration")
        parts = zip(names, (q, v, a), previous, SPLICE_TOLERANCE, strict=True)
        for name, array, expected, tolerance in parts:
            jump = np.abs(array[0] - expected)
            if not np.isfinite(jump).all():
                raise LimitViolationError("finite numbers", float("nan"), 0.0, "previous motion")
            _require(f"{name} jump at the splice", jump, np.full(JOINTS, tolerance), 0.0)

    def _check_across(self, q: Array, earlier: Array | None) -> None:
        """Differences of positions that reach over an end of the chunk, or, if it is short, both.

        A receiver gets one stream: the motion before, all samples of the chunk, and rest. Every
        difference of that stream is bounded; those inside the chunk have been found good before.
        """
        h, last = self.grid_dt, q[-1:]
        if earlier is None:
            earlier = q[:0]
        elif not np.isfinite(earlier).all():
            raise LimitViolationError("finite numbers", float("nan"), 0.0, "earlier motion")
        first = np.diff(np.concatenate((earlier, q, last, last, last)), axis=0)
        second = np.diff(first, axis=0)
        third = np.diff(second, axis=0)
        # 1e-12 of absolute room for each of the two, four and eight positions that a difference
        # is of.
        v_bound = self.limits.velocity * h + 2e-12
        a_bound = self.limits.acceleration * h * h + 4e-12
        j_bound = self.limits.jerk * h**3 + 8e-12
        _require("position step of velocity over an end", _peak(first), v_bound)
        _require("position step of acceleration over an end", _peak(second), a_bound)
        _require("position step of jerk over an end", _peak(third), j_bound)

    def _check_joints(self, q: Array, v: Array, a: Array) -> LimitUsage:
        limits, h = self.limits, self.grid_dt
        middle, half = self._middle, self._half
        excursion = np.abs(q - middle).max(axis=0) + self._bulge
        worst = np.argmax(excursion - half)
        if excursion[worst] > half[worst]:
            k = np.argmax(np.abs(q[:, worst] - middle[worst]))
            above = q[k, worst] > middle[worst]
            bound = (limits.position_upper if above else limits.position_lower)[worst]
            raise LimitViolationError(
                "joint position", float(q[k, worst]), float(bound), f"joint index {worst}"
            )
        # All at once: this runs in every tick of the robot server that brings a chunk.
        samples = np.array((q, v, a))
        first = np.diff(samples, axis=1) / h
        second = np.diff(first[:2], axis=1) / h
        third = np.diff(second[0], axis=0) / h
        (_, v_peak, a_peak), (dq_peak, dv_peak, da_peak) = _peak(samples), _peak(first)
        ddq_peak, ddv_peak = _peak(second)
        velocity = np.maximum(v_peak, dq_peak)
        acceleration = np.maximum(np.maximum(a_peak, dv_peak), ddq_peak)
        jerk = np.maximum(np.maximum(da_peak, ddv_peak), _peak(third))
        _require("joint velocity", velocity, limits.velocity)
        _require("joint acceleration", acceleration, limits.acceleration)
        _require("joint jerk", jerk, limits.jerk)
        return LimitUsage(
            position=float((excursion / half).max()),
            velocity=float((velocity / limits.velocity).max()),
            acceleration=float((acceleration / limits.acceleration).max()),
            jerk=float((da_peak / limits.jerk).max()),
        )

    def _check_consistency(self, q: Array, v: Array, a: Array) -> None:
        jerk, h = self.limits.jerk, self.grid_dt
        v0, v1, a0, a1 = v[:-1], v[1:], a[:-1], a[1:]
        dq, dv, half = q[1:] - q[:-1], v1 - v0, h * h / 2.0
        # From each sample to the next, and from that one back. 1e-12 of absolute room: at 5 rad a
        # double resolves 1e-15.
        off_v = np.concatenate((dv - a0 * h, dv - a1 * h))
        _require("velocity against acceleration", _peak(off_v), jerk * half + 1e-12)
        off_q = np.concatenate((dq - v0 * h - a0 * half, dq - v1 * h + a1 * half))
        _require("position against velocity", _peak(off_q), jerk * h**3 / 6.0 + 1e-12)

    def _check_hand(self, q: Array, usage: LimitUsage) -> LimitUsage:
        assert self._forward is not None
        position, _ = self._forward(q)
        steps = np.diff(position, axis=0)
        speed = float(np.sqrt((steps * steps).sum(axis=1).max())) / self.grid_dt
        if speed > self._tcp_speed:
            raise LimitViolationError("tool speed, m/s", speed, self._tcp_speed)
        use = LimitUsage(tcp_speed=speed / self._tcp_speed)
        if self._box is not None:
            low, high, base = self._box
            position = base.vectors_to_task(position)
            outside = np.maximum(low - position, position - high)
            worst = float(outside.max())
            if worst > self._tolerance:
                axis = f"axis {'xyz'[np.argmax(outside.max(axis=0))]}"
                limit = "distance outside the workspace, m"
                raise LimitViolationError(limit, worst, self._tolerance, axis)
            offset = np.abs(position - (low + high) / 2.0) / ((high - low) / 2.0)
            use = LimitUsage(tcp_speed=use.tcp_speed, workspace=float(offset.max()))
        return usage.merged(use)


def _peak(samples: Array) -> Array:
    """Largest absolute value per joint, (..., n, 7) -> (..., 7); zero where n is."""
    peak: Array = np.abs(samples).max(axis=-2, initial=0.0)
    return peak


def _require(limit: str, value: Array, bound: Array, rounding: float = ROUNDING) -> None:
    """Raise for the joint with the largest excess, if any."""
    if (value > bound * (1.0 + rounding)).any():
        worst = np.argmax(value / bound)
        joint = f"joint index {worst}"
        raise LimitViolationError(limit, float(value[worst]), float(bound[worst]), joint)
