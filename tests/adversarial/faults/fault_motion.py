"""What the robot server commanded, judged by differences of positions on the grid and nothing else.

The limits are restated here; nothing is imported from those that enforce them. The hand is
computed with Pinocchio on the URDF.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pinocchio
from fault_robot import STEP, TAKEN

from skewmi.policy_io import Array
from skewmi.robot_models import urdf

H = 0.004
"""Grid, s."""
# Data sheet's ranges less 2 deg; half of the data sheet's speeds; profile `lab`. Chain order.
LOWER = np.radians([-166.5, -141.5, -166.5, -121.5, -288.0, -86.0, -227.0])
UPPER = np.radians([166.5, 41.5, 166.5, 78.0, 288.0, 136.0, 227.0])
VELOCITY = np.radians([90.0, 90.0, 90.0, 90.0, 200.0, 200.0, 200.0])
GUIDED_VELOCITY = np.full(7, np.radians(0.9 * 90.0))
"""Behind EGM: nine tenths of the program's MaxSpeedDeviation."""
ACCELERATION = 15.0
JERK = 800.0
TOOL_SPEED = 0.25
BOX_LOW, BOX_HIGH = np.array([-0.019, -0.155, 0.190]), np.array([0.001, 0.135, 0.355])
BOX_ROOM = 0.005
BASE = np.array([-0.4, 0.0, 0.0])
ROUNDING = 1e-6
TRACKING = 0.05
"""Largest distance of measured from commanded joints once the arm rests, rad."""


@dataclass(frozen=True)
class Motion:
    """One cell's motion."""

    stretches: tuple[tuple[Array, Array], ...]
    """(monotonic s (n,), commanded q (n, 7)) between two resets of the scene."""
    taken: tuple[bool, ...]
    """Of each: whether a controller took the arm away at its end, so that nothing was commanded."""
    measured_end: Array
    """Joint angles at the end, rad. Shape (7,)."""
    died_s: float | None = None
    """When the robot server's process was killed, monotonic clock: nothing was commanded then."""

    @staticmethod
    def of(rows: Array, end: Array, died_s: float | None = None) -> Motion:
        """Of rows of a log and where the robot server says that it holds the arm in the end.

        In lock-step time stands still before that last sample is commanded.
        """
        rest = np.concatenate([[STEP, rows[-1, 1]], end, rows[-1, 9:16]])
        rows = np.concatenate([rows, rest[None]])
        starts = [0, *np.flatnonzero(rows[:, 0] != STEP), len(rows)]
        parts = [(rows[a:b], rows[b : b + 1, 0]) for a, b in pairwise(starts) if b > a]
        stretches = tuple((part[:, 1], part[:, 2:9]) for part, _ in parts)
        taken = tuple(bool((after == TAKEN).any()) for _, after in parts)
        return Motion(stretches, taken, rows[-1, 9:16], died_s)

    def speed_at(self, time_s: float) -> float:
        """Largest joint speed from 20 ms before to 30 ms after a time, rad/s."""
        found = 0.0
        for t, q in self.stretches:
            near = np.flatnonzero((t[1:] < time_s + 0.03) & (t[1:] > time_s - 0.02))
            if near.size:
                found = max(found, float(np.abs(q[near + 1] - q[near]).max()) / H)
        return found

    def path_length(self) -> float:
        """Way of the hand, m."""
        ways = (np.linalg.norm(np.diff(hand(q), axis=0), axis=1) for _, q in self.stretches)
        return float(sum(way.sum() for way in ways))

    def standstills(self, after_s: float) -> int:
        """How often the arm stood for two samples or more and then moved on, after a time."""
        count = 0
        for t, q in self.stretches:
            still = (np.diff(q, axis=0) == 0.0).all(axis=1) & (t[1:] > after_s)
            moves = np.flatnonzero(~still)
            if not moves.size:
                continue
            between = still[: moves[-1]].astype(int)
            count += int((np.diff(between, prepend=0) == 1).sum())
        return count


@lru_cache(maxsize=1)
def _model() -> tuple[pinocchio.Model, list[int]]:
    model = pinocchio.buildModelFromXML(urdf.build_urdf())
    names = [f"yumi_joint_{n}_r" for n in (1, 2, 7, 3, 4, 5, 6)]
    return model, [model.joints[model.getJointId(name)].idx_q for name in names]


def hand(q: Array) -> Array:
    """Tool positions of configurations (n, 7), world, m. Shape (n, 3)."""
    model, index = _model()
    data = model.createData()
    frame = model.getFrameId("tool0_r")
    full = pinocchio.neutral(model)
    points = []
    for row in q:
        full[index] = row
        pinocchio.forwardKinematics(model, data, full)
        points.append(pinocchio.updateFramePlacement(model, data, frame).translation.copy())
    return np.array(points) + BASE


def shares(motion: Motion, velocity: Array = VELOCITY) -> dict[str, float]:
    """Largest use of each limit; 1 is the limit. The rest before and after counts, too."""
    worst = dict.fromkeys(("position", "velocity", "acceleration", "jerk", "tool", "box"), 0.0)

    def note(name: str, value: float) -> None:
        worst[name] = max(worst[name], value)

    middle, half = (UPPER + LOWER) / 2, (UPPER - LOWER) / 2
    for (t, q), taken in zip(motion.stretches, motion.taken, strict=True):
        note("position", float((np.abs(q - middle) / half).max()))
        died = motion.died_s is not None and t[0] < motion.died_s
        rest_after = q[:0] if died or taken else q[-1:]
        padded = np.concatenate([*[q[:1]] * 3, q, *[rest_after] * 3])
        bounds = {"velocity": velocity, "acceleration": ACCELERATION, "jerk": JERK}
        for order, (name, bound) in enumerate(bounds.items(), start=1):
            note(name, float((np.abs(np.diff(padded, n=order, axis=0)) / H**order / bound).max()))
        points = hand(q[np.append(True, (np.diff(q, axis=0) != 0.0).any(axis=1))])
        if len(points) > 1:
            steps = np.linalg.norm(np.diff(points, axis=0), axis=1) / H
            note("tool", float(steps.max()) / TOOL_SPEED)
        outside = np.maximum(BOX_LOW - points, points - BOX_HIGH).max()
        note("box", 1.0 + float(outside - BOX_ROOM))
    return worst


def assert_safe(motion: Motion, velocity: Array = VELOCITY) -> dict[str, float]:
    """Every limit kept over every sample, rest at the end included; the shares used."""
    used = shares(motion, velocity)
    for name, share in used.items():
        assert share <= 1.0 + ROUNDING, f"{name}: {share:.4f} of its limit"
    last = motion.stretches[-1][1][-1]
    assert np.abs(motion.measured_end - last).max() < TRACKING, "the arm is elsewhere"
    return used
