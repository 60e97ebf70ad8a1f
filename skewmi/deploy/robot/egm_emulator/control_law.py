"""How a controller follows EGM references: its desired position, cycle by cycle.

ABB's application manual 3HAC073318 (RobotWare 7.16), p. 26 and 29:

    speed = low-pass(k (position reference - desired position) + speed reference)

The position in it is the controller's own desired one, not the measured one: a held-up arm does
not wind the law up. The speed is ramped in from the start of the session and ramped out at its
end; if one joint would be too fast, all are slowed down by one factor; and the motion acts on the
joints with a lag. A reference that does not come is replaced by the one before it, speed included,
which is why a silent partner does not stop the arm.

Left open by the manual and chosen here: the low-pass is of first order, ramps are linear, and the
lag lies between the desired position and the servos.
"""

from __future__ import annotations

from collections import deque
from math import exp, pi, radians
from typing import NamedTuple

import numpy as np

from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.robot_models import yumi
from skewmi.trajectory import Array


class Target(NamedTuple):
    """What the servos of an arm follow: position, rad, and speed, rad/s. Each of shape (7,)."""

    q: Array
    v: Array


class ControlLaw:
    """The desired position of one arm. Pure: time passes by calling `step`.

    Args:
        settings: Of the program.
        q: Where the arm is, rad. Shape (7,).
        period_s: Of the controller's cycle.
        lag_s: From the desired position to the servos.
    """

    def __init__(self, settings: ProgramSettings, q: Array, period_s: float, lag_s: float) -> None:
        self._settings = settings
        self._period_s = period_s
        self._delay, self._fraction = divmod(lag_s / period_s, 1.0)
        self._smoothing = 1.0 - exp(-2.0 * pi * settings.low_pass_hz * period_s)
        limit = radians(settings.max_speed_deviation_deg_s)
        self._speed_limit: Array = np.minimum(limit, yumi.VELOCITY)
        self._deviation = radians(settings.max_position_deviation_deg)
        self.rest_at(q)

    def rest_at(self, q: Array) -> None:
        """Stand still at `q`, shape (7,), rad, with nothing on its way to the servos."""
        self.desired: Array = np.array(q, dtype=np.float64)
        self.speed: Array = np.zeros(7)
        still = Target(self.desired.copy(), np.zeros(7))
        self._on_its_way = deque([still] * (int(self._delay) + 2), maxlen=int(self._delay) + 2)
        self.start()

    def start(self) -> None:
        """A session begins where the desired position is."""
        self.utilization = 0.0
        """How much of the admitted speed was asked for, per cent; beyond 100 it was not given."""
        self.within_s = 0.0
        """For how long all joints have been within the convergence limits."""
        self._began_at = self.desired.copy()
        self._elapsed_s = 0.0
        self._reference: Target | None = None
        self._filtered = np.zeros(7)
        self._ramp_out: Array | None = None
        self._braked_s = 0.0

    def step(self, reference: ReferencePacket | None) -> Target:
        """One cycle in a session.

        Args:
            reference: The message that was read in it; None if there was none, and the one before
                it goes on to count.

        Returns:
            What the servos follow now.
        """
        self._elapsed_s += self._period_s
        if reference is not None:
            v = np.zeros(7) if reference.v is None else reference.v
            self._reference = Target(reference.q, v)
        if self._reference is not None:
            error = self._reference.q - self.desired
            ramp = min(1.0, self._elapsed_s / self._settings.ramp_in_s)
            speed = ramp * (self._settings.gain * error + self._reference.v)
            self._filtered = self._filtered + self._smoothing * (speed - self._filtered)
        asked = float((np.abs(self._filtered) / self._speed_limit).max())
        self.utilization = 100.0 * asked
        self._move(self._filtered / max(asked, 1.0))
        self._note_convergence()
        return self._delayed()

    def brake(self) -> Target:
        """One cycle after the end of a session: the speed goes to zero and stays there."""
        if self._ramp_out is None:
            self._ramp_out, self._braked_s = self.speed, 0.0
        self._braked_s += self._period_s
        # By time and not by what the speed has become: of a speed near zero, rounding of the
        # position may never let anything be taken away.
        left = max(0.0, 1.0 - self._braked_s / self._settings.ramp_out_s)
        self.utilization = 0.0
        self._move(left * self._ramp_out)
        return self._delayed()

    @property
    def resting(self) -> bool:
        """Whether the desired position stands still and nothing is on its way to the servos."""
        return all(not target.v.any() for target in self._on_its_way)

    def _move(self, speed: Array) -> None:
        target = self.desired + speed * self._period_s
        low, high = self._began_at - self._deviation, self._began_at + self._deviation
        target = np.clip(target, low, high)
        self.speed = (target - self.desired) / self._period_s
        self.desired = target
        self._on_its_way.append(Target(target.copy(), self.speed.copy()))

    def _delayed(self) -> Target:
        newer, older = self._on_its_way[1], self._on_its_way[0]
        share = self._fraction
        return Target(newer.q + share * (older.q - newer.q), newer.v + share * (older.v - newer.v))

    def _note_convergence(self) -> None:
        if self._reference is None:
            return
        limit = radians(self._settings.convergence_deg)
        error = np.abs(self._reference.q - self.desired).max()
        self.within_s = self.within_s + self._period_s if error <= limit else 0.0
