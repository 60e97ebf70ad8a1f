"""Chunks around the bounds of the checker, and what it says of them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import limits, yumi

LAB = limits.profile("lab")
H = 0.004
MIDDLE = (LAB.position_lower + LAB.position_upper) / 2
HALF = (LAB.position_upper - LAB.position_lower) / 2
NAMES = yumi.joint_names("right")
CHECKER = ChunkChecker(LAB)
LADDER = (0.0, 0.5, 0.9, 0.999, 1.001, 1.1, 2.0, 1e3)
Chunk = tuple[Array, Array, Array]
JOINTS = range(7)
SIGNED_JOINTS = tuple(itertools.product(JOINTS, (1.0, -1.0)))


def still(n: int, q: Array = MIDDLE) -> Chunk:
    rows = np.tile(q, (n, 1))
    return rows, np.zeros_like(rows), np.zeros_like(rows)


def verdict(checker: ChunkChecker, *chunk: Array, **options: object) -> str:
    """The limit that the chunk breaks, or "" if it is accepted."""
    try:
        checker.check(*chunk, **options)  # type: ignore[arg-type]
    except LimitViolationError as error:
        return error.limit
    return ""


def refusal(checker: ChunkChecker, *chunk: Array, **options: object) -> LimitViolationError:
    with pytest.raises(LimitViolationError) as caught:
        checker.check(*chunk, **options)  # type: ignore[arg-type]
    return caught.value


JERK = 800.0
