"""What a chunk must satisfy before a robot follows it. The robot server believes no sender.

The checks go from cheap to dear; the first that fails refuses the whole chunk, the plan stays as
it was, and the plan it has ends at rest. Every function here is pure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from skewmi.deploy.safety.flange_space import TASK
from skewmi.deploy.safety.limits import SPLICE_TOLERANCE
from skewmi.errors import CommandRefusedError, LimitViolationError
from skewmi.trajectory import Array, JointPoint, JointTrajectory, TrajectoryChunk


class BrokenStreamError(CommandRefusedError):
    """A chunk came too late, or one before it is missing: sender and robot server are out of step.

    The commander may take up again from where the arm comes to rest.
    """


MAX_COMMAND_AGE_NS = 2_000_000_000
"""How far a gripper command's stamp may be from now: what a busy computer may need at worst."""

MAX_CHUNK_BYTES = 128 * 1024
"""Longest chunk that is decoded: 500 points of seven joints take 100 kB."""

MAX_GRIPPER_BYTES = 1024
"""Longest gripper command that is decoded: one opening takes some 80 bytes."""

LimitCheck = Callable[[JointTrajectory, JointPoint, Array], object]
"""(samples, plan at the chunk's stamp, its positions before that) -> raises LimitViolationError."""


class Plan(Protocol):
    """What the robot server does without the chunk that is judged."""

    def at(self, time_ns: int) -> JointPoint:
        """What is commanded at a time of the robot server's clock."""

    def before(self, time_ns: int) -> Array:
        """Positions at the three grid steps before it, oldest first, rad. Shape (3, n_joints)."""


@dataclass(frozen=True)
class ValidationRules:
    """What the robot server demands of a chunk beyond the joint limits."""

    joint_names: tuple[str, ...]
    """The names that a chunk must have, in this order."""
    grid_ns: int
    """Time between two samples."""
    max_points: int = 500
    """Longest chunk: two seconds. Bounds the work that one message can cause."""
    max_ahead_ns: int = 500_000_000
    """How far after now a chunk may start."""
    splice_tolerance: tuple[float, float, float] = SPLICE_TOLERANCE
    """Largest step between plan and chunk at the chunk's first tick: rad, rad/s, rad/s^2."""
    rest_tolerance: tuple[float, float] = (1e-6, 1e-4)
    """What counts as rest at the end: rad/s, rad/s^2."""


class ChunkValidator:
    """Judges chunks against the rules, the present plan and the joint limits.

    Args:
        rules: Names, grid and tolerances.
        check_limits: Independent check of position, velocity, acceleration, jerk, hand speed
            and workspace on the grid (`deploy.limits`).
        others: The same for workspaces other than the task's, by name.
    """

    def __init__(
        self,
        rules: ValidationRules,
        check_limits: LimitCheck,
        others: Mapping[str, LimitCheck] | None = None,
    ) -> None:
        self.rules = rules
        self._checks = {TASK: check_limits, **(others or {})}

    @property
    def workspaces(self) -> tuple[str, ...]:
        """Names of those that can be granted."""
        return tuple(self._checks)

    def check(self, chunk: TrajectoryChunk, plan: Plan, now_ns: int, workspace: str = TASK) -> None:
        """Judge a chunk.

        Args:
            chunk: As decoded from the wire.
            plan: What the robot server would do without it.
            now_ns: The robot server's clock: when the next sample is due.
            workspace: That the commander was granted.

        Raises:
            CommandRefusedError: Names the rule that was broken, with the numbers.
        """
        check_structure(chunk, self.rules)
        check_time(chunk, self.rules, now_ns)
        present = plan.at(chunk.stamp_ns)
        check_splice(chunk, present, self.rules)
        check_rest(chunk, self.rules)
        try:
            self._checks[workspace](chunk.trajectory, present, plan.before(chunk.stamp_ns))
        except LimitViolationError as error:
            raise CommandRefusedError(str(error)) from error


def check_size(size: int, most: int = MAX_CHUNK_BYTES) -> None:
    """Bounds the work that one message can cause before anything of it is known to be right.

    Args:
        size: Of the message, bytes.
        most: That are read.

    Raises:
        CommandRefusedError: How long the message is.
    """
    if size > most:
        raise CommandRefusedError(f"the command has {size} bytes; at most {most} are read")


def check_structure(chunk: TrajectoryChunk, rules: ValidationRules) -> None:
    """Names, shapes, lengths, finiteness and the grid of times.

    Raises:
        CommandRefusedError: What is wrong.
    """
    if tuple(chunk.joint_names) != rules.joint_names:
        raise CommandRefusedError(
            f"joints must be {', '.join(rules.joint_names)} in this order; "
            f"got {', '.join(chunk.joint_names) or 'none'}"
        )
    times = chunk.time_from_start_ns
    if not 2 <= len(times) <= rules.max_points:
        raise CommandRefusedError(
            f"a chunk has 2 to {rules.max_points} points; this has {len(times)}"
        )
    samples, shape = chunk.trajectory, (len(times), len(rules.joint_names))
    if samples.q.shape != shape:
        raise CommandRefusedError(
            f"samples must have shape {shape}; got {samples.q.shape}: every point needs "
            "positions, velocities and accelerations"
        )
    for name, values in (
        ("positions", samples.q),
        ("velocities", samples.v),
        ("accelerations", samples.a),
    ):
        if not np.isfinite(values).all():
            raise CommandRefusedError(f"{name} hold values that are not finite")
    if not np.array_equal(times, np.arange(len(times)) * rules.grid_ns):
        raise CommandRefusedError(
            f"points must lie at 0, 1, 2, ... times {rules.grid_ns * 1e-6:g} ms from the stamp"
        )


def check_time(chunk: TrajectoryChunk, rules: ValidationRules, now_ns: int) -> None:
    """The first sample must be due on the grid, not before now, not too far ahead.

    Raises:
        CommandRefusedError: The stamp and the robot server's clock.
    """
    if chunk.stamp_ns % rules.grid_ns:
        raise CommandRefusedError(
            f"stamp {chunk.stamp_ns} ns is not a multiple of the grid of {rules.grid_ns} ns"
        )
    ahead_ns = chunk.stamp_ns - now_ns
    if ahead_ns < 0:
        late_ms = -ahead_ns * 1e-6
        raise BrokenStreamError(f"stamp is {late_ms:g} ms in the past of the robot server's clock")
    if ahead_ns > rules.max_ahead_ns:
        raise CommandRefusedError(
            f"stamp is {ahead_ns * 1e-6:g} ms ahead of the robot server's clock; "
            f"at most {rules.max_ahead_ns * 1e-6:g} ms are allowed"
        )


def check_fresh(stamp_ns: int, clock_ns: int) -> None:
    """A command without a place in the plan must have been made just now.

    Args:
        stamp_ns: Of the command, in the robot server's clock.
        clock_ns: That clock now.

    Raises:
        CommandRefusedError: How old the command is.
    """
    age_ns = clock_ns - stamp_ns
    if abs(age_ns) > MAX_COMMAND_AGE_NS:
        raise CommandRefusedError(
            f"the command is {age_ns * 1e-9:.6g} s old by the robot server's clock; "
            f"at most {MAX_COMMAND_AGE_NS * 1e-9:g} s are allowed"
        )


def check_splice(chunk: TrajectoryChunk, present: JointPoint, rules: ValidationRules) -> None:
    """The first sample must be what the robot server would command there anyway.

    Raises:
        CommandRefusedError: Quantity, joint and size of the step.
    """
    motion = chunk.trajectory
    for what, unit, start, expected, tolerance in zip(
        ("position", "velocity", "acceleration"),
        ("rad", "rad/s", "rad/s^2"),
        (motion.q[0], motion.v[0], motion.a[0]),
        present,
        rules.splice_tolerance,
        strict=True,
    ):
        step = np.abs(start - expected)
        joint = step.argmax()
        if step[joint] > tolerance:
            raise BrokenStreamError(
                f"splice: {what} of {rules.joint_names[joint]} steps by {step[joint]:.3g} {unit} "
                f"from the robot server's plan (tolerance {tolerance:g})"
            )


def check_rest(chunk: TrajectoryChunk, rules: ValidationRules) -> None:
    """The last sample must be at rest, so that silence after it is safe.

    Raises:
        CommandRefusedError: The speed or acceleration left at the end.
    """
    # Not by `point`, which takes the nearest sample for one that is not there.
    motion = chunk.trajectory
    speed, acceleration = np.abs(motion.v[-1]).max(), np.abs(motion.a[-1]).max()
    if speed > rules.rest_tolerance[0] or acceleration > rules.rest_tolerance[1]:
        raise CommandRefusedError(
            f"a chunk must end at rest; this ends at {speed:.3g} rad/s, {acceleration:.3g} rad/s^2"
        )
