"""The control law against closed forms: tracking, running on, limits, ramp, lag."""

from __future__ import annotations

from math import degrees, exp, radians

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.egm_emulator.control_law import ControlLaw
from skewmi.errors import ConfigurationError

PERIOD_S = 0.004032


def law(lag_s: float = 0.0, **options: float) -> ControlLaw:
    return ControlLaw(ProgramSettings(**options), np.zeros(7), PERIOD_S, lag_s)  # type: ignore[arg-type]


def reference(q: np.ndarray | float, v: np.ndarray | float | None = None) -> ReferencePacket:
    speed = None if v is None else np.broadcast_to(np.asarray(v, dtype=float), 7)
    return ReferencePacket(0, 0, np.broadcast_to(np.asarray(q, dtype=float), 7), speed)


def drive(one: ControlLaw, speed: float, seconds: float, *, feed_forward: bool) -> float:
    """Move all joints at a steady speed, rad/s; where the last reference was, rad."""
    q = float(one.desired[0])
    for _ in range(round(seconds / PERIOD_S)):
        q += speed * PERIOD_S
        one.step(reference(q, speed if feed_forward else None))
    return q


def test_it_stands_still_until_a_reference_comes() -> None:
    one = law()
    for _ in range(100):
        target = one.step(None)
    np.testing.assert_array_equal(target.q, np.zeros(7))


def test_a_step_is_approached_with_the_gain() -> None:
    one = law(gain=5.0, low_pass_hz=100.0, ramp_in_s=0.005)
    for _ in range(round(0.2 / PERIOD_S)):
        one.step(reference(0.01))
    assert one.desired[0] == pytest.approx(0.01 * (1.0 - exp(-1.0)), rel=0.03)


@pytest.mark.parametrize("gain", [5.0, 20.0])
def test_without_feed_forward_it_stays_behind_by_speed_over_gain(gain: float) -> None:
    one = law(gain=gain)
    last = drive(one, 0.3, 3.0, feed_forward=False)
    # The cycle that answers the last reference has passed already.
    assert last - one.desired[0] == pytest.approx(0.3 * (1.0 / gain - PERIOD_S), rel=1e-3)


def test_with_feed_forward_nothing_is_left() -> None:
    one = law(gain=5.0)
    last = drive(one, 0.3, 3.0, feed_forward=True)
    assert last - one.desired[0] == pytest.approx(-0.3 * PERIOD_S, rel=1e-3)


@settings(deadline=None, max_examples=200)
@given(
    q=st.floats(-2.0, 2.0),
    speed=st.floats(-1.0, 1.0) | st.floats(-1e-12, 1e-12),
    ramp_out_s=st.floats(0.005, 1.0),
)
def test_it_rests_after_the_ramp_whatever_its_speed(
    q: float, speed: float, ramp_out_s: float
) -> None:
    """A speed of one rounding of the position a cycle, too, which cannot be halved."""
    one = law(gain=20.0, ramp_in_s=0.005, low_pass_hz=100.0, ramp_out_s=ramp_out_s)
    one.rest_at(np.full(7, q))
    for _ in range(5):
        one.step(reference(np.full(7, q), speed))
    for _ in range(int(ramp_out_s / PERIOD_S) + 2):
        one.brake()
    assert not one.speed.any()


def test_without_feed_forward_it_does_not_run_on() -> None:
    one = law(0.02, gain=5.0)
    last = drive(one, 0.5, 2.0, feed_forward=False)
    for _ in range(1000):
        one.step(None)
    assert one.desired[0] <= last + 1e-9


def test_one_fast_joint_slows_all_of_them_down() -> None:
    one = law(gain=5.0, max_speed_deviation_deg_s=10.0, ramp_in_s=0.005, low_pass_hz=100.0)
    goal = np.array([0.1, 0.2, -0.3, 0.4, -0.5, 0.6, 0.7])
    for _ in range(20):
        one.step(reference(goal))
    assert np.abs(one.speed).max() == pytest.approx(radians(10.0))
    np.testing.assert_allclose(one.speed / one.speed[6], goal / goal[6], atol=1e-9)
    assert one.utilization > 100.0


def test_the_slowest_axis_bounds_the_speed() -> None:
    one = law(gain=20.0, max_speed_deviation_deg_s=1e6, ramp_in_s=0.005)
    for _ in range(20):
        one.step(reference(1.0))
    assert np.abs(one.speed).max() == pytest.approx(radians(180.0))


def test_position_deviation_is_a_bound() -> None:
    one = law(gain=20.0, max_position_deviation_deg=5.0)
    for _ in range(1000):
        one.step(reference(0.5))
    assert degrees(one.desired[0]) == pytest.approx(5.0)


def test_ramp_in_is_slow_at_first() -> None:
    quick, slow = law(ramp_in_s=0.005), law(ramp_in_s=0.5)
    for _ in range(5):
        quick.step(reference(0.01))
        slow.step(reference(0.01))
    assert 0.0 < slow.desired[0] < 0.1 * quick.desired[0]


@pytest.mark.parametrize("lag_ms", [0.0, 4.032, 10.0, 20.0])
def test_lag_delays_and_changes_nothing_else(lag_ms: float) -> None:
    direct, late = law(0.0), law(lag_ms / 1e3)
    undelayed, delayed = [], []
    rng = np.random.default_rng(5)
    for _ in range(200):
        message = reference(0.1 * rng.standard_normal(), 0.1 * rng.standard_normal())
        undelayed.append(direct.step(message).q[0])
        delayed.append(late.step(message).q[0])
    times = np.arange(200) * PERIOD_S
    expected = np.interp(times - lag_ms / 1e3, times, undelayed, left=0.0)
    np.testing.assert_allclose(delayed[10:], expected[10:], atol=1e-12)


def test_converged_only_where_it_stands() -> None:
    one = law(convergence_deg=0.5)
    for _ in range(10):
        one.step(reference(0.0))
    assert one.within_s == pytest.approx(10 * PERIOD_S)
    one.step(reference(radians(1.0)))
    assert one.within_s == 0.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"gain": 21.0},
        {"gain": -1.0},
        {"low_pass_hz": 0.0},
        {"ramp_in_s": 0.001},
        {"comm_timeout_s": float("nan")},
    ],
)
def test_what_abb_does_not_allow_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(wrong))):
        ProgramSettings(**wrong)  # type: ignore[arg-type]
