"""Chunks that are wrong in one way each, continuing a motion that is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import ruckig
from fault_motion import ACCELERATION, JERK, LOWER, UPPER, VELOCITY, H

from skewmi.deploy.motion.brake import plan_stop
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

INSIDE = 0.97
"""Share of a limit that a breach of another one uses."""
FOLLOWED = 0.87
"""The same of joint speeds, of which a controller guided by EGM follows nine tenths."""
OVER = 1.25
"""Share of a limit that a breach of it uses."""

FOLDED = 1.34
"""Of the fourth joint in the chain, rad; the bound of its position is 1.36."""

TOGETHER = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
"""Joints whose accelerations add up in the torques."""

State = tuple[Array, Array, Array]
SLOW = np.full(7, 0.25)


def motion(start: State, goal: Array, velocity: Array, acceleration: float, jerk: float) -> State:
    """The fastest motion from a state to rest at `goal` on the grid; q, v, a of shape (n, 7)."""
    request = ruckig.InputParameter(7)
    request.synchronization = ruckig.Synchronization.No
    request.current_position, request.current_velocity, request.current_acceleration = (
        part.tolist() for part in start
    )
    request.target_position = goal.tolist()
    request.max_velocity = np.maximum(velocity, np.abs(start[1]) * 1.01).tolist()
    request.max_acceleration, request.max_jerk = [acceleration] * 7, [jerk] * 7
    trajectory = ruckig.Trajectory(7)
    ruckig.Ruckig(7).calculate(request, trajectory)
    count = int(np.ceil(trajectory.duration / H)) + 2
    rows = np.array([trajectory.at_time(k * H)[:3] for k in range(count)])
    rows[0] = start
    rows[-1] = goal, np.zeros(7), np.zeros(7)
    return rows[:, 0], rows[:, 1], rows[:, 2]


def breach(kind: str, start: State) -> State:
    """A chunk from a state to rest that breaks the limit of one kind."""
    q = start[0]
    velocity, acceleration, jerk = FOLLOWED * VELOCITY, INSIDE * ACCELERATION, INSIDE * JERK
    turn = np.zeros(7)
    if kind in ("workspace box", "torque", "self-collision"):
        return _from_rest(kind, start)
    match kind:
        case "position":
            beyond = np.minimum(q - LOWER, UPPER - q)
            joint = int(np.argmin(beyond[[0, 1, 2, 3, 5]]))
            joint = (0, 1, 2, 3, 5)[joint]
            up = UPPER[joint] - q[joint] < q[joint] - LOWER[joint]
            turn[joint] = (beyond[joint] + 0.02) * (1.0 if up else -1.0)
        case "velocity":
            turn[0], velocity = 0.8, OVER * VELOCITY
        case "acceleration":
            turn[0], acceleration = 0.3, OVER * ACCELERATION
        case "jerk":
            turn[0], jerk = 0.2, OVER * JERK
        case "tool speed":
            turn[0] = 0.6
        case _:
            raise ValueError(kind)
    return motion(start, q + turn, velocity, acceleration, jerk)


def _from_rest(kind: str, start: State) -> State:
    """Brakes, and then breaks a limit so gently that no other one is near."""
    stop = plan_stop(*start, np.full(7, INSIDE * ACCELERATION), np.full(7, INSIDE * JERK))
    braking = [tuple(part[None] for part in start), stop.sample(H)]
    if kind == "workspace box":
        return _then(braking, np.eye(7)[:1] * 0.45)
    if kind == "self-collision":
        # The elbow folds until the forearm meets the upper arm.
        return _then(braking, np.eye(7)[3:4] * (FOLDED - start[0][3]))
    # All joints accelerate at once, to and fro. The guard looks at six samples of a chunk, so
    # the bursts are those of which it sees most.
    bursts = [
        _then(braking, size * TOGETHER * np.array([[1.0], [-1.0]] * pairs))
        for size in np.linspace(0.004, 0.008, 9)
        for pairs in range(1, 4)
    ]

    def seen(chunk: State) -> float:
        acceleration = chunk[2] @ TOGETHER
        few = np.linspace(0, len(acceleration) - 1, 6).round().astype(int)
        return float(acceleration[few].max())

    return max(bursts, key=seen)


def _then(parts: list[State], turns: Array) -> State:
    """Slow turns (k, 7) after parts of a motion that ends at rest."""
    parts = list(parts)
    for turn in turns:
        q = parts[-1][0][-1]
        rest = q, np.zeros(7), np.zeros(7)
        rows = motion(rest, q + turn, SLOW, INSIDE * ACCELERATION, INSIDE * JERK)
        parts.append(tuple(part[1:] for part in rows))
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def breaching(kind: str) -> Callable[[TrajectoryChunk], TrajectoryChunk]:
    """Replaces a chunk by one that starts like it and breaks a limit."""

    def change(chunk: TrajectoryChunk) -> TrajectoryChunk:
        samples = JointTrajectory(*breach(kind, chunk.trajectory.point(0)))
        return TrajectoryChunk.of(chunk.stamp_ns, chunk.joint_names, samples)

    return change


def rows_of(chunk: TrajectoryChunk, rows: slice | Array) -> TrajectoryChunk:
    """Some samples of a chunk, on the grid from 0."""
    return TrajectoryChunk.of(chunk.stamp_ns, chunk.joint_names, chunk.trajectory.part(rows))


def one_point(chunk: TrajectoryChunk) -> TrajectoryChunk:
    return rows_of(chunk, slice(0, 1))


def six_joints(chunk: TrajectoryChunk) -> TrajectoryChunk:
    samples = chunk.trajectory
    fewer = JointTrajectory(samples.q[:, :6], samples.v[:, :6], samples.a[:, :6])
    return replace(chunk, joint_names=chunk.joint_names[:6], trajectory=fewer)


def too_many_points(chunk: TrajectoryChunk) -> TrajectoryChunk:
    return rows_of(chunk, np.minimum(np.arange(501), len(chunk.trajectory) - 1))


def sorted_names(chunk: TrajectoryChunk) -> TrajectoryChunk:
    """1, 2, 3, ... instead of chain order 1, 2, 7, 3, ...; the values stay."""
    return replace(chunk, joint_names=tuple(sorted(chunk.joint_names)))


def left_arm(chunk: TrajectoryChunk) -> TrajectoryChunk:
    return replace(chunk, joint_names=yumi.joint_names("left"))


def one_nan(chunk: TrajectoryChunk) -> TrajectoryChunk:
    q = chunk.trajectory.q.copy()
    q[len(q) // 2, 3] = np.nan
    return _with_positions(chunk, q)


def far_away(chunk: TrajectoryChunk) -> TrajectoryChunk:
    return _with_positions(chunk, chunk.trajectory.q + 0.3)


def _with_positions(chunk: TrajectoryChunk, q: Array) -> TrajectoryChunk:
    return replace(chunk, trajectory=replace(chunk.trajectory, q=q))


def without_tail(chunk: TrajectoryChunk) -> TrajectoryChunk:
    """The new samples only, so that the chunk ends while the arm moves."""
    return rows_of(chunk, slice(0, 6))
