"""Motions at chosen fractions of the limits."""

from __future__ import annotations

import numpy as np
import pytest
import ruckig

from skewmi.deploy.safety.limits import (
    ChunkChecker,
)
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import limits

GRID_DT = 0.004
LAB = limits.profile("lab")
MIDDLE = (LAB.position_lower + LAB.position_upper) / 2
HALF = (LAB.position_upper - LAB.position_lower) / 2
Chunk = tuple[Array, Array, Array]


def motion(start: Array, end: Array, velocity: Array, acceleration: Array, jerk: Array) -> Chunk:
    """Rest-to-rest motion on the grid under the given bounds, joints independent."""
    request = ruckig.InputParameter(7)
    request.synchronization = ruckig.Synchronization.No
    request.current_position, request.target_position = start.tolist(), end.tolist()
    request.max_velocity, request.max_acceleration = velocity.tolist(), acceleration.tolist()
    request.max_jerk = jerk.tolist()
    trajectory = ruckig.Trajectory(7)
    ruckig.Ruckig(7).calculate(request, trajectory)
    n = int(np.ceil(trajectory.duration / GRID_DT - 1e-9)) + 1
    samples = np.array([trajectory.at_time(k * GRID_DT) for k in range(n)])
    q, v, a = (samples[:, i].copy() for i in range(3))
    v[-1], a[-1] = 0.0, 0.0
    return q, v, a


def joint_motion(joint: int, distance: float, **factors: float) -> Chunk:
    """One joint moves from the middle; `factors` scale the lab profile's bounds."""
    end = MIDDLE.copy()
    end[joint] += distance
    return motion(
        MIDDLE,
        end,
        LAB.velocity * factors.get("velocity", 1.0),
        LAB.acceleration * factors.get("acceleration", 1.0),
        LAB.jerk * factors.get("jerk", 1.0),
    )


def refused(checker: ChunkChecker, chunk: Chunk, **options: object) -> LimitViolationError:
    with pytest.raises(LimitViolationError) as caught:
        checker.check(*chunk, **options)  # type: ignore[arg-type]
    return caught.value
