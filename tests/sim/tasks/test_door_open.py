"""Scene and physics of DoorOpen."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from skewmi.robot_models import frames, kinematics
from skewmi.sim import tasks
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.model_fields import model_fields
from skewmi.sim.arm.reach import TIP, reachable
from skewmi.sim.arm.scene import ArmScene, workspace_of
from skewmi.sim.tasks.door_open import definition, parts, targets
from skewmi.sim.tasks.door_open.definition import ARM
from skewmi.success import inside_region
from skewmi.train.config import MetricsConfig
from skewmi.train.metrics import CoverageMetrics

LAYOUT = definition.make_layout()
WORKSPACE = workspace_of(LAYOUT)

PUBLISHED_ARC = {0.0: (0.025, 0.090), 0.4: (0.013, 0.118), 0.8: (-0.009, 0.139),
                 1.216: (-0.038, 0.151), 1.52: (-0.061, 0.151)}  # fmt: skip
"""The bar's y and z, world, m, by how far the door is open, as measured in the published scene."""


@pytest.fixture(scope="module")
def scene() -> ArmScene:
    return ArmScene(ARM)


@pytest.fixture
def data(scene: ArmScene) -> mujoco.MjData:
    data = mujoco.MjData(scene.model)
    scene.reset(data)
    return data


def run(scene: ArmScene, data: mujoco.MjData, seconds: float) -> None:
    mujoco.mj_step(scene.model, data, round(seconds / scene.model.opt.timestep))


def test_the_state_has_five_numbers() -> None:
    names = ("hand_x", "hand_y", "hand_z", "gripper", "door_angle")
    assert tuple(field.name for field in LAYOUT.state_fields) == names


@pytest.mark.parametrize(("angle", "bar"), PUBLISHED_ARC.items())
def test_the_bar_moves_on_the_published_arc(scene, data, angle: float, bar: tuple) -> None:
    data.qpos[scene.scene_qpos[0]] = angle
    mujoco.mj_kinematics(scene.model, data)
    np.testing.assert_allclose(data.geom("handle_bar").xpos[1:], bar, atol=1e-3)
    x_axis = data.geom("handle_bar").xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(np.abs(x_axis), (1.0, 0.0, 0.0), atol=1e-9)


def test_a_point_of_the_door_is_turned_back_to_where_it_was(scene, data) -> None:
    for angle in np.linspace(0.0, parts.DOOR_MAX, 7):
        data.qpos[scene.scene_qpos[0]] = angle
        mujoco.mj_kinematics(scene.model, data)
        _, y, z = data.geom("handle_bar").xpos
        np.testing.assert_allclose(
            parts.in_door(y, z, angle), parts.HANDLE_BAR_CENTRE[1:], atol=1e-9
        )


def test_nothing_touches_at_the_start_and_it_is_at_rest(scene, data) -> None:
    before = data.qpos.copy()
    assert data.ncon == 0
    run(scene, data, 1.0)
    assert data.ncon == 0
    np.testing.assert_allclose(data.qpos, before, atol=1e-4)


@pytest.mark.parametrize("angle", [0.0, 0.05, 0.3, 0.8, 1.216, 1.5])
def test_the_door_stays_where_it_is_left(scene, data, angle: float) -> None:
    # The hand out of the door's way.
    data.qpos[:] = scene.start_positions(LAYOUT, np.array([[0.0, -0.08, 0.30]]))[0]
    data.ctrl[:] = scene.controls(data.qpos[scene.arm_qpos], WORKSPACE.gripper_opening)
    data.qpos[scene.scene_qpos[0]] = angle
    run(scene, data, 10.0)
    assert data.ncon == 0
    assert data.qpos[scene.scene_qpos[0]] == pytest.approx(angle, abs=2e-3)


def test_a_hinge_with_less_friction_than_the_weight_gives_lets_the_door_fall(scene, data) -> None:
    worst = 0.0
    for angle in np.linspace(0.0, parts.DOOR_MAX, 30):
        data.qpos[scene.scene_qpos[0]] = angle
        mujoco.mj_forward(scene.model, data)
        worst = max(worst, abs(float(data.qfrc_bias[scene.scene_dof[0]])))
    assert 0.07 < worst < 0.076
    assert worst < 0.8 * parts.DOOR_FRICTIONLOSS
    env = ArmBatch(ARM, 1, num_threads=1, variation='{"door": {"frictionloss": 0.05}}')
    env.reset()
    env.batch.bind("qpos")[0, env.scene.scene_qpos[0]] = 0.3
    for _ in range(20):
        observation = env.step(np.zeros((1, 3))).observation
    assert observation[0, 4] < 0.1


def test_the_doors_stops_hold(scene, data) -> None:
    for torque, stop in ((-5.0, 0.0), (5.0, parts.DOOR_MAX)):
        scene.reset(data)
        data.qfrc_applied[scene.scene_dof[0]] = torque
        run(scene, data, 1.5)
        assert data.qpos[scene.scene_qpos[0]] == pytest.approx(stop, abs=definition.DOOR.give)


def test_the_hand_reaches_every_corner_of_its_box_from_the_start() -> None:
    arm = kinematics.ArmKinematics("right")
    corners = np.array(np.meshgrid(*zip(ARM.low, ARM.high, strict=True))).reshape(3, -1).T
    result = arm.inverse(
        corners - frames.BASE_IN_WORLD,
        frames.HAND_DOWN,
        np.tile(ARM.start_configuration, (len(corners), 1)),
        posture=np.array(ARM.start_configuration),
    )
    kinematics.require_converged(result)


@pytest.mark.parametrize("name", targets.TARGETS)
def test_a_target_is_an_angle_and_nothing_else(name: str) -> None:
    layout = ARM.layout(target=name)
    angle = targets.TARGETS[name]
    for off, inside in ((0.0, True), (-0.034, True), (0.036, False), (-0.036, False)):
        for hand in ((-0.05, 0.0, 0.25), ARM.low, ARM.high):
            state = np.array([*hand, 0.01, angle + off])
            assert inside_region(layout, state) == inside
    assert not inside_region(layout, np.array([0.0, 0.0, 0.32, 0.01, angle]))


def test_what_is_inside_the_panel_is_not_reachable() -> None:
    def state(y: float, tip: float, angle: float) -> np.ndarray:
        return np.array([-0.05, y, tip + TIP, definition.GRIPPER_OPENING, angle])

    # Above the shut door, hooked into the open one, and with the panel through a finger.
    assert reachable(ARM, LAYOUT, state(0.0, 0.070, 0.0))
    assert reachable(ARM, LAYOUT, state(-0.053, 0.136, 1.216))
    assert not reachable(ARM, LAYOUT, state(0.0, 0.080, 0.8))
    assert not reachable(ARM, LAYOUT, state(-0.02, 0.110, 1.216))


def test_states_under_random_actions_count_as_reachable_and_the_door_is_moved() -> None:
    env = ArmBatch(ARM, 8, num_threads=1, seed=3)
    rng = np.random.default_rng(3)
    states = [env.reset()]
    # From beside the bar, as a script would come: random actions alone seldom get there.
    for axis, steps in ((0, 5), (2, 6)):
        for _ in range(steps):
            action = np.zeros((8, 3))
            action[:, axis] = -1.0
            states.append(env.step(action).observation)
    action = np.zeros((8, 3))
    for _ in range(120):
        action = 0.85 * action + 0.5 * rng.standard_normal((8, 3))
        states.append(env.step(np.clip(action, -1.0, 1.0)).observation)
    seen = np.array(states)
    assert np.isfinite(seen).all()
    assert reachable(ARM, LAYOUT, seen).all()
    door = seen[..., 4]
    assert door.min() > -definition.DOOR.give
    assert door.max() < parts.DOOR_MAX + definition.DOOR.give


def test_variations_of_the_door_do_what_they_say(scene) -> None:
    text = """
    door: {frictionloss: 0.2, damping: 0.3, mass: 0.26}
    door_pose: {x: 0.01, y: -0.02, yaw_deg: 10}
    """
    sample = ARM.variations.parse(text).sample(np.random.default_rng(0), 1)
    model = scene.physics_model
    fields = model_fields(model, ARM.variations.keys, sample)
    dof, frame, door = scene.scene_dof[0], model.body("door_frame").id, model.body("door").id
    assert fields.values["dof_frictionloss"][0, dof] == 0.2
    assert fields.values["dof_damping"][0, dof] == 0.3
    assert model.body_mass[door] == pytest.approx(parts.PANEL_MASS + parts.HANDLE_MASS)
    assert fields.values["body_mass"][0, door] == 0.26
    np.testing.assert_allclose(
        fields.values["body_inertia"][0, door], 2.0 * model.body_inertia[door]
    )
    moved = fields.values["body_pos"][0, frame] - model.body_pos[frame]
    np.testing.assert_allclose(moved, (0.01, -0.02, 0.0), atol=1e-12)
    half = np.radians(10.0) / 2
    np.testing.assert_allclose(
        fields.values["body_quat"][0, frame], (np.cos(half), 0, 0, np.sin(half))
    )


def test_it_is_measured_on_the_published_grid() -> None:
    metrics = tasks.find(ARM.name).metrics
    assert [axis.points for axis in metrics.grid] == [10, 10, 10, 2, 10]
    assert [axis.field for axis in metrics.grid] == [f.name for f in LAYOUT.state_fields]
    assert metrics.unit_range
    # Its ends are those of the published code: the hand's box, and what fingers and door may do.
    ends = np.array([(axis.low, axis.high) for axis in metrics.grid]).T
    np.testing.assert_allclose(ends[:, :3], (ARM.low, ARM.high))
    np.testing.assert_allclose(ends[0, 3:], 0.0)
    measured = CoverageMetrics(LAYOUT, metrics, MetricsConfig())
    assert len(measured.points) == 20_000
    env = ArmBatch(ARM, 2, num_threads=1)
    first = env.reset(0)
    measured.set_reachable(env, first[0])
    assert 0.5 < measured.reachable.mean() < 0.9
    # Fingers that no action moves are in a cell of the grid, and as good as on one of its points;
    # so is a door that rests on its soft stop, and a hand pushed into a corner of its box.
    for _ in range(5):
        settled = env.step(np.ones((2, 3))).observation
    assert settled[:, 4].max() < 1e-3
    measured.add(settled)
    assert 1 <= measured.visited.sum() <= 2
    measured.visited[:] = False
    measured.add(first)
    assert 1 <= measured.visited.sum() <= 2
    fingers = measured.project(first)[:, 3]
    assert np.abs(fingers - 1.0).max() < 0.5 * measured.config.coverage_width
    assert measured.coverage()["coverage"] > 0.0
