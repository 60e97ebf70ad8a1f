"""Laws of the reward region and of success."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.policy_io import ActionField, Array, Ball, Field, PolicyLayout
from skewmi.success import episode_success, first_success_step, inside_region

LAYOUT = PolicyLayout(
    task="box",
    observation=(
        Field("hand_x", "m", "world", -0.019, 0.001),
        Field("lid_angle", "rad", "hinge", 0.0, 2.0 / 3.0),
        Field("button_depth", "m", "slide", 0.0, 0.017),
        Field("time", "", "episode", 0.0, 1.0),
    ),
    action=(ActionField("velocity_x", "m", "world", 0.005),),
    reward_region=(
        Ball(("lid_angle",), (0.0,), 0.05),
        Ball(("hand_x", "button_depth"), (0.0, 0.0135), 0.0035),
    ),
    control_dt=0.1,
    episode_steps=200,
    success_hold_steps=10,
)

coordinates = st.floats(-0.1, 0.1)


@given(hnp.arrays(np.float64, (6, 3), elements=coordinates))
def test_region_is_the_intersection_of_its_balls(states: Array) -> None:
    expected = [
        abs(lid) <= 0.05 and math.hypot(x, depth - 0.0135) <= 0.0035 for x, lid, depth in states
    ]
    np.testing.assert_array_equal(inside_region(LAYOUT, states), expected)
    observations = np.concatenate([states, np.ones((6, 1))], axis=1)
    np.testing.assert_array_equal(inside_region(LAYOUT, observations), expected)
    np.testing.assert_array_equal(
        inside_region(LAYOUT, states.reshape(2, 3, 3)), np.reshape(expected, (2, 3))
    )


@given(hnp.arrays(np.float64, (4, 3), elements=coordinates), st.data())
def test_more_balls_never_make_the_region_larger(states: Array, data: st.DataObject) -> None:
    fewer = data.draw(st.lists(st.sampled_from(LAYOUT.reward_region), min_size=1, unique=True))
    smaller_region = dataclasses.replace(LAYOUT, reward_region=LAYOUT.reward_region)
    larger_region = dataclasses.replace(LAYOUT, reward_region=tuple(fewer))
    assert (inside_region(smaller_region, states) <= inside_region(larger_region, states)).all()


@given(hnp.arrays(np.float64, (4, 3), elements=coordinates))
def test_no_region_means_outside_and_nan_is_outside(states: Array) -> None:
    nowhere = dataclasses.replace(LAYOUT, reward_region=())
    assert not inside_region(nowhere, states).any()
    states[:, 1] = np.nan
    assert not inside_region(LAYOUT, states).any()


steps_inside = hnp.arrays(np.bool_, st.tuples(st.integers(0, 30), st.integers(1, 4)))


@given(steps_inside, st.integers(1, 6))
def test_success_is_a_run_of_steps_inside(in_region: Any, hold: int) -> None:
    layout = dataclasses.replace(LAYOUT, success_hold_steps=hold)
    first = first_success_step(layout, in_region)
    texts = ["".join("I" if inside else "." for inside in column) for column in in_region.T]
    for step, text in zip(first, texts, strict=True):
        begin = text.find("I" * hold)
        assert step == (begin + hold if begin >= 0 else -1)
    np.testing.assert_array_equal(episode_success(layout, in_region), first > 0)


@given(steps_inside, st.integers(1, 6))
def test_longer_hold_never_succeeds_earlier(in_region: Any, hold: int) -> None:
    short = dataclasses.replace(LAYOUT, success_hold_steps=hold)
    long = dataclasses.replace(LAYOUT, success_hold_steps=hold + 1)
    assert (episode_success(long, in_region) <= episode_success(short, in_region)).all()
    both = episode_success(long, in_region)
    first_short, first_long = (first_success_step(x, in_region)[both] for x in (short, long))
    assert (first_short < first_long).all()


def test_success_of_one_episode() -> None:
    layout = dataclasses.replace(LAYOUT, success_hold_steps=2)
    assert first_success_step(layout, np.array([True, False, True, True, True])) == 4
    assert not episode_success(layout, np.array([True, False, True]))
