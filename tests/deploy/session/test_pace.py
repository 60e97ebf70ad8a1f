"""How fast a run is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skewmi.deploy.session.pace import action_cycles, followed_speed, planning_limits
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.feed_forward import ServoConstants, followable
from skewmi.sim.tasks.open_press_close.definition import make_layout

LAB = joint_limits.profile("lab")


def test_a_slow_profile_is_not_slowed_down_twice() -> None:
    careful = joint_limits.profile("careful")
    np.testing.assert_array_equal(planning_limits("careful", 0.3).velocity, careful.velocity)
    np.testing.assert_allclose(planning_limits("lab", 0.3).velocity, 0.3 * LAB.velocity)
    np.testing.assert_array_equal(planning_limits("lab", 0.3).jerk, LAB.jerk)


def test_known_servos_are_given_no_more_than_they_can_be_made_to_follow() -> None:
    servos = ServoConstants(np.full(7, 0.1), np.zeros(7))
    found = planning_limits("lab", 0.3, servos)
    np.testing.assert_array_equal(found.jerk, followable(LAB, servos).jerk)
    np.testing.assert_array_equal(found.velocity, planning_limits("lab", 0.3).velocity)
    assert found.name == "lab"


def test_policy_runs_as_fast_as_the_hand_can_follow() -> None:
    layout = make_layout()
    asked = 0.015 / 0.1  # m/s of a full action
    assert followed_speed(layout, 1.0, 2.0 * asked) == 1.0
    assert followed_speed(layout, 1.0, 0.25 * asked) == pytest.approx(0.25)
    assert followed_speed(layout, 0.1, 0.25 * asked) == 0.1


@given(st.floats(0.01, 1.0))
def test_no_control_step_is_shorter_than_asked_for_nor_longer_than_whole_cycles_need(
    speed: float,
) -> None:
    seconds = 0.02 * action_cycles(0.1, speed)
    assert 0.1 / speed - 1e-6 <= seconds < 0.1 / speed + 0.02 + 1e-6
