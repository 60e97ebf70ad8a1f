"""What is known of a robot, in the batched simulation."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from moved_boxes import found_at
from unknown_robots import exact_calibration

from skewmi.calibration.calibration_file import Calibration, Constant, write_calibration
from skewmi.calibration.calibration_use import servo_constants
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import Array
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.definition import SIM_DT, SUBSTEPS
from skewmi.sim.arm.known import Known
from skewmi.sim.tasks.open_press_close.definition import ARM

UP_AND_BACK = np.array([[0.0, 0.6, 0.8]] * 8 + [[0.0, -0.6, 0.3]] * 4 + [[0.0, 0.0, 0.0]] * 8)
"""Actions that keep clear of the box."""


def followed(
    calibration: Calibration | None, variation: dict[str, object] | None, n: int = 3
) -> tuple[Array, Array]:
    """Hand after each step, world, m, shape (steps, n, 3), and the targets of the servos."""
    varied = None if variation is None else json.dumps(variation)
    env = ArmBatch(ARM, n, num_threads=1, seed=3, variation=varied, calibration=calibration)
    env.reset()
    hand, targets = [], []
    for action in UP_AND_BACK:
        hand.append(env.step(np.tile(action, (n, 1))).observation[:, :3])
        targets.append(env.servo_targets.copy())
    return np.array(hand), np.array(targets)


def test_a_soft_robot_with_friction_and_delay_follows_five_times_as_closely() -> None:
    friction = [1.0] * 4 + [0.3] * 3
    robot: dict[str, object] = {
        "servo": {"kp_scale": 0.5, "kd_scale": 1.4, "frictionloss": friction, "delay_ms": 20}
    }
    known = exact_calibration(0.5, 1.4, friction, 20.0)
    wanted, before, after = (
        followed(*case)[0] for case in ((None, None), (None, robot), (known, robot))
    )
    off = [np.sqrt(np.mean(np.square(hand - wanted))) for hand in (before, after)]
    assert off[1] < off[0] / 5.0, off


def test_known_servos_follow_late_commands_as_closely() -> None:
    friction = [1.0] * 4 + [0.3] * 3
    robot = {"kp_scale": 0.5, "kd_scale": 1.4, "frictionloss": friction, "delay_ms": 20}
    late = {"command": {"delay_ms": 100}}
    known = exact_calibration(0.5, 1.4, friction, 20.0)
    wanted, before, after = (
        followed(*case)[0]
        for case in (
            (None, late),
            (None, {"servo": robot, **late}),
            (known, {"servo": robot, **late}),
        )
    )
    off = [np.sqrt(np.mean(np.square(hand - wanted))) for hand in (before, after)]
    assert off[1] < off[0] / 5.0, off


def test_the_targets_are_the_law_of_the_commanded_lines() -> None:
    calibration = exact_calibration(0.5, 1.4, 0.3, 10.0)
    env = ArmBatch(ARM, 2, num_threads=1, seed=3, calibration=calibration)
    env.reset()
    constants = servo_constants(calibration)
    assert constants is not None
    law, begin = FeedForward(constants, None), env.command()[1]
    law.start(begin)
    for action in UP_AND_BACK[:4]:
        env.step(np.tile(action, (2, 1)))
        end = env.command()[1]
        velocity = (end - begin) / (SUBSTEPS * SIM_DT)
        for substep in range(SUBSTEPS):
            q = begin + velocity * (substep + 1) * SIM_DT
            sent = env.servo_targets[:, substep, env.scene.arm_ctrl]
            np.testing.assert_allclose(sent, law.step(q, velocity), rtol=0.0, atol=1e-9)
        begin = end


def test_without_a_calibration_of_servos_nothing_changes() -> None:
    known = exact_calibration()
    scene_alone = Calibration(known.created, known.version, scene=found_at(0.0, 0.0, 0.0))
    for variation in (None, {"servo": {"delay_ms": 10}}):
        nominal, scene = followed(None, variation), followed(scene_alone, variation)
        np.testing.assert_array_equal(nominal[1], scene[1])


def test_batches_of_any_size_and_episodes_after_one_another_are_alike() -> None:
    known = exact_calibration(0.5, 1.4, 0.3, 10.0)
    robot: dict[str, object] = {"servo": {"kp_scale": 0.5, "kd_scale": 1.4, "delay_ms": 10}}
    env = ArmBatch(ARM, 3, num_threads=2, seed=3, variation=json.dumps(robot), calibration=known)
    runs = []
    for _ in range(2):
        env.reset(seed=3)
        runs.append([env.step(np.tile(a, (3, 1))).observation for a in UP_AND_BACK[:6]])
    np.testing.assert_array_equal(runs[0], runs[1])


def test_it_is_given_as_a_file_or_as_what_the_file_says(tmp_path: Path) -> None:
    calibration = exact_calibration()
    file = write_calibration(tmp_path / "robot.yaml", calibration)
    known = Known.of(calibration)
    assert known is not None
    assert known == Known.of(file) == Known.of(str(file)) == Known.of(known.to_json())
    assert Known.of(None) is None
    with pytest.raises(NotFoundError, match="skewmi calibrate"):
        Known.of(tmp_path / "none.yaml")
    for wrong in ("{", '{"schema": 1}', 3):
        with pytest.raises(ConfigurationError, match="calibration"):
            Known.of(wrong)  # type: ignore[arg-type]


LID, BUTTON = 4, 5
"""Columns of the observation."""


@pytest.mark.parametrize("measured", [False, True])
def test_the_lid_is_read_from_its_zero_and_nothing_else_is(measured: bool) -> None:
    robot = {"sensors": {"lid_bias_deg": 8.0, "button_noise": 0.001}}
    known = exact_calibration()
    if measured:
        bias = Constant((8.0,), (8.0,), (8.0,), (False,))
        scene = dataclasses.replace(found_at(0.0, 0.0, 0.0), lid_bias_deg=bias)
        known = dataclasses.replace(known, scene=scene)
    seen = {}
    for calibration in (None, known):
        env = ArmBatch(
            ARM, 2, num_threads=1, seed=3, variation=json.dumps(robot), calibration=calibration
        )
        rows = [env.reset()] + [env.step(np.zeros((2, 3))).observation for _ in range(3)]
        seen[calibration is None] = np.array(rows)
    np.testing.assert_allclose(seen[True][..., LID], np.radians(8.0), atol=1e-3)
    # The first observation is the reading that the zero is taken from.
    np.testing.assert_allclose(seen[False][..., LID], 0.0, atol=1e-3)
    np.testing.assert_array_equal(seen[False][..., BUTTON], seen[True][..., BUTTON])


def test_a_known_bias_is_taken_off_though_the_sensor_is_ideal() -> None:
    bias = Constant((5.0,), (5.0,), (5.0,), (False,))
    scene = dataclasses.replace(found_at(0.0, 0.0, 0.0), lid_bias_deg=bias)
    known = dataclasses.replace(exact_calibration(), scene=scene)
    env = ArmBatch(ARM, 1, num_threads=1, calibration=known)
    assert env.reset()[0, LID] == pytest.approx(-np.radians(5.0))
