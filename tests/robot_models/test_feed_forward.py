"""Feed-forward: what is sent keeps every limit, comes to rest, and makes known servos follow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits, servo, yumi
from skewmi.robot_models.feed_forward import (
    LARGEST_OFFSET,
    FeedForward,
    ServoConstants,
    followable,
)
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_S, Array

ARMS = 40
MIDDLE = 0.5 * (yumi.POSITION_LOWER + yumi.POSITION_UPPER)
HARDEST = ServoConstants(np.full(7, 0.32), np.full(7, 0.025))
SOFTEST = ServoConstants(np.full(7, 0.01), np.zeros(7))

Reference = Callable[[JointLimits, np.random.Generator], tuple[Array, Array]]
"""Of limits and randomness: positions and velocities, each shape (ticks, arms, 7)."""


def of_accelerations(wanted: Array, profile: JointLimits) -> tuple[Array, Array]:
    """A motion that accelerates as wanted, as far as its own limits let it. (ticks, arms, 7)."""
    q, v = np.tile(MIDDLE, (ARMS, 1)), np.zeros((ARMS, 7))
    a, rows = np.zeros((ARMS, 7)), []
    step = profile.jerk * GRID_S
    for now in wanted:
        # Accelerating further than can be taken back would break the velocity limit.
        room = np.sign(now) * profile.velocity - v
        most = np.sqrt(np.maximum(2.0 * profile.jerk * np.abs(room) - step * np.abs(a), 0.0))
        now = np.where(room * now > 0.0, np.clip(now, -most, most), 0.0)
        a = np.clip(np.clip(now, a - step, a + step), -profile.acceleration, profile.acceleration)
        v = v + GRID_S * a
        q = q + GRID_S * v
        rows.append((q, v))
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


def bang_bang(profile: JointLimits, rng: np.random.Generator) -> tuple[Array, Array]:
    """Full acceleration one way and the other, switching when it hurts most or at random."""
    period = rng.integers(2, 80, (ARMS, 7))
    ticks = np.arange(700)[:, None, None]
    wanted = np.where((ticks // period) % 2 == 0, 1.0, -1.0) * profile.acceleration
    return of_accelerations(wanted, profile)


def starts_and_stops(profile: JointLimits, rng: np.random.Generator) -> tuple[Array, Array]:
    """Pushes and pauses of random length."""
    wanted = np.repeat(rng.integers(-1, 2, (70, ARMS, 7)), 10, axis=0) * profile.acceleration
    return of_accelerations(wanted, profile)


def splices(profile: JointLimits, rng: np.random.Generator) -> tuple[Array, Array]:
    """What no checked plan does: it goes on elsewhere, at another speed."""
    q, v = starts_and_stops(profile, rng)
    for tick in range(50, len(q), 50):
        q[tick:] += rng.uniform(-0.3, 0.3, (ARMS, 7))
        v[tick:] = rng.uniform(-1.0, 1.0, (ARMS, 7)) * profile.velocity
    return q, v


def noise(profile: JointLimits, rng: np.random.Generator) -> tuple[Array, Array]:
    """No motion at all."""
    return (
        MIDDLE + rng.normal(0.0, 0.2, (700, ARMS, 7)),
        rng.normal(0.0, 1.0, (700, ARMS, 7)) * profile.velocity,
    )


def sent(law: FeedForward, q: Array, v: Array, resting_ticks: int = 0) -> Array:
    """What a law sends for a reference that then rests. Shape (ticks, arms, 7)."""
    law.start(q[0])
    rows = [law.step(*point).copy() for point in zip(q, v, strict=True)]
    still = np.zeros_like(v[-1])
    rows += [law.step(q[-1], still).copy() for _ in range(resting_ticks)]
    return np.array(rows)


@pytest.mark.parametrize("name", limits.PROFILES)
@pytest.mark.parametrize("constants", [HARDEST, SOFTEST], ids=["hardest", "softest"])
@pytest.mark.parametrize("reference", [bang_bang, starts_and_stops, splices, noise])
def test_what_is_sent_keeps_every_limit_whatever_the_reference_does(
    name: str, constants: ServoConstants, reference: Reference
) -> None:
    profile = limits.profile(name)
    q, v = reference(profile, np.random.default_rng(1))
    x = sent(FeedForward(constants, profile), q, v)
    x = np.concatenate((np.repeat(q[:1], 3, axis=0), x))
    for order, bound in enumerate((profile.velocity, profile.acceleration, profile.jerk), 1):
        found = np.abs(np.diff(x, n=order, axis=0)) / GRID_S**order
        assert np.all(found <= bound), (order, (found / bound).max())
    assert np.all((x >= profile.position_lower) & (x <= profile.position_upper))


@pytest.mark.parametrize("name", limits.PROFILES)
def test_it_comes_to_rest_where_the_reference_rests(name: str) -> None:
    profile = limits.profile(name)
    q, v = starts_and_stops(profile, np.random.default_rng(2))
    x = sent(FeedForward(HARDEST, profile), q, v, resting_ticks=round(30.0 / GRID_S))
    # Many references go on beyond the bounds.
    rest = np.clip(q[-1], profile.position_lower, profile.position_upper)
    assert np.abs(x[-1] - rest).max() < 1e-6
    # Not a swing about it either.
    assert np.abs(np.diff(x[-100:], axis=0)).max() / GRID_S < 1e-6


def stopping_way(profile: JointLimits) -> Array:
    """What full speed goes in the time in which it stops, rad: v^2 / a + v a / j. Shape (7,)."""
    v, a, j = profile.velocity, profile.acceleration, profile.jerk
    return v**2 / a + v * a / j


@pytest.mark.parametrize("name", limits.PROFILES)
@pytest.mark.parametrize("reference", [bang_bang, starts_and_stops])
def test_what_is_sent_stays_near_a_reference_within_limits(name: str, reference: Reference) -> None:
    profile = limits.profile(name)
    q, v = reference(profile, np.random.default_rng(3))
    x = sent(FeedForward(HARDEST, profile), q, v)
    off = np.abs(x - np.clip(q, profile.position_lower, profile.position_upper)).max(axis=0)
    assert np.all(off <= LARGEST_OFFSET + stopping_way(profile))


@pytest.mark.parametrize("lead", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("reference", [bang_bang, starts_and_stops])
def test_plans_that_can_be_followed_are_sent_much_closer_to_the_law(
    lead: float, reference: Reference
) -> None:
    """Beside plans that use the profile itself, in the worst way."""
    profile, constants = limits.profile("lab"), ServoConstants(np.full(7, lead), np.full(7, 0.005))
    worst = []
    for of_plan in (followable(profile, constants), profile):
        q, v = reference(of_plan, np.random.default_rng(5))
        law, governed = (sent(FeedForward(constants, bound), q, v) for bound in (None, profile))
        # Beyond joint limits the law itself cannot be sent.
        law = np.clip(law, profile.position_lower, profile.position_upper)
        worst.append(float(np.abs(governed - law).max()))
    assert worst[0] < 0.8 * worst[1]


@pytest.mark.parametrize("name", limits.PROFILES)
@pytest.mark.parametrize("longest", [0.0, 0.01, 0.1, 0.3, 9.0])
def test_limits_that_can_be_followed_are_within_the_given_ones(name: str, longest: float) -> None:
    profile = limits.profile(name)
    lead = np.linspace(0.0, longest, 7)
    found = followable(profile, ServoConstants(lead, np.zeros(7)))
    assert np.all(found.acceleration < profile.acceleration)
    assert np.all(found.jerk <= profile.jerk)
    assert np.ptp(found.jerk) == 0.0
    assert np.all(lead * found.jerk <= 1.5 * profile.acceleration * (1.0 + 1e-12))
    if not longest:
        np.testing.assert_array_equal(found.jerk, profile.jerk)
    np.testing.assert_array_equal(found.velocity, profile.velocity)
    np.testing.assert_array_equal(found.position_upper, profile.position_upper)


def test_without_limits_it_is_the_law_itself() -> None:
    constants = ServoConstants(np.full(7, 0.1), np.full(7, 0.02))
    law = FeedForward(constants, None)
    q, v = np.zeros(7), np.full(7, 0.5)
    law.start(q)
    for _ in range(200):
        x = law.step(q, v)
    np.testing.assert_allclose(x, 0.1 * 0.5 + 0.02, rtol=1e-2)
    for _ in range(200):
        x = law.step(q, -v)
    np.testing.assert_allclose(x, -(0.1 * 0.5 + 0.02), rtol=1e-2)


def test_offsets_are_bounded_whatever_the_constants_say() -> None:
    law = FeedForward(ServoConstants(np.full(7, 9.0), np.full(7, 9.0)), None)
    law.start(np.zeros(7))
    for _ in range(50):
        x = law.step(np.zeros(7), np.ones(7))
    np.testing.assert_array_equal(x, LARGEST_OFFSET)


def test_many_arms_are_as_many_single_ones() -> None:
    profile = limits.profile("lab")
    q, v = bang_bang(profile, np.random.default_rng(4))
    together = sent(FeedForward(HARDEST, profile), q[:100], v[:100])
    alone = sent(FeedForward(HARDEST, profile), q[:100, 3], v[:100, 3])
    np.testing.assert_array_equal(together[:, 3], alone)


def joint_error(law: FeedForward | None, kp: Array, kd: Array, friction: Array) -> float:
    """RMS of joints that follow a smooth motion, rad: servos with friction, no coupling."""
    inertia = servo.LINK_SIDE_INERTIA + servo.ARMATURE
    nominal = servo.DEFAULT.kd / servo.DEFAULT.kp
    q = np.zeros(7)
    v, errors, parts = np.zeros(7), [], 8
    dt = GRID_S / parts
    if law is not None:
        law.start(q)
    for tick in range(1000):
        t = tick * GRID_S
        reference, speed = 0.1 * (1.0 - np.cos(3.0 * t)), 0.3 * np.sin(3.0 * t)
        q_d, v_d = np.full(7, reference), np.full(7, speed)
        x = q_d + nominal * v_d if law is None else law.step(q_d, v_d)
        for _ in range(parts):
            mass = inertia + dt * kd + dt * dt * kp
            free = (v * inertia + dt * kp * (x - q)) / mass
            v = np.sign(free) * np.maximum(np.abs(free) - dt * friction / mass, 0.0)
            q = q + dt * v
        errors.append(q - q_d)
    return float(np.sqrt(np.mean(np.square(errors))))


def test_soft_joints_with_friction_follow_five_times_as_closely() -> None:
    kp, kd = 0.5 * servo.DEFAULT.kp, 1.5 * servo.DEFAULT.kd
    friction = 5.0 * servo.DEFAULT.frictionloss
    constants = ServoConstants(kd / kp, friction / kp)
    before = joint_error(None, kp, kd, friction)
    after = joint_error(FeedForward(constants, limits.profile("lab")), kp, kd, friction)
    assert after < before / 5.0


@pytest.mark.parametrize("value", [np.full(7, -0.1), np.full(7, np.nan), np.zeros(6)])
def test_constants_that_make_no_sense_are_refused(value: Array) -> None:
    with pytest.raises(ConfigurationError, match="7 finite numbers"):
        ServoConstants(value, np.zeros(7))
