"""Ways from anywhere: what they lead through by another model, and that a touch is always left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from robot_servers import LAB
from way_scenes import described, in_contact, obstacles, planner, task_start, touches

from skewmi.calibration.clear_space import ClearSpace
from skewmi.deploy.safety.flange_space import (
    CALIBRATION,
    TASK,
    TOUCH,
    FlangeSpace,
    lowest_of_hand,
)
from skewmi.deploy.safety.guard import CLEARANCE
from skewmi.deploy.session.way_plan import Leg
from skewmi.errors import ConfigurationError, LimitViolationError, SkewmiError
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import Array

ARM = ArmKinematics("right")
HOME = np.array(yumi.HOME["right"])
SPACES = {
    name: FlangeSpace.from_numbers(name, described(HOME).workspaces[name])
    for name in (CALIBRATION, TOUCH)
}


def assert_allowed(legs: Sequence[Leg], q: Array, q_goal: Array) -> None:
    """Connected, within the joints' limits, in its workspaces, and clear by MuJoCo's model."""
    clear = ClearSpace(obstacles(), CLEARANCE - 0.001)
    end = q
    for leg in legs:
        np.testing.assert_allclose(leg.path.at(0.0), end, atol=1e-5)
        way = leg.path.at(np.linspace(0.0, leg.path.length, 60))
        end = way[-1]
        assert (way >= LAB.position_lower).all()
        assert (way <= LAB.position_upper).all()
        position, rotation = ARM.forward(way)
        lowest = lowest_of_hand(position, rotation)
        if leg.workspace == TOUCH:
            # From where it stood: up or aside.
            assert (np.diff(position[:, 2]) >= -1e-4).all()
        else:
            assert clear.first_touch(way) is None, leg.words
        if leg.workspace in SPACES:
            space = SPACES[leg.workspace]
            inside = (position >= np.array(space.low) - 1e-6).all(axis=1)
            inside &= (position <= np.array(space.high) + 1e-6).all(axis=1)
            assert (np.diff(inside.astype(int)) >= 0).all(), "it left"
            low = inside & (lowest < space.fingers_above - 1e-6)
            if low.any():
                assert inside[0]
                assert (lowest[inside] >= lowest[0] - 1e-6).all(), "it went lower"
    np.testing.assert_allclose(end, q_goal, atol=1e-5)


def test_every_place_of_every_touch_is_left_for_the_start() -> None:
    rng = np.random.default_rng(1)
    for touch in touches():
        for q in (
            touch.down.at(rng.uniform(0.0, 1.0) * touch.down.length),
            in_contact(touch, rng.uniform(-0.004, 0.002)),
        ):
            legs = planner(q).way_to(task_start(), CALIBRATION)
            assert_allowed(legs, q, task_start())
        # From beside the box, whatever was met there.
        assert legs[0].words == "straight up"


def test_a_hand_in_contact_goes_up_slowly_and_no_deeper() -> None:
    q = in_contact(touches()[0])
    legs = planner(q).way_to(task_start(), CALIBRATION)
    assert (legs[0].workspace, legs[0].words) == (TOUCH, "straight up")
    assert_allowed(legs, q, task_start())


def test_ways_from_random_poses_are_allowed_or_refused() -> None:
    rng = np.random.default_rng(2)
    found = 0
    for number in range(8):
        near = number % 2
        q = task_start() + rng.normal(0.0, 0.2, 7)
        if not near:
            q = rng.uniform(LAB.position_lower, LAB.position_upper)
        q = np.clip(q, LAB.position_lower + 1e-3, LAB.position_upper - 1e-3)
        try:
            legs = planner(q).way_to(task_start(), CALIBRATION)
        except ConfigurationError:
            continue
        assert_allowed(legs, q, task_start())
        found += 1
    assert found >= 3, found


def test_home_and_start_are_reached_from_each_other() -> None:
    there = planner(task_start()).way_by(task_start(), HOME, TASK)
    assert_allowed(there, task_start(), HOME)
    back = planner(HOME).way_to(task_start(), CALIBRATION)
    assert_allowed(back, HOME, task_start())
    assert planner(HOME).way_by(task_start(), HOME, TASK) == []


def test_jogging_keeps_clear_or_comes_no_nearer() -> None:
    rng = np.random.default_rng(3)
    clear = ClearSpace(obstacles(), CLEARANCE - 0.001)
    made = refused = 0
    q = task_start()
    for _ in range(16):
        there = planner(q, slow=True)
        try:
            if rng.random() < 0.3:
                angle = np.deg2rad(rng.uniform(-10.0, 10.0))
                leg = there.turn(int(rng.integers(7)), angle, TOUCH)
            else:
                step = rng.normal((0.0, 0.0, -0.5), 1.0)
                step *= rng.uniform(0.005, 0.05) / np.linalg.norm(step)
                leg = there.line(step, TOUCH)
        except SkewmiError:
            refused += 1
            continue
        way = leg.path.at(np.linspace(0.0, leg.path.length, 40))
        assert clear.first_touch(way) is None
        q, made = way[-1], made + 1
    assert min(made, refused) >= 2, (made, refused)


def test_from_in_contact_no_step_leads_deeper() -> None:
    touch = touches()[0]
    q = in_contact(touch)
    there = planner(q, slow=True)
    with pytest.raises(LimitViolationError, match="clearance"):
        there.line(-0.003 * touch.normal, TOUCH)
    there.line(0.01 * touch.normal, TOUCH)
    there.line(np.array([0.0, 0.0, 0.01]), TOUCH)


def test_where_no_way_is_found_the_reason_and_what_to_do_are_told() -> None:
    # Folded onto itself: nothing that begins there is clear.
    q = np.clip(np.array([2.9, 0.7, -2.9, 1.3, 5.0, 2.4, 3.9]), LAB.position_lower, None)
    with pytest.raises(ConfigurationError, match=r"the direct one: .*skewmi jog"):
        planner(q).way_to(task_start(), CALIBRATION)
