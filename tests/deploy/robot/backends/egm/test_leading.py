"""References of a known controller are bounded whatever the plan does, and bring the arm nearer."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends.egm.leading import LeadingReferences
from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.egm_emulator.control_law import ControlLaw
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.feed_forward import FeedForward, ServoConstants, followable
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_S, Array, JointPoint

PROFILE = limits.profile("lab")
START = np.array(yumi.TABLE_CONFIGURATION)
ADMITTED = 0.186


@functools.cache
def arm() -> ArmKinematics:
    return ArmKinematics("right")


def leading(lead_s: float, low_pass_s: float, admitted: float = ADMITTED) -> LeadingReferences:
    constants = ServoConstants(np.full(7, lead_s), np.full(7, 1e-3))
    made = LeadingReferences(FeedForward(constants, PROFILE), low_pass_s, admitted)
    made.start(START)
    return made


def flange_speed(q: Array, v: Array) -> float:
    return float(np.linalg.norm(arm().jacobian(q)[:3] @ v))


@settings(max_examples=60)
@given(st.floats(0.0, 0.1), st.floats(0.0, 0.1), st.integers(0, 2**32 - 1), st.floats(0.0, 3.0))
def test_whatever_the_plan_does_speeds_are_admitted_ones(
    lead_s: float, low_pass_s: float, seed: int, wild: float
) -> None:
    rng = np.random.default_rng(seed)
    made = leading(lead_s, low_pass_s)
    q = START.copy()
    for _ in range(8):
        v = rng.uniform(-1.0, 1.0, 7) * PROFILE.velocity
        v *= min(1.0, ADMITTED * rng.uniform(0.0, 1.0) / flange_speed(q, v))
        a = wild * rng.uniform(-1.0, 1.0, 7) * PROFILE.acceleration
        _, sent = made.references(JointPoint(q, v, a))
        assert flange_speed(q, sent) <= ADMITTED * (1.0 + 1e-9)
        assert (np.abs(sent) <= PROFILE.velocity * (1.0 + 1e-9)).all()
        # It lies on the way from the plan's speed to what the law needs, never beyond.
        wanted = np.clip(v + (lead_s + low_pass_s) * a, -PROFILE.velocity, PROFILE.velocity)
        along = (sent - v) @ (wanted - v)
        assert -1e-12 <= along <= (wanted - v) @ (wanted - v) + 1e-12
        q = q + GRID_S * v


@pytest.mark.parametrize("inside", [0.0, 0.001, 0.02, 0.1])
@pytest.mark.parametrize("lead_s", [0.02, 0.08, 0.15])
@pytest.mark.parametrize("name", limits.PROFILES)
def test_positions_keep_the_profile_where_valid_plans_end_next_to_its_bounds(
    name: str, lead_s: float, inside: float
) -> None:
    profile = limits.profile(name)
    constants = ServoConstants(np.full(7, lead_s), np.full(7, 0.02))
    rng = np.random.default_rng(round(1e3 * (lead_s + inside)))
    for planned in (followable(profile, constants), profile):
        upper = rng.random(7) < 0.5
        end = np.where(upper, profile.position_upper - inside, profile.position_lower + inside)
        # 0.6 rad are enough for full speed.
        start = end - np.where(upper, 0.6, -0.6)
        plan = StartMotion(start, end, planned, flange_speed=10.0).trajectory
        made = LeadingReferences(FeedForward(constants, profile), 0.008, 0.25)
        made.start(start)
        sent = np.array([made.references(plan.point(k))[0] for k in range(len(plan) + 500)])
        assert np.all(sent >= profile.position_lower)
        assert np.all(sent <= profile.position_upper)
        for order, bound in enumerate((profile.velocity, profile.acceleration, profile.jerk), 1):
            assert np.all(np.abs(np.diff(sent, n=order, axis=0)) / GRID_S**order <= bound)
        # It comes to the plan, but for friction that is being forgotten.
        assert np.abs(sent[-1] - end).max() < 0.01


def test_a_plan_that_is_too_fast_itself_gets_nothing_added() -> None:
    v = np.zeros(7)
    v[0] = 1.5
    _, sent = leading(0.02, 0.01).references(JointPoint(START, v, np.full(7, 9.0)))
    np.testing.assert_array_equal(sent, v)


@settings(max_examples=5)
@given(st.floats(2.0, 20.0), st.floats(4.0, 60.0), st.floats(0.0, 0.03), st.integers(0, 2**32 - 1))
def test_a_controller_is_nearer_to_the_plan_than_with_the_plan_itself(
    gain: float, low_pass_hz: float, lag_s: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rate = 2.0 * np.pi * rng.uniform(0.3, 1.2, 7)
    size = 0.02 * rng.choice((-1.0, 1.0), 7)
    errors = []
    for known in (False, True):
        program = ProgramSettings(gain=gain, low_pass_hz=low_pass_hz, ramp_in_s=0.005)
        law = ControlLaw(program, START, GRID_S, lag_s)
        constants = ServoConstants(np.full(7, lag_s), np.zeros(7))
        made = LeadingReferences(
            FeedForward(constants, PROFILE), 1.0 / (2.0 * np.pi * low_pass_hz), 0.5
        )
        made.start(START)
        error = []
        waiting = ReferencePacket(0, 0, START, np.zeros(7))
        for tick in range(250):
            t = GRID_S * tick
            plan = JointPoint(
                START + size * (1.0 - np.cos(rate * t)),
                size * rate * np.sin(rate * t),
                size * rate**2 * np.cos(rate * t),
            )
            target = law.step(waiting)
            error.append(target.q - plan.q)
            q, v = made.references(plan) if known else (plan.q, plan.v)
            waiting = ReferencePacket(tick, 0, q, v)
        errors.append(float(np.sqrt((np.array(error[100:]) ** 2).mean())))
    plain, with_law = errors
    # What is not known of the future is left; of a law without lag and filter there is nothing.
    assert with_law < max(0.5 * plain, 2e-5)


def test_nonsense_is_refused() -> None:
    constants = ServoConstants(np.zeros(7), np.zeros(7))
    with pytest.raises(ConfigurationError, match="limits"):
        LeadingReferences(FeedForward(constants, None), 0.0, 0.1)
    for low_pass_s, admitted in ((-1.0, 0.1), (0.01, 0.0), (float("nan"), 0.1)):
        with pytest.raises(ConfigurationError, match="low-pass"):
            leading(0.0, low_pass_s, admitted)
