"""What is sent stays within the position bounds, with room to stop, whatever it is asked to do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits
from skewmi.robot_models.feed_forward import FeedForward, ServoConstants
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.position_guard import PositionGuard
from skewmi.trajectory import GRID_S, Array

SLOW = (0.3, 0.05, 0.01)
PROFILES = [*limits.PROFILES.values(), *(limits.profile("lab").no_faster(v) for v in SLOW)]
"""Those with names, and such as robots that admit little make of them, rad/s."""


def name_of(profile: JointLimits) -> str:
    return f"{profile.name} {profile.velocity[0]:.2f} rad/s"


def hostile(profile: JointLimits, rng: np.random.Generator, ticks: int, arms: int) -> Array:
    """References within the bounds that do their worst at them. Shape (ticks, arms, 7), rad.

    Every joint of every arm changes at times of its own between throws from bound to bound, steps,
    sines, random walks and rest, most of them near a bound.
    """
    shape, lower, upper = (arms, 7), profile.position_lower, profile.position_upper
    blocks: list[Array] = []
    while sum(len(block) for block in blocks) < ticks:
        t = np.arange(rng.integers(30, 900))[:, None, None]
        inside = rng.choice([0.0, 1e-7, 1e-4, 1e-3, 1e-2, 0.1, 1.0], shape) * rng.uniform(
            size=shape
        )
        near = np.where(rng.random(shape) < 0.5, upper - inside, lower + inside)
        size = rng.choice([1e-3, 0.02, 0.2, 9.0], shape)
        switch = ((t + rng.integers(0, 400, shape)) // rng.integers(1, 400, shape)) % 2
        sine = np.sin(rng.uniform(0.1, 150.0, shape) * GRID_S * t + rng.uniform(0.0, 6.0, shape))
        walk = np.cumsum(rng.normal(size=(len(t), *shape)), axis=0)
        steps = rng.uniform(-1.0, 1.0, (len(t) // 20 + 1, *shape)).repeat(20, axis=0)[: len(t)]
        rest = np.zeros((len(t), *shape))
        kinds = np.stack((2.0 * switch - 1.0, sine, 0.1 * walk, steps, rest))
        which = rng.integers(0, len(kinds), shape)
        chosen = np.take_along_axis(kinds, which[None, None], axis=0)[0]
        blocks.append(np.clip(near + size * chosen, lower, upper))
    return np.concatenate(blocks)[:ticks]


def sent(law: FeedForward, q: Array, v: Array) -> Array:
    """From three ticks of rest on. Shape (3 + ticks, ..., 7)."""
    law.start(q[0])
    rows = [law.step(*point).copy() for point in zip(q, v, strict=True)]
    return np.concatenate((np.repeat(q[:1], 3, axis=0), np.array(rows)))


def require_limits(profile: JointLimits, x: Array) -> None:
    assert np.all(x >= profile.position_lower), (profile.position_lower - x).max()
    assert np.all(x <= profile.position_upper), (x - profile.position_upper).max()
    require_rates(profile, x)


def require_rates(profile: JointLimits, x: Array) -> None:
    for order, bound in enumerate((profile.velocity, profile.acceleration, profile.jerk), 1):
        found = np.abs(np.diff(x, n=order, axis=0)) / GRID_S**order
        assert np.all(found <= bound), (order, (found / bound).max())


@pytest.mark.parametrize("profile", PROFILES, ids=name_of)
def test_hostile_references_within_the_bounds_cannot_leave_them(profile: JointLimits) -> None:
    rng = np.random.default_rng(round(1e3 * profile.velocity[0]))
    q = hostile(profile, rng, 12_000, 8)
    # Of the reference itself, and what nobody should say of it.
    own = np.clip(np.diff(q, axis=0, prepend=q[:1]) / GRID_S, -profile.velocity, profile.velocity)
    wild = rng.uniform(-1.0, 1.0, q.shape) * profile.velocity
    v = np.where(np.arange(8)[:, None] < 6, own, wild)
    constants = ServoConstants(
        np.array([0.0, 0.15, 0.05, 0.3, 0.0, 0.05, 0.15]), rng.choice([0.0, 0.005, 0.025], 7)
    )
    require_limits(profile, sent(FeedForward(constants, profile), q, v))


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.3), st.floats(0.0, 0.03), st.floats(-3.0, 3.0))
def test_any_constants_and_any_speed(
    seed: int, lead: float, friction: float, log_speed: float
) -> None:
    profile = limits.profile("lab" if seed % 2 else "careful").no_faster(10.0**log_speed)
    rng = np.random.default_rng(seed)
    q = hostile(profile, rng, 600, 6)
    v = np.clip(np.diff(q, axis=0, prepend=q[:1]) / GRID_S, -profile.velocity, profile.velocity)
    constants = ServoConstants(np.full(7, lead), np.full(7, friction))
    require_limits(profile, sent(FeedForward(constants, profile), q, v))


@pytest.mark.parametrize("inside", [0.0, 1e-3, 0.1])
@pytest.mark.parametrize("profile", PROFILES[:3], ids=name_of)
def test_it_comes_to_rest_where_the_reference_does_next_to_a_bound(
    profile: JointLimits, inside: float
) -> None:
    rng = np.random.default_rng(7)
    q = hostile(profile, rng, 1500, 8)
    ends = np.where(
        np.arange(8)[:, None] % 2, profile.position_upper - inside, profile.position_lower + inside
    )
    q = np.concatenate((q, np.tile(ends, (7500 + round(5.0 / profile.velocity[0] / GRID_S), 1, 1))))
    v = np.clip(np.diff(q, axis=0, prepend=q[:1]) / GRID_S, -profile.velocity, profile.velocity)
    x = sent(FeedForward(ServoConstants(np.full(7, 0.1), np.full(7, 0.01)), profile), q, v)
    require_limits(profile, x)
    assert np.abs(x[-1] - ends).max() < 1e-6
    assert np.abs(np.diff(x[-200:], axis=0)).max() / GRID_S < 1e-6


def pushed(profile: JointLimits, side: float) -> tuple[Array, Array]:
    """Positions and accelerations of what wants as much speed towards a bound as it may have."""
    step, hardest = profile.jerk * GRID_S, profile.acceleration
    guard = PositionGuard(profile, profile.velocity, hardest, step)
    bound = profile.position_upper if side > 0.0 else profile.position_lower
    q, v, a = bound - side * 1.5 * np.minimum(1.0, profile.velocity), np.zeros(7), np.zeros(7)
    rows = []
    for _ in range(round(3.0 / profile.velocity[0] / GRID_S)):
        wanted = side * a - step
        for more in (wanted + step, np.minimum(wanted + 2.0 * step, hardest)):
            n = np.floor(np.maximum(more, 0.0) / step)
            gained = (n + 1.0) * more - 0.5 * step * n * (n + 1.0)
            fits = side * v + GRID_S * gained <= profile.velocity
            wanted = np.where(fits, more, wanted)
        a = guard.within(q, v, a, side * wanted)
        v = v + GRID_S * a
        q = q + GRID_S * v
        rows.append((side * (bound - q), side * a))
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("name", limits.PROFILES)
def test_it_brakes_as_late_and_as_hard_as_it_may(name: str, side: float) -> None:
    """Otherwise it would slow motions down that have room."""
    profile = limits.profile(name)
    left, a = pushed(profile, side)
    assert np.all(left > 0.0)
    assert np.all(left.min(axis=0) < 1e-6)
    assert np.all(-a.min(axis=0) > 0.99 * profile.acceleration)
    # Braking ends at the bound, and cannot end at once: it springs back a little, and comes again.
    there = int(np.argmax(left < 1e-6, axis=0).max())
    assert left[there:].max() < 2e-3
    assert left[-100:].max() < 5e-5


def unguarded(profile: JointLimits, constants: ServoConstants) -> FeedForward:
    law = FeedForward(constants, profile)
    assert law._governor is not None
    law._governor._guard.within = lambda q, v, before, wanted: wanted  # type: ignore[method-assign]
    return law


@pytest.mark.parametrize("name", limits.PROFILES)
def test_away_from_the_bounds_it_changes_nothing(name: str) -> None:
    profile = limits.profile(name)
    rng = np.random.default_rng(8)
    middle = 0.5 * (profile.position_lower + profile.position_upper)
    # With what wrong references may overshoot by.
    half = 0.5 * (profile.position_upper - profile.position_lower) - 0.9
    rows = rng.uniform(-1.0, 1.0, (40, 16, 7)).repeat(rng.integers(1, 120), axis=0)
    q = middle + half * rows
    v = rng.uniform(-1.0, 1.0, q.shape) * profile.velocity
    constants = ServoConstants(np.full(7, 0.15), np.full(7, 0.01))
    found = sent(FeedForward(constants, profile), q, v)
    np.testing.assert_array_equal(found, sent(unguarded(profile, constants), q, v))


def test_a_joint_that_begins_outside_goes_no_farther_out() -> None:
    for profile in PROFILES:
        rng = np.random.default_rng(9)
        q = hostile(profile, rng, 3000, 8)
        out = 0.06 * rng.uniform(size=(8, 7))
        upper = rng.random((8, 7)) < 0.5
        q[0] = np.where(upper, profile.position_upper + out, profile.position_lower - out)
        v = np.clip(np.diff(q, axis=0, prepend=q[:1]) / GRID_S, -profile.velocity, profile.velocity)
        x = sent(FeedForward(ServoConstants(np.full(7, 0.1), np.full(7, 0.01)), profile), q, v)
        require_rates(profile, x)
        assert np.all(x <= np.maximum(q[0], profile.position_upper) + 1e-12)
        assert np.all(x >= np.minimum(q[0], profile.position_lower) - 1e-12)


def highest(guard: PositionGuard, q: float, v: float, a: float) -> float:
    """Of the positions while joint 0 brakes towards an upper bound, tick by tick, rad."""
    j, b = float(guard._jerk[0]) / GRID_S**2, float(guard._brake[0]) / GRID_S**2
    top, first = -math.inf, True
    while first or v > 0.0 or a > 0.0:
        a = a if first else max(min(a, a - j), min(a + j, -b))
        first = False
        v += GRID_S * a
        q += GRID_S * v
        top = max(top, q)
    return top


@settings(max_examples=1000)
@given(
    st.sampled_from(PROFILES), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
    st.floats(-9.0, -0.5), st.sampled_from([-1.0, 1.0]),
)  # fmt: skip
# Slower than braking makes it: that is let through.
@example(profile=PROFILES[3], speed=1.0, pushed=-0.6, change=0.0, log_room=-9.0, side=1.0)
def test_what_is_let_through_can_still_stop(
    profile: JointLimits, speed: float, pushed: float, change: float, log_room: float, side: float
) -> None:
    """Restated by braking tick by tick, from states that could stop so far."""
    jerk_step = np.minimum(profile.jerk * GRID_S, profile.velocity / (3.0 * GRID_S))
    guard = PositionGuard(profile, profile.velocity, profile.acceleration, jerk_step)
    bound = float(profile.position_upper[0] if side > 0.0 else -profile.position_lower[0]) - 1e-9
    v, a = speed * float(profile.velocity[0]), pushed * float(profile.acceleration[0])
    step, brake = float(jerk_step[0]), float(guard._brake[0]) / GRID_S**2
    wanted = a + change * step
    q = bound - 10.0**log_room
    braking = max(min(-brake, a + step), a - step)
    stops = highest(guard, q, v, braking) <= bound
    rows = [side * np.full(7, value) for value in (q, v, a, wanted)]
    found = side * float(guard.within(*rows)[0])
    least = min(braking, wanted)
    assert least - 1e-9 <= found <= wanted + 1e-9
    if highest(guard, q, v, wanted) <= bound - 1e-12:
        assert found == wanted
    elif stops:
        assert highest(guard, q, v, found) <= bound + 1e-12
    else:
        assert found == pytest.approx(least, abs=1e-9)


def given_up(a: float, step: float) -> float:
    """What an acceleration adds to the speed until it is taken back, per tick, rad/s^2."""
    return sum(a - i * step for i in range(math.ceil(max(a, 0.0) / step)))


@settings(max_examples=1000)
@given(
    st.sampled_from([*SLOW, 0.04]), st.floats(-4.0, 0.0), st.floats(-1.5, 0.1),
    st.floats(-1.0, 1.0), st.floats(-9.0, -2.0),
)  # fmt: skip
def test_braking_keeps_the_speed_limit_however_low_it_is(
    fastest: float, log_rise: float, pushed: float, change: float, log_room: float
) -> None:
    profile = limits.profile("lab").no_faster(fastest)
    jerk_step = np.minimum(profile.jerk * GRID_S, profile.velocity / (3.0 * GRID_S))
    guard = PositionGuard(profile, profile.velocity, profile.acceleration, jerk_step)
    step = float(jerk_step[0])
    # The hardest that keep it, so far and from now on, and hardly rise any more.
    a = pushed * math.sqrt(2.0 * step * fastest / GRID_S)
    wanted = a + change * step
    v = fastest * 10.0**log_rise - GRID_S * wanted
    for up in (1.0, -1.0):
        assume(GRID_S * given_up(up * a - step, step) <= fastest - up * v)
        assume(GRID_S * given_up(up * wanted, step) <= fastest - up * v)
    q = profile.position_upper - 1e-9 - 10.0**log_room
    rows = [np.full(7, value) for value in (v, a, wanted)]
    found = float(guard.within(q, *rows)[0])
    assert GRID_S * given_up(-found, step) <= fastest + v + 1e-9


def test_bounds_between_which_nothing_can_stop_are_refused() -> None:
    lab = limits.profile("lab")
    tight = replace(lab, position_lower=np.full(7, -0.4), position_upper=np.full(7, 0.4))
    with pytest.raises(ConfigurationError, match="can stop"):
        FeedForward(ServoConstants(np.zeros(7), np.zeros(7)), tight)
    FeedForward(ServoConstants(np.zeros(7), np.zeros(7)), tight.no_faster(1.0))
