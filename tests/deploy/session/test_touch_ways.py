"""Every way of a touch is looked at beforehand, as a whole: where it leads, and what it takes."""

from __future__ import annotations

import dataclasses
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from robot_servers import LAB
from way_scenes import described, task_start, touches

from skewmi.deploy.motion.hand_line import hand_line
from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.safety.checks import SpaceChecks
from skewmi.deploy.safety.flange_space import CALIBRATION, CLEAR_HIGH, CLEAR_LOW, TOUCH, FlangeSpace
from skewmi.deploy.session.open_space import open_space
from skewmi.deploy.session.touch_run import TouchRun
from skewmi.errors import LimitViolationError
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics

ARM = ArmKinematics("right")
Q = np.array(yumi.TABLE_CONFIGURATION)
FLANGE = ARM.forward(Q)[0]


def line(step: tuple[float, float, float]) -> JointPath:
    return hand_line(ARM, Q, FLANGE, FLANGE + np.array(step))


def space(above: float = 0.0, low_y: float = -0.05) -> SpaceChecks:
    low = (CLEAR_LOW[0], float(FLANGE[1]) + low_y, CLEAR_LOW[2])
    return SpaceChecks(LAB, FlangeSpace(CALIBRATION, low, CLEAR_HIGH, above))


@pytest.mark.parametrize(
    ("checks", "path", "match"),
    [
        (space(), line((0.0, -0.2, 0.0)), "outside the workspace"),
        (space(above=0.13), line((0.0, 0.0, -0.09)), "height of the fingers"),
        (space(), line((0.0, 0.0, -0.32)), "workspace|clearance"),
    ],
)
def test_a_way_that_leads_out_or_too_low_is_noticed_beforehand(
    checks: SpaceChecks, path: JointPath, match: str
) -> None:
    with pytest.raises(LimitViolationError, match=match):
        TouchRun._look_along(checks, path)


def test_ways_inside_and_ways_in_are_free() -> None:
    TouchRun._look_along(space(), line((0.0, -0.04, 0.0)))
    TouchRun._look_along(space(above=0.13), line((0.0, 0.1, 0.0)))
    # From outside in, but not the same way back.
    TouchRun._look_along(space(), line((0.0, -0.2, 0.0)).reversed())


def test_torque_is_looked_at_all_along() -> None:
    """The elbow is heaviest in the middle of this way, by a little."""
    path = JointPath.line(Q - 0.3 * np.eye(7)[1], Q + 0.3 * np.eye(7)[1])
    clear, rest = FlangeSpace(CALIBRATION, CLEAR_LOW, CLEAR_HIGH), np.zeros((1, 7))
    guard = SpaceChecks(LAB, clear).guard
    uses = [guard.check(q[None], rest, rest).torque for q in path.at(np.linspace(0.0, 1.0, 31))]
    assert max(uses[0], uses[-1]) < 0.998 * max(uses)
    for factor, allowed in ((1.001, True), (0.999, False)):
        weak = dataclasses.replace(LAB, torque=LAB.torque * max(uses) * factor)
        if allowed:
            TouchRun._look_along(SpaceChecks(weak, clear), path)
            continue
        with pytest.raises(LimitViolationError, match="torque"):
            TouchRun._look_along(SpaceChecks(weak, clear), path)


def test_what_is_planned_is_free() -> None:
    start = task_start()
    spaces = {name: open_space(described(start), name, LAB) for name in (CALIBRATION, TOUCH)}
    run: Any = TouchRun.__new__(TouchRun)
    run._stop, run._checks = threading.Event(), SimpleNamespace(spaces=spaces)
    run._settings = SimpleNamespace(above=CALIBRATION, beside=TOUCH)
    planned = touches()
    run._look_at(planned, start)
    # The same, but that one of them goes down where it should have stayed above.
    bad = dataclasses.replace(planned[1], lower=planned[0].down)
    with pytest.raises(LimitViolationError):
        run._look_at([planned[0], bad], start)
