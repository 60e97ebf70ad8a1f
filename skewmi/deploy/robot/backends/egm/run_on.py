"""How far an arm runs on once nobody answers its controller: a bound, worked out from its law.

The controller keeps both parts of the last reference, its speed included, until `\\CommTimeout`
ends the session; then what is left of the speed goes to zero in the ramp-out time. Per cycle T,
with e the desired position less the last reference, s the speed, f the fraction of the plan's
speed v that is sent as speed reference, k the gain and a the low-pass' share of a cycle,

    s' = (1 - a) s + a (f v - k e),   e' = e + T s'

n cycles after the last reference was read,  e_n = A_n e_0 + B_n s_0 + f C_n v.

What is bounded is how far the arm goes beyond *both* its last reference and where it was when that
was read: it stays within the way between these two, widened by the bound at both ends. With f = 1
and in steady motion the two are one point. Behind the reference, the arm lags anyway.

The bound holds for every history of references that were never faster than V, without a bound on
their acceleration: e_0 and s_0 are filtered from v, so that they are at most the sum of the
filter's impulse response, without signs, times V. It is linear: a controller that had to slow the
joints down (utilisation beyond 100 %, which the bridge takes for a fault) is not covered, nor is
what the servos make of the controller's desired position.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil, exp, inf, pi
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skewmi.deploy.robot.backends.egm.program import ProgramSettings

CYCLE_S = 0.004032
"""Of a real controller."""

_FORGOTTEN = 1e-9
"""What is left of an impulse when its sum ends; 1 at first."""

_LONGEST = 50_000
"""Cycles of that sum; all of it with gains of 0.1 /s and more."""


@lru_cache(maxsize=64)
def bound(program: ProgramSettings, feed_forward: float) -> float:
    """Distance per speed, s: times the fastest joint's or the flange's speed it is the distance.

    Args:
        program: What the controller does.
        feed_forward: f, 0..1.

    Returns:
        s, not negative.
    """
    low_pass = 1.0 - exp(-2.0 * pi * program.low_pass_hz * CYCLE_S)
    gain = program.gain
    fastest, farthest_off = _filtered(gain, low_pass, feed_forward)
    cycles = ceil(program.comm_timeout_s / CYCLE_S - 1e-9) + 1
    # Columns of (e, s) for e_0 = 1, for s_0 = 1 and for f v = 1.
    e, s = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]
    worst = 0.0

    def beyond(row: list[float]) -> float:
        of_error = max(row[0] - 1.0, -row[0], 0.0)
        share = 0.0 if of_error < 1e-12 else of_error * farthest_off
        return share + abs(row[1]) * fastest + feed_forward * abs(row[2])

    for _ in range(cycles):
        for column, pushed in enumerate((0.0, 0.0, 1.0)):
            s[column] += low_pass * (pushed - gain * e[column] - s[column])
            e[column] += CYCLE_S * s[column]
        worst = max(worst, beyond(e))
    stopped = [e[i] + s[i] * program.ramp_out_s / 2.0 for i in range(3)]
    return max(worst, beyond(stopped))


def remembered_cycles(program: ProgramSettings) -> int:
    """How many references have a say in how fast the arm is: five time constants, 2 s at most."""
    low_pass_s = 1.0 / (2.0 * pi * program.low_pass_hz)
    slowest_s = max(1.0 / program.gain if program.gain > 0.0 else 0.0, low_pass_s)
    return ceil(min(5.0 * slowest_s, 2.0) / CYCLE_S)


def _filtered(gain: float, low_pass: float, feed_forward: float) -> tuple[float, float]:
    """Largest |s_0| and |e_0| that references of speed 1 or less can lead to: 1, and s.

    The response to a speed of 1 in one cycle, before and after which the reference rests.
    """
    # The position moves by T while the speed is sent; from then on it rests at 0.
    s = low_pass * (feed_forward + gain * CYCLE_S)
    e = -CYCLE_S + CYCLE_S * s
    # The reference's own cycle counts, too: it was read, and not acted upon yet.
    fastest, farthest = 0.0, CYCLE_S
    for _ in range(_LONGEST):
        if abs(s) + gain * abs(e) < _FORGOTTEN:
            break
        fastest, farthest = fastest + abs(s), farthest + abs(e)
        s += low_pass * (-gain * e - s)
        e += CYCLE_S * s
    if gain == 0.0:
        return fastest, inf
    # What is left creeps back to the reference: its speeds add up to the way, the way to way / k.
    return fastest + abs(e) / CYCLE_S, farthest + abs(e) / (gain * CYCLE_S)
