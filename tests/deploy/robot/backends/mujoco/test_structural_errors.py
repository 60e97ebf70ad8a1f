"""What real robots have and servo models do not, in the simulated robot: each really acts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from skewmi.deploy.robot.backend import RobotState
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.egm_emulator.plant import ScenePlant
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.sim.arm.scene import ArmScene
from skewmi.sim.tasks.open_press_close.definition import ARM
from skewmi.trajectory import JointPoint

REST = np.zeros(7)


@pytest.fixture(scope="module")
def exact() -> ArmSimulation:
    return ArmSimulation()


def follow(robot: ArmSimulation, path: np.ndarray) -> list[RobotState]:
    """States while axis 4 is commanded along a path from where it started, rad, a point a tick."""
    q0, states = robot.reset(0), []
    for offset in path:
        q = q0.copy()
        q[4] += offset
        robot.command = JointPoint(q, REST, REST)
        robot.step()
        states.append(robot.robot_state(0))
    return states


def axis_4(states: list[RobotState], what: str = "position") -> np.ndarray:
    return np.array([getattr(state, what)[4] for state in states])


def test_the_nominal_robots_model_and_motion_are_those_of_a_plain_simulation(
    exact: ArmSimulation,
) -> None:
    scene = ArmScene(ARM)
    path = np.cumsum(np.linspace(0.0, 1e-3, 60))
    measured = axis_4(follow(exact, path))

    def compiled(model: mujoco.MjModel) -> bytes:
        buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, buffer)
        return buffer.tobytes()

    assert compiled(exact.scene.model) == compiled(scene.model)
    data = mujoco.MjData(scene.model)
    scene.reset(data)
    q0 = data.qpos[scene.arm_qpos].copy()
    for offset, seen in zip(path, measured, strict=True):
        data.ctrl[scene.arm_ctrl] = q0
        data.ctrl[scene.arm_ctrl[4]] = q0[4] + offset
        mujoco.mj_step(scene.model, data)
        assert data.qpos[scene.arm_qpos[4]] == seen


@pytest.mark.parametrize("friction", [0.3, 3.0])
def test_a_joint_rests_under_less_torque_than_its_friction(friction: float) -> None:
    robot = ArmSimulation(variation=f"{{servo: {{frictionloss: {friction}}}}}")
    start = robot.reset(0)[4]
    # A target so far away that the servo's torque is this part of the friction.
    reach = friction / CONTACT_SERVO.kp[4]
    moved = {
        part: axis_4(follow(robot, np.full(250, part * reach)))[-1] - start
        for part in (0.9, -0.9, 1.5)
    }
    assert abs(moved[0.9]) < 0.03 * reach
    assert abs(moved[-0.9]) < 0.03 * reach
    # It stops where the servo pulls with no more than the friction, or further by its momentum.
    assert 0.49 * reach < moved[1.5] < 0.75 * reach


def test_a_sticking_joint_breaks_away_at_more_torque_than_it_slides_with() -> None:
    path = np.cumsum(0.2 * 0.004 * np.minimum(np.arange(400) / 100, 1.0))
    peak = {}
    for scale in (1, 3):
        stuck = (
            f"{{servo: {{frictionloss: 0.5, stiction_scale: {scale}, stribeck_velocity: 0.02}}}}"
        )
        effort = axis_4(follow(ArmSimulation(variation=stuck), path), "effort")
        peak[scale] = effort.max()
        assert effort[-100:] == pytest.approx(0.5, rel=0.01)
    assert 1.5 <= peak[3] < 2.3
    assert peak[1] < 1.0


def test_sticking_begins_anew_with_each_reset() -> None:
    robot = ArmSimulation(variation="{servo: {stiction_scale: [2, 3]}}")
    path = np.linspace(0.0, 0.05, 40)
    first = axis_4(follow(robot, path))
    np.testing.assert_array_equal(axis_4(follow(robot, path)), first)


def test_a_reversal_shows_the_play() -> None:
    there = np.concatenate([np.linspace(0.0, 0.1, 200), np.full(50, 0.1)])
    back = np.concatenate([np.linspace(0.1, 0.0, 200), np.full(50, 0.0)])
    path = np.concatenate([there, back])
    robot = ArmSimulation(variation="{servo: {frictionloss_scale: 0, backlash: 0.01}}")
    position = axis_4(follow(robot, path)) - robot.reset(0)[4]
    # Half of it is behind the target, on either side.
    assert position[249] == pytest.approx(0.095, abs=1e-4)
    assert position[-1] == pytest.approx(0.005, abs=1e-4)
    still = np.flatnonzero(np.abs(position[250:] - position[249]) < 1e-5)[-1]
    assert path[249] - path[250 + still] == pytest.approx(0.01, abs=2e-3)


def test_an_offset_is_published_and_does_not_move_the_arm(exact: ArmSimulation) -> None:
    offset = [0.01, -0.02, 0.0, 0.005, 0.03, 0.01, 0.02]
    robot = ArmSimulation(variation=f"{{sensors: {{joint_offset: {offset}}}}}")
    path = np.linspace(0.0, 0.05, 60)
    states = follow(robot, path)
    for state, other in zip(states, follow(exact, path), strict=True):
        np.testing.assert_allclose(state.position[:7] - other.position[:7], offset, atol=1e-15)
        np.testing.assert_array_equal(state.velocity, other.velocity)
        np.testing.assert_array_equal(state.effort, other.effort)
    # What the emulated controller measures, too.
    robot.reset(0)
    plant = ScenePlant(robot, 0.004032)
    np.testing.assert_allclose(
        plant.position("right") - robot._data.qpos[robot.scene.arm_qpos], offset, atol=1e-15
    )


def test_velocity_and_effort_have_the_noise_asked_for_and_the_motion_none(
    exact: ArmSimulation,
) -> None:
    path = np.linspace(0.0, 0.05, 150)
    noisy = ArmSimulation(variation="{sensors: {velocity_noise: 0.02, effort_noise: 0.3}}")
    states, truth = follow(noisy, path), follow(exact, path)
    for what, deviation in (("velocity", 0.02), ("effort", 0.3)):
        error = np.array(
            [getattr(a, what) - getattr(b, what) for a, b in zip(states, truth, strict=True)]
        )
        assert error[:, :7].std(axis=0) == pytest.approx(deviation, rel=0.25)
        assert np.abs(error[:, :7].mean(axis=0)).max() < 0.4 * deviation
        np.testing.assert_array_equal(error[:, 7], 0.0)
        # Drawn for each joint and each tick by itself.
        assert np.abs(np.corrcoef(error[:, :7].T) - np.eye(7)).max() < 0.4
    np.testing.assert_array_equal(
        [state.position for state in states], [state.position for state in truth]
    )
    again = follow(noisy, path)
    np.testing.assert_array_equal([s.effort for s in again], [s.effort for s in states])


def test_a_controller_does_not_know_of_the_weight_that_was_added() -> None:
    robot = ArmSimulation(variation="{servo: {frictionloss_scale: 0}, arm: {mass_scale: 2}}")
    nominal = ArmSimulation(variation="{servo: {frictionloss_scale: 0}}")
    efforts = [follow(each, np.zeros(500))[-1].effort[:7] for each in (robot, nominal)]
    # As much again as what the nominal arm's weight does to its joints.
    weight = nominal._data.qfrc_bias[nominal.scene.arm_dof]
    assert np.abs(efforts[1]).max() < 1e-6
    assert efforts[0] == pytest.approx(weight, abs=0.15)
    assert np.abs(weight).max() > 4.0


def test_a_delay_between_two_ticks_is_between_both_motions() -> None:
    path = 1e-5 * np.arange(60.0) ** 2
    eight, nine, twelve = (
        axis_4(follow(ArmSimulation(variation=f"{{servo: {{delay_ms: {ms}}}}}"), path))
        for ms in (8, 9, 12)
    )
    np.testing.assert_allclose(nine, 0.75 * eight + 0.25 * twelve, atol=1e-5)
    assert np.abs(eight - nine).max() > 1e-4
