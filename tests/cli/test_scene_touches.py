"""Planned touches of the nominal scene, for servos that follow well and badly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robot_servers import call

from skewmi.cli.scene_touches import TouchPlanner
from skewmi.deploy.robot.description import SCENE_REQUEST, RobotDescription
from skewmi.deploy.safety.flange_space import CALIBRATION, lowest_of_hand
from skewmi.deploy.session.open_space import open_space
from skewmi.deploy.wire import topics
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.servo import CONTACT_SERVO


@pytest.mark.parametrize(("stiffness", "friction"), [(1.0, 0.3), (0.4, 2.0)])
def test_commanded_hand_keeps_its_height_over_the_scene(
    lock_step_robot: str, stiffness: float, friction: float
) -> None:
    """A soft arm with friction is commanded lower than it goes, but not lower than it may be."""
    described = RobotDescription.from_json(
        call(lock_step_robot, topics.YUMI_DESCRIBE, SCENE_REQUEST)[1]
    )
    limits = joint_limits.profile("lab")
    servo = replace(
        CONTACT_SERVO, kp=stiffness * CONTACT_SERVO.kp, frictionloss=np.full(7, friction)
    )
    left_out: list[str] = []
    planned = TouchPlanner(described, limits, servo, left_out.append).touches()
    assert len(planned) == 6, left_out
    least = open_space(described, CALIBRATION, limits).space.fingers_above
    arm = ArmKinematics("right")
    for touch in planned:
        q = touch.lower.at(np.linspace(0.0, touch.lower.length, 200))
        assert lowest_of_hand(*arm.forward(q)).min() > least, touch.face
