"""Between a command and its joint: late servos, play in the gears, friction that sticks."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array
from skewmi.sim.arm.definition import SIM_DT
from skewmi.sim.arm.variation_keys import BACKLASH, DELAY_MS, STICTION_SCALE, STRIBECK_VELOCITY
from skewmi.sim.variation import VariationSample

DEFAULT_STRIBECK_VELOCITY = 0.05
"""Where a variation says how much joints stick but not up to which speed, rad/s."""


def delay_steps(sample: VariationSample) -> tuple[NDArray[np.int64], Array]:
    """Delay of the servos in time steps of the physics.

    A target holds for a time step. If it is late by m steps and a fraction f of one, the servos
    have the target before it for f of the step m later: on average over that step the sum of
    both, weighted by f and 1 - f, which is what they are given.

    Returns:
        Whole steps and the fraction of one, in 0..1. Each shape (n,).
    """
    steps = sample.get(DELAY_MS) / (SIM_DT * 1e3)
    whole = np.floor(steps + 1e-9)
    # Twenty milliseconds are five steps, whatever the division says.
    fraction = np.where(np.abs(steps - whole) < 1e-9, 0.0, steps - whole)
    return whole.astype(np.int64), fraction


class Play:
    """Gears that turn some way before they take their joint along.

    The joint's target stays where it is until the servo's is half the play away from it, and
    follows at that distance. What pushes the joint from outside does not move it within the
    play: dry friction is taken to hold it.

    Args:
        width: From one flank to the other, rad. Shape (n, joints).
        start: Targets in the middle of the play, rad. Shape (n, joints).
    """

    def __init__(self, width: Array, start: Array) -> None:
        self._half = 0.5 * width
        self._kept = self._last = np.array(start)

    @staticmethod
    def of(sample: VariationSample, start: Array) -> Play | None:
        """Of the arm joints; None if there is none. Shape of `start`: (n, 7)."""
        width = sample.values.get(BACKLASH)
        return None if width is None or not width.any() else Play(width, start)

    def keep(self) -> None:
        """What was followed last has happened: go on from its end."""
        self._kept = self._last

    def follow(self, targets: Array) -> Array:
        """What the joints get of targets that come one after another; from what was kept last.

        Args:
            targets: Of the servos, rad. Shape (n, steps, joints).

        Returns:
            Of the same shape.
        """
        at, followed = self._kept, np.empty_like(targets)
        for step in range(targets.shape[1]):
            target = targets[:, step]
            at = np.clip(at, target - self._half, target + self._half)
            followed[:, step] = at
        self._last = at
        return followed


class Drive:
    """One robot's controls on their way to its joints, a time step of the physics at a time.

    Args:
        sample: Of the one robot; None for a nominal one, whose joints get what is commanded.
        controls: That hold it, as if they had always been commanded. Shape (nu,).
        arm_ctrl: Which of them are the arm's. Shape (7,).
    """

    def __init__(
        self, sample: VariationSample | None, controls: Array, arm_ctrl: NDArray[np.int64]
    ) -> None:
        whole, self._fraction = 0, 0.0
        self._play: Play | None = None
        if sample is not None:
            delay, fraction = delay_steps(sample)
            whole, self._fraction = int(delay[0]), float(fraction[0])
            self._play = Play.of(sample, controls[None, arm_ctrl])
        self._arm = arm_ctrl
        self._underway = deque(controls.copy() for _ in range(whole + 1))

    def arriving(self, controls: Array) -> Array:
        """What the joints get while these controls set out. Each shape (nu,)."""
        self._underway.append(controls)
        older, arriving = self._underway.popleft(), self._underway[0]
        if self._fraction:
            arriving = arriving + self._fraction * (older - arriving)
        if self._play is not None:
            arriving = arriving.copy()
            arriving[self._arm] = self._play.follow(arriving[None, None, self._arm])[0, 0]
            self._play.keep()
        return arriving


class Stribeck:
    """Dry friction that is larger at rest than in motion.

    F(v) = F_c (1 + (s - 1) exp(-(v / v_s)^2)), with F_c the friction in motion, s how many times
    as much it is at rest and v_s the Stribeck velocity (Armstrong-Helouvry, Dupont, Canudas de
    Wit, Automatica 30, 1994, section 2.2).

    Args:
        sample: Gives s and v_s.
        sliding: F_c, N m. Shape (n, 7).
    """

    def __init__(self, sample: VariationSample, sliding: Array) -> None:
        self._sliding = np.array(sliding)
        scale = sample.values.get(STICTION_SCALE)
        self._more: Array = np.zeros_like(self._sliding) if scale is None else scale - 1.0
        velocity = sample.values.get(STRIBECK_VELOCITY)
        self._velocity: Array | float = DEFAULT_STRIBECK_VELOCITY if velocity is None else velocity

    def friction(self, velocity: Array) -> Array:
        """Dry friction at joint velocities, rad/s; both shape (n, 7), N m."""
        slowness = np.exp(-np.square(velocity / self._velocity))
        return self._sliding * (1.0 + self._more * slowness)
