"""Play, stiction and late servos: laws, and that the batch does what a plain loop would."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.drive import DEFAULT_STRIBECK_VELOCITY, Drive, Play, Stribeck, delay_steps
from skewmi.sim.tasks.open_press_close.definition import ARM
from skewmi.sim.variation import VariationSample

ANGLES = st.floats(-3.0, 3.0)
PATHS = arrays(np.float64, (2, 9, 3), elements=ANGLES)
WIDTHS = arrays(np.float64, (2, 3), elements=st.floats(0.0, 0.5))


def sample(**values: object) -> VariationSample:
    return VariationSample(1, {f"servo.{k}": np.atleast_1d(v) for k, v in values.items()})


@given(PATHS, WIDTHS)
def test_a_joint_stays_within_its_play_and_moves_only_with_the_flank(
    targets: np.ndarray, width: np.ndarray
) -> None:
    followed = Play(width, targets[:, 0]).follow(targets)
    half = 0.5 * width[:, None]
    assert np.all(np.abs(followed - targets) <= half + 1e-12)
    moved = np.diff(followed, axis=1, prepend=targets[:, :1]) != 0
    at_flank = np.isclose(np.abs(followed - targets), half, rtol=0, atol=1e-12)
    assert np.all(at_flank[moved])


@given(PATHS, WIDTHS)
def test_only_what_is_kept_has_happened(targets: np.ndarray, width: np.ndarray) -> None:
    whole = Play(width, targets[:, 0]).follow(targets)
    play = Play(width, targets[:, 0])
    play.follow(targets[:, ::-1])  # Asked for, but never kept.
    parts = []
    for part in (targets[:, :4], targets[:, 4:]):
        play.follow(part - 1.0)
        parts.append(play.follow(part))
        play.keep()
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)


def test_a_reversal_shows_the_whole_gap() -> None:
    up = np.linspace(0.0, 0.1, 101)
    target = np.concatenate([up, up[::-1]])
    followed = Play(np.array([[0.02]]), np.zeros((1, 1))).follow(target[None, :, None])[0, :, 0]
    np.testing.assert_allclose(followed[20:101], up[20:] - 0.01, atol=1e-12)
    held = np.flatnonzero(followed == followed[100])
    assert target[100] - target[held[-1]] == pytest.approx(0.02, abs=1.1e-3)
    np.testing.assert_allclose(followed[125:], target[125:] + 0.01, atol=1e-12)


@pytest.mark.parametrize(
    ("ms", "whole", "fraction"),
    [(0, 0, 0), (20, 5, 0), (21, 5, 0.25), (3.9, 0, 0.975), (100, 25, 0)],
)
def test_a_delay_is_whole_steps_and_a_fraction(ms: float, whole: int, fraction: float) -> None:
    steps, part = delay_steps(sample(delay_ms=float(ms)))
    assert steps[0] == whole
    assert part[0] == pytest.approx(fraction, abs=1e-12)
    assert fraction or part[0] == 0.0


@given(st.floats(0.0, 100.0))
def test_one_robot_and_the_batch_delay_alike(ms: float) -> None:
    ramp = np.arange(60.0)[:, None]
    drive = Drive(sample(delay_ms=ms), ramp[0], np.array([], dtype=np.int64))
    arrived = [drive.arriving(row)[0] for row in ramp]
    np.testing.assert_allclose(arrived, np.maximum(ramp[:, 0] - ms / 4.0, 0.0), atol=0.25)
    assert arrived[40] == pytest.approx(40.0 - ms / 4.0, abs=1e-9)


@given(st.floats(1.0, 5.0), st.floats(0.001, 1.0), st.floats(0.0, 10.0))
def test_friction_falls_from_rest_to_motion(scale: float, v_s: float, speed: float) -> None:
    law = Stribeck(
        sample(stiction_scale=np.full((1, 7), scale), stribeck_velocity=np.full((1, 7), v_s)),
        np.full((1, 7), 2.0),
    )
    at = [law.friction(np.full((1, 7), v))[0, 0] for v in (0.0, speed, -speed, 2 * speed, 50 * v_s)]
    assert at[0] == pytest.approx(2.0 * scale)
    assert at[1] == at[2]
    assert at[0] >= at[1] >= at[3]
    assert at[4] == pytest.approx(2.0)


def test_the_batch_is_a_plain_loop_with_the_friction_of_each_speed() -> None:
    variation = "{servo: {stiction_scale: [1.5, 3], frictionloss: [0.2, 0.5], backlash: 0.002}}"
    env = ArmBatch(ARM, 2, num_threads=1, variation=variation)
    for _ in range(2):  # The second episode begins with nothing of the first.
        env.reset()
        drawn = env.variation_sample
        assert drawn is not None
        for index in range(2):
            np.testing.assert_array_equal(
                env.batch.get_model(index).dof_frictionloss[:7],
                drawn.values["servo.frictionloss"][index],
            )
        models = [env.batch.get_model(index) for index in range(2)]
        data = [mujoco.MjData(model) for model in models]
        for index, single in enumerate(data):
            single.qpos[:] = env.batch.bind("qpos")[index]
            single.ctrl[:] = env.batch.bind("ctrl")[index]
        for _ in range(4):
            env.step(np.array([[0.3, 0.5, 0.3], [0.1, -0.4, 0.2]]))
            for index, single in enumerate(data):
                friction = drawn.values["servo.frictionloss"][index]
                more = drawn.values["servo.stiction_scale"][index] - 1.0
                for targets in env.servo_targets[index]:
                    slow = np.exp(-np.square(single.qvel[:7] / DEFAULT_STRIBECK_VELOCITY))
                    models[index].dof_frictionloss[:7] = friction * (1.0 + more * slow)
                    single.ctrl[:] = targets
                    mujoco.mj_step(models[index], single)
    for index, single in enumerate(data):
        np.testing.assert_array_equal(env.batch.bind("qpos")[index], single.qpos)


def test_the_batchs_joints_are_within_half_the_play_of_their_targets() -> None:
    width = np.array([0.001, 0.002, 0.0, 0.003, 0.004, 0.002, 0.001])
    env = ArmBatch(ARM, 2, num_threads=1, variation=f"{{servo: {{backlash: {width.tolist()}}}}}")
    gaps = []
    env.reset(1)
    for action in ([0.0, 0.3, 0.3], [0.0, -0.3, -0.3], [0.0, 0.2, 0.2]):
        env.step(np.array([action] * 2))
        gaps.append(env.servo_targets - env._physics.command.targets)
    gap = np.concatenate(gaps, axis=1)
    assert np.abs(gap[..., :7]).max(axis=(0, 1)) == pytest.approx(width / 2, abs=1e-12)
    np.testing.assert_array_equal(gap[..., 7:], 0.0)


def test_an_offset_is_in_what_is_measured_and_not_in_the_physics() -> None:
    offset = np.array([0.01, -0.02, 0.0, 0.005, 0.0, 0.01, 0.02])
    env = ArmBatch(
        ARM, 2, num_threads=1, variation=f"{{sensors: {{joint_offset: {offset.tolist()}}}}}"
    )
    exact = ArmBatch(ARM, 2, num_threads=1)
    seen = env.reset(3)
    exact.reset(3)
    np.testing.assert_array_equal(env.batch.bind("qpos"), exact.batch.bind("qpos"))
    measured = env.batch.bind("qpos")[:, env.scene.arm_qpos] + offset
    np.testing.assert_allclose(seen[:, :3], env.scene.arm_pose(measured)[0], atol=1e-12)
    assert np.linalg.norm(seen[:, :3] - exact.command()[0], axis=1).min() > 1e-3


def test_what_the_batch_cannot_have_changes_nothing_in_it() -> None:
    variation = (
        "{link: {loss: 0.5, delay_ms: 100}, sensors: {velocity_noise: 0.1, effort_noise: 1}}"
    )
    env, exact = (ArmBatch(ARM, 2, num_threads=1, variation=v) for v in (variation, None))
    for each in (env, exact):
        each.reset(3)
    action = np.array([[0.1, 0.2, -0.3]] * 2)
    for _ in range(3):
        np.testing.assert_array_equal(env.step(action).observation, exact.step(action).observation)
