"""What the simulated robot does to its surroundings: largest forces and errors of an episode."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from skewmi.contact import STANDING_S
from skewmi.policy_io import Array
from skewmi.robot_models.base_frame import NOMINAL_BASE, BaseFrame
from skewmi.trajectory import GRID_NS

_WINDOW = round(STANDING_S * 1e9 / GRID_NS)


class ContactMeter:
    """Largest values over the ticks since `clear`.

    Args:
        low, high: Of the box that the hand's commands are clipped to, task, m. Shape (3,).
        rotation: Hand to task, in which the hand is to be held. Shape (3, 3).
        base: The robot base in the task's frame. In the simulation's world it is the nominal one.
    """

    def __init__(
        self, low: Array, high: Array, rotation: Array, base: BaseFrame = NOMINAL_BASE
    ) -> None:
        self._low, self._high, self._base = low, high, None if base == NOMINAL_BASE else base
        held = NOMINAL_BASE.rotations_to_task(base.rotations_to_base(rotation))
        self._rotation = held.ravel()
        self.clear()

    def clear(self) -> None:
        """Forget everything: an episode begins, without contact."""
        self._ticks = 0
        self._window: deque[float] = deque([0.0] * _WINDOW, maxlen=_WINDOW)
        self._sum = self._hand_peak = self._standing = self._arm_peak = self._outside = 0.0
        self._lately = 0.0, 0.0
        self._least_trace = 3.0

    def add(self, on_hand: Array, on_arm: Array, position_w: Array, rotation: Array) -> None:
        """One tick.

        Args:
            on_hand: Net contact force on hand and wrist, N. Shape (3,).
            on_arm: The same on the whole arm, hand included. Shape (3,).
            position_w: Of the hand, world of the simulation, m. Shape (3,).
            rotation: Hand to that world, row by row. Shape (9,).
        """
        self._ticks += 1
        x, y, z = map(float, on_hand)
        hand = math.sqrt(x * x + y * y + z * z)
        self._sum += hand - self._window[0]
        self._window.append(hand)
        self._hand_peak = max(self._hand_peak, hand)
        self._standing = max(self._standing, self._sum / _WINDOW)
        u, v, w = map(float, on_arm)
        arm = math.dist((u, v, w), (x, y, z))
        self._arm_peak = max(self._arm_peak, arm)
        self._lately = max(self._lately[0], hand), max(self._lately[1], arm)
        if self._base is not None:
            position_w = self._base.to_task(NOMINAL_BASE.to_base(position_w))
        beyond = np.maximum(np.maximum(self._low - position_w, position_w - self._high), 0.0)
        self._outside = max(self._outside, math.sqrt(float(beyond @ beyond)))
        self._least_trace = min(self._least_trace, float(self._rotation @ rotation))

    def lately(self) -> tuple[float, float]:
        """Largest force on the hand, and on the rest of the arm, since this was asked last, N."""
        forces, self._lately = self._lately, (0.0, 0.0)
        return forces

    def summary(self) -> dict[str, float]:
        """By key of `skewmi.contact.QUANTITIES`; empty before the first tick."""
        if not self._ticks:
            return {}
        cosine = min(max((self._least_trace - 1.0) / 2.0, -1.0), 1.0)
        return {
            "hand_force_peak_n": self._hand_peak,
            "hand_force_standing_n": self._standing,
            "arm_force_peak_n": self._arm_peak,
            "hand_tilt_deg": math.degrees(math.acos(cosine)),
            "outside_box_mm": 1e3 * self._outside,
        }
