"""Scene and physics of OpenPressClose."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from skewmi.errors import KinematicsError
from skewmi.sim.arm import definition as arm_definition
from skewmi.sim.arm.scene import ArmScene, workspace_of
from skewmi.sim.tasks.open_press_close import definition, parts
from skewmi.sim.tasks.open_press_close.definition import ARM
from skewmi.success import inside_region

LAYOUT = definition.make_layout()
WORKSPACE = workspace_of(LAYOUT)


@pytest.fixture(scope="module")
def scene() -> ArmScene:
    return ArmScene(ARM)


@pytest.fixture
def data(scene: ArmScene) -> mujoco.MjData:
    data = mujoco.MjData(scene.model)
    scene.reset(data)
    return data


def run(scene: ArmScene, data: mujoco.MjData, seconds: float) -> None:
    mujoco.mj_step(scene.model, data, round(seconds / arm_definition.SIM_DT))


# The scene


def test_the_time_grid_is_the_robots() -> None:
    np.testing.assert_allclose(arm_definition.SUBSTEPS * arm_definition.SIM_DT, LAYOUT.control_dt)
    assert ArmScene(ARM).model.opt.timestep == arm_definition.SIM_DT
    assert ArmScene(ARM).model.opt.gravity[2] == -9.81


def test_the_handle_is_where_the_published_scene_has_it(scene, data) -> None:
    bar = data.geom("handle_bar").xpos
    np.testing.assert_allclose(bar, parts.HANDLE_BAR_CENTRE, atol=1e-9)
    hinge = np.array(parts.LID_HINGE)
    assert np.hypot(*(bar - hinge)[1:]) == pytest.approx(0.1406, abs=1e-4)
    # Bar on its arc at pi/2, from the published scene: y 0.036, z 0.209.
    data.qpos[scene.scene_qpos[0]] = np.pi / 2
    mujoco.mj_kinematics(scene.model, data)
    np.testing.assert_allclose(data.geom("handle_bar").xpos[1:], (0.036, 0.209), atol=1e-3)


def test_nothing_touches_at_the_start(scene, data) -> None:
    assert data.ncon == 0
    run(scene, data, 1.0)
    assert data.ncon == 0


def test_the_start_is_at_rest(scene, data) -> None:
    before = data.qpos.copy()
    run(scene, data, 2.0)
    np.testing.assert_allclose(data.qpos, before, atol=1e-4)


@pytest.mark.parametrize("angle", [0.0, 0.05, 0.5, 1.2, np.pi / 2, 2.2, 2.5])
def test_the_lid_stays_where_it_is_left(scene, data, angle: float) -> None:
    # The hand out of the lid's way.
    data.qpos[:] = scene.start_positions(LAYOUT, np.array([[-0.009, 0.0, 0.355]]))[0]
    if angle > 1.0:
        data.qpos[:] = scene.start_positions(LAYOUT, np.array([[-0.009, -0.15, 0.355]]))[0]
    data.ctrl[:] = scene.controls(data.qpos[scene.arm_qpos], WORKSPACE.gripper_opening)
    data.qpos[scene.scene_qpos[0]] = angle
    run(scene, data, 10.0)
    assert data.ncon == 0
    assert data.qpos[scene.scene_qpos[0]] == pytest.approx(angle, abs=2e-3)


@pytest.mark.parametrize("load", [0.0, 1.0, 2.9])
def test_the_button_stays_where_it_is_pushed(scene, data, load: float) -> None:
    data.qpos[scene.scene_qpos[1]] = 0.012
    dof = scene.model.joint("button_slide").dofadr[0]
    data.qfrc_applied[dof] = load
    run(scene, data, 10.0)
    # Less than the slide's dry friction: 10 s may creep by a third of a millimetre.
    assert data.qpos[scene.scene_qpos[1]] == pytest.approx(0.012, abs=3.5e-4)


def test_the_button_gives_way_to_more_than_its_friction_and_stops_at_its_travel(
    scene, data
) -> None:
    data.qfrc_applied[scene.model.joint("button_slide").dofadr[0]] = 60.0
    run(scene, data, 1.0)
    assert data.qpos[scene.scene_qpos[1]] == pytest.approx(parts.BUTTON_TRAVEL, abs=1e-3)
    x, y, z = WORKSPACE.start
    assert inside_region(LAYOUT, np.array([x, y, z, 0, 0, data.qpos[scene.scene_qpos[1]]]))


@pytest.mark.parametrize("torque", [-1.0, -5.0, -10.0])
def test_the_shut_lid_does_not_go_negative(scene, data, torque: float) -> None:
    data.qfrc_applied[scene.model.joint("lid_hinge").dofadr[0]] = torque
    run(scene, data, 1.0)
    assert data.qpos[scene.scene_qpos[0]] > -2e-3


def test_the_measured_hand_is_mujocos_flange(scene, data) -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        data.qpos[scene.arm_qpos] += rng.uniform(-0.2, 0.2, 7)
        mujoco.mj_kinematics(scene.model, data)
        position_w, rotation = scene.hand_pose(data.qpos)
        np.testing.assert_allclose(position_w, data.site("tool0_r").xpos, atol=1e-9)
        np.testing.assert_allclose(rotation, data.site("tool0_r").xmat.reshape(3, 3), atol=1e-9)


def test_a_start_out_of_reach_is_refused(scene) -> None:
    with pytest.raises(KinematicsError, match="cannot be reached"):
        scene.start_positions(LAYOUT, np.array([[0.6, 0.0, 0.3]]))


def test_one_data_reset_varies_only_with_a_generator(scene, data) -> None:
    nominal = scene.read(data)
    np.testing.assert_allclose(
        [nominal["hand_x"], nominal["hand_y"], nominal["hand_z"]], WORKSPACE.start, atol=1e-6
    )
    scene.reset(data, np.random.default_rng(1))
    first = scene.read(data)
    scene.reset(data, np.random.default_rng(1))
    assert scene.read(data) == first
    scene.reset(data, np.random.default_rng(2))
    assert scene.read(data) != first


# The command path
