"""Commands that reach the arm as late as those of a deployed session, and as smooth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skewmi.motion_under_way import LONGEST_REACTION_S, ErrorGrowth, hand_ahead
from skewmi.policy_io import Array
from skewmi.sim.arm.definition import SIM_DT, SUBSTEPS
from skewmi.trajectory import GRID_NS

_Q, _V, _P = slice(0, 7), slice(7, 14), slice(14, 17)
"""Columns of a sample: joints, rad; their velocities, rad/s; the hand, world, m."""


class CommandLine(NamedTuple):
    """What is commanded during a control step: straight from begin to end. Each shape (n, ...)."""

    begin_q: Array
    end_q: Array
    velocity: Array
    begin_w: Array
    end_w: Array


class DelayedCommands:
    """Sends the lines of `n` arms through a window over what was commanded lately.

    The window is a Hann window of twice the delay, as a session smooths (`SmoothedReference`): a
    straight line stays one, a rest is a rest, and nothing overshoots.

    Args:
        delay_s: Of each arm, s; rounded to half a time step. Shape (n,).
        q: Where the arms rest, rad. Shape (n, 7).
        position_w: Their hands there, world, m. Shape (n, 3).

    Attributes:
        q: What is commanded at every substep of the step, rad. Shape (n, SUBSTEPS, 7).
        velocity: The same, rad/s.
    """

    def __init__(self, delay_s: Array, q: Array, position_w: Array) -> None:
        lengths = np.rint(2.0 * delay_s / SIM_DT).astype(np.int64)
        self._before = int(lengths.max())
        self._window = _windows(lengths)
        rest = np.concatenate([q, np.zeros_like(q), position_w], axis=1)
        self._samples = np.repeat(rest[:, None], self._before + SUBSTEPS, axis=1)
        self._late = self._samples[:, -SUBSTEPS:].copy()
        self._growth = ErrorGrowth(len(q))
        self._show()

    def ahead(self, position_w: Array, hand_w: Array) -> Array:
        """Where measured hands will be when the coming line begins. Shapes (n, 3).

        Args:
            position_w: Where the line before ends, world, m.
            hand_w: Measured, world, m.
        """
        commanded_w = self._late[:, -1, _P]
        self._growth.begin(commanded_w - hand_w, 0)
        return hand_ahead(hand_w, commanded_w, position_w)

    def lay(self, line: CommandLine) -> None:
        """Take in the line of the coming step."""
        if self._before:
            self._samples[:, : self._before] = self._samples[:, -self._before :].copy()
        new = self._samples[:, self._before :]
        done = (np.arange(1, SUBSTEPS + 1) / SUBSTEPS)[:, None]
        new[:, :, _Q] = line.begin_q[:, None] + done * (line.end_q - line.begin_q)[:, None]
        new[:, :, _V] = line.velocity[:, None]
        new[:, :, _P] = line.begin_w[:, None] + done * (line.end_w - line.begin_w)[:, None]
        self._late = self._window @ self._samples
        self._show()

    def look(self, substep: int, hand_w: Array) -> tuple[Array, Array]:
        """What a watch of the hands has to know, see `CommandIntegrator.watch`.

        Args:
            substep: How many substeps of the step are done, at least one.
            hand_w: Measured hand now, world, m. Shape (n, 3).

        Returns:
            Where the hands are commanded to be, and what their following errors will grow by.
        """
        commanded_w = self._late[:, substep - 1, _P]
        error_w = commanded_w - hand_w
        coming_w = self._growth.coming(error_w, substep * GRID_NS, LONGEST_REACTION_S)
        return commanded_w, coming_w

    def hold(self, held: NDArray[np.int64], substep: int, position_w: Array) -> Array:
        """Let arms rest where they are commanded to be after some substeps; drop what was to come.

        Args:
            held: Indices of the arms. Shape (k,).
            substep: As in `look`.
            position_w: Their hands there, world, m. Shape (k, 3).

        Returns:
            Their joints, rad. Shape (k, 7).
        """
        q: Array = self._late[held, substep - 1, _Q]
        rest = np.concatenate([q, np.zeros_like(q), position_w], axis=1)
        self._samples[held] = rest[:, None]
        self._late[held, substep:] = rest[:, None]
        return q

    def _show(self) -> None:
        self.q, self.velocity = self._late[:, :, _Q], self._late[:, :, _V]


def _windows(lengths: NDArray[np.int64]) -> Array:
    """Matrices that take samples, the oldest first, to means of the last ones at every substep.

    Args:
        lengths: Ages of the oldest sample with a weight, substeps. Shape (n,).

    Returns:
        Shape (n, SUBSTEPS, longest + SUBSTEPS).
    """
    longest = int(lengths.max())
    windows = np.zeros((len(lengths), SUBSTEPS, longest + SUBSTEPS))
    for window, length in zip(windows, lengths, strict=True):
        weights = np.hanning(length + 3)[1:-1]
        for substep in range(SUBSTEPS):
            end = longest + substep + 1
            window[substep, end - length - 1 : end] = weights / weights.sum()
    return windows
