"""The simulated robot with feed-forward of known servos."""

from __future__ import annotations

import json

import numpy as np
from unknown_robots import exact_calibration

from skewmi.calibration.calibration_use import servo_constants
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.robot_models import limits
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.trajectory import Array, JointPoint

TICKS = 300
FRICTION = [1.0] * 4 + [0.3] * 3
ROBOT = {"servo": {"kp_scale": 0.5, "kd_scale": 1.4, "frictionloss": FRICTION, "delay_ms": 10}}
KNOWN = exact_calibration(0.5, 1.4, FRICTION, 10.0)


def law() -> FeedForward:
    constants = servo_constants(KNOWN)
    assert constants is not None
    return FeedForward(constants, limits.profile("lab"))


def motion(q0: Array) -> list[JointPoint]:
    """There and back of every joint, clear of the box, with smooth starts."""
    times = 0.004 * np.arange(1, TICKS + 1)
    rate = 2.0 * np.pi / 1.2
    way = np.array([0.05, -0.03, 0.0, -0.08, 0.05, 0.05, 0.1])
    return [
        JointPoint(
            q0 + way * 0.5 * (1.0 - np.cos(rate * t)),
            way * 0.5 * rate * np.sin(rate * t),
            way * 0.5 * rate**2 * np.cos(rate * t),
        )
        for t in times
    ]


def followed(feed_forward: FeedForward | None, seed: int = 0) -> tuple[Array, Array]:
    """Joints less their plan, and what the servos were sent. Each shape (ticks, 7)."""
    robot = ArmSimulation(variation=json.dumps(ROBOT), feed_forward=feed_forward)
    off, sent = [], []
    for point in motion(robot.reset(seed)):
        robot.command = point
        robot.step()
        off.append(robot.robot_state(0).position[:7] - point.q)
        sent.append(robot._data.ctrl[robot.scene.arm_ctrl].copy())
    return np.array(off), np.array(sent)


def test_it_follows_five_times_as_closely() -> None:
    before, after = followed(None)[0], followed(law())[0]
    assert np.sqrt(np.mean(after**2)) < np.sqrt(np.mean(before**2)) / 5.0


def test_what_the_servos_get_is_the_law_of_the_batched_simulation_late_by_the_delay() -> None:
    sent = followed(law())[1]
    robot = ArmSimulation()
    q0 = robot.reset(0)
    alone = law()
    # The batched simulation has arms in rows.
    alone.start(np.tile(q0, (3, 1)))
    expected = np.array(
        [alone.step(np.tile(p.q, (3, 1)), np.tile(p.v, (3, 1)))[1] for p in motion(q0)]
    )
    # A delay of 2.5 steps is the mean of what is 2 and 3 steps late.
    late = 0.5 * (expected[1:-2] + expected[:-3])
    np.testing.assert_allclose(sent[3:], late, rtol=0.0, atol=1e-12)


def test_a_reset_forgets_the_motion_before_it() -> None:
    shared = law()
    first = followed(shared)[1]
    np.testing.assert_array_equal(followed(shared)[1], first)
