"""A variation changes the simulation of OpenPressClose as its file says, and nothing else."""

from __future__ import annotations

import json
import os

import mujoco
import numpy as np
import pytest
from scripted_open_press_close import ScriptedOpenPressClose

from skewmi.errors import ConfigurationError
from skewmi.sim import tasks
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.tasks.open_press_close.definition import ARM
from skewmi.sim.variation import NOMINAL
from skewmi.success import first_success_step

VARIATIONS = ARM.variations
KEYS = {key.name: key for key in VARIATIONS.keys}
N = 3


def make(variation: object = None, *, seed: int = 0, threads: int = 1, n: int = N) -> ArmBatch:
    return ArmBatch(ARM, n, num_threads=threads, seed=seed, variation=variation)


def play(env: ArmBatch, steps: int, seed: int | None = None) -> np.ndarray:
    """Observations under actions that touch the lid. Shape (steps + 1, n, observation_dim)."""
    rng = np.random.default_rng(5)
    seen = [env.reset(seed)]
    for step in range(steps):
        drift = np.array([0.0, 0.2, -0.7 if step < 12 else 0.4])
        action = rng.uniform(-0.5, 0.5, (env.num_envs, 3)) + drift
        seen.append(env.step(action).observation)
    return np.array(seen)


def nominal_model() -> mujoco.MjModel:
    return make(n=1).scene.physics_model


def test_the_nominal_variation_changes_no_bit_and_expands_no_field() -> None:
    for variation in (NOMINAL, "{}"):
        env = make(variation)
        np.testing.assert_array_equal(play(env, 15), play(make(), 15))
        assert env.variation_sample is None
        assert list(env.random_state()) == ["generator"]
        assert env.batch.expanded("body_pos") is None


def test_values_that_equal_the_nominal_ones_change_no_bit() -> None:
    lid_mass = float(nominal_model().body("lid").mass[0])
    variation = VARIATIONS.parse(
        "servo: {kp_scale: 1, kd_scale: 1, frictionloss_scale: 1, armature_scale: 1, delay_ms: 0,\n"
        "  stiction_scale: 1, stribeck_velocity: 0.01, backlash: 0}\n"
        "arm: {mass_scale: 1}\n"
        "lid: {frictionloss: 0.12, damping: 0.02, mass: " + repr(lid_mass) + "}\n"
        "button: {frictionloss: 3.0, travel: 0.03}\n"
        "box_pose: {x: 0, y: 0, yaw_deg: 0}\n"
        "sensors: {joint_noise: 0, lid_bias_deg: 0, lid_noise_deg: 0, button_noise: 0,\n"
        "  joint_offset: 0, velocity_noise: 0, effort_noise: 0}\n"
        "gripper: {opening_error: 0}\n"
        "link: {loss: 0, delay_ms: 0, jitter_ms: 0}\n"
    )
    np.testing.assert_array_equal(play(make(variation), 20), play(make(), 20))


def test_starts_are_those_of_the_nominal_variation() -> None:
    def commanded(variation: str | None) -> np.ndarray:
        env = make(variation, seed=4)
        env.reset()
        return env.command()[0]

    np.testing.assert_array_equal(commanded("randomised"), commanded(None))


def test_the_seed_decides_everything_and_threads_nothing() -> None:
    threads = min(4, os.cpu_count() or 1) + 1
    first = play(make("randomised", threads=1), 20, seed=3)
    np.testing.assert_array_equal(play(make("randomised", threads=threads), 20, seed=3), first)
    assert not np.array_equal(play(make("randomised"), 20, seed=4), first)
    content = json.loads(VARIATIONS.load("randomised").to_json())
    assert not np.array_equal(play(make(json.dumps(content | {"seed": 1})), 20, seed=3), first)


def test_each_reset_draws_anew_and_within_the_ranges() -> None:
    env = make("randomised")
    drawn = []
    for _ in range(4):
        env.reset()
        drawn.append(env.variation_sample.values["lid.frictionloss"])
        applied = env.batch.expanded("dof_frictionloss")
        dof = int(env.scene.physics_model.joint("lid_hinge").dofadr[0])
        np.testing.assert_array_equal(applied[:, dof], drawn[-1])
    assert len(np.unique(drawn)) == 4 * N
    assert np.all((np.array(drawn) >= 0.10) & (np.array(drawn) <= 0.16))


def test_a_saved_random_state_continues_the_same_episodes() -> None:
    env = make("randomised")
    play(env, 5, seed=2)
    state = json.loads(json.dumps(env.random_state()))
    expected = play(env, 8)
    other = make("randomised", seed=9)
    other.set_random_state(state)
    np.testing.assert_array_equal(play(other, 8), expected)
    with pytest.raises(ConfigurationError, match="not a random state"):
        other.set_random_state(make().random_state())


# What each key means, restated from the documentation: field, its entries, expected value.
_ARM = np.arange(7)
_LID, _BUTTON = 9, 10


def _fields(key: str, value: float, m: mujoco.MjModel) -> list[tuple[str, object, object]]:
    box, lid = m.body("box").id, m.body("lid").id
    arm = [b for b in range(m.nbody) if _hangs_on(m, b, m.body("yumi_link_1_r").id)]
    half = np.radians(value) / 2
    return {
        "servo.kp_scale": [
            ("actuator_gainprm", (_ARM, 0), value * m.actuator_gainprm[:7, 0]),
            ("actuator_biasprm", (_ARM, 1), value * m.actuator_biasprm[:7, 1]),
        ],
        "servo.kd_scale": [("actuator_biasprm", (_ARM, 2), value * m.actuator_biasprm[:7, 2])],
        "servo.frictionloss_scale": [("dof_frictionloss", _ARM, value * m.dof_frictionloss[:7])],
        "servo.frictionloss": [("dof_frictionloss", _ARM, value), *_DRY],
        "servo.stiction_scale": _DRY,
        "arm.mass_scale": [
            ("body_mass", arm, value * m.body_mass[arm]),
            ("body_inertia", arm, value * m.body_inertia[arm]),
            ("body_gravcomp", arm, m.body_gravcomp[arm] / value),
        ],
        "servo.armature_scale": [("dof_armature", _ARM, value * m.dof_armature[:7])],
        "lid.frictionloss": [("dof_frictionloss", _LID, value)],
        "lid.damping": [("dof_damping", _LID, value)],
        "lid.mass": [
            ("body_mass", lid, value),
            ("body_inertia", lid, m.body_inertia[lid] * value / m.body_mass[lid]),
        ],
        "button.frictionloss": [("dof_frictionloss", _BUTTON, value)],
        "button.travel": [("jnt_range", (m.joint("button_slide").id, 1), value)],
        "contact.friction": [("geom_friction", (slice(None), 0), np.full(m.ngeom, value))],
        "box_pose.x": [("body_pos", box, m.body_pos[box] + [value, 0, 0])],
        "box_pose.y": [("body_pos", box, m.body_pos[box] + [0, value, 0])],
        "box_pose.yaw_deg": [("body_quat", box, [np.cos(half), 0, 0, np.sin(half)])],
    }[key]


def _hangs_on(m: mujoco.MjModel, body: int, root: int) -> bool:
    while body not in (0, root):
        body = int(m.body_parentid[body])
    return body == root


_MODEL_KEYS = [key for key, spec in KEYS.items() if spec.apply is not None]
_WRITTEN = {
    "actuator_gainprm", "actuator_biasprm", "dof_frictionloss", "dof_armature", "dof_damping",
    "body_mass", "body_inertia", "body_gravcomp", "body_pos", "body_quat", "jnt_range",
    "geom_friction", "dof_solref", "dof_solimp",
}  # fmt: skip
_DRY = [
    ("dof_solref", _ARM, [0.008, 1.0]),
    ("dof_solimp", _ARM, [0.9999, 0.9999, 0.001, 0.5, 2.0]),
]
"""Friction that holds a joint at rest instead of letting it creep."""


@pytest.mark.parametrize("key", _MODEL_KEYS)
def test_a_key_changes_its_model_fields_and_no_others(key: str) -> None:
    section, _, name = key.partition(".")
    value = {"button.travel": 0.02, "lid.mass": 0.2}.get(key, 0.6 * KEYS[key].high)
    env = make(json.dumps({section: {name: value}}), n=1)
    assert env.scene.scene_qpos.tolist() == [_LID, _BUTTON]
    env.reset()
    model, base = env.batch.get_model(0), nominal_model()
    expected = {field: np.array(getattr(base, field)) for field in _WRITTEN}
    for field, index, values in _fields(key, value, base):
        assert not np.allclose(expected[field][index], values)
        expected[field][index] = values
    for field in _WRITTEN:
        np.testing.assert_allclose(
            getattr(model, field), expected[field], rtol=1e-13, err_msg=field
        )
    # What follows from these fields has followed.
    derived = {f: np.array(getattr(model, f)) for f in ("dof_invweight0", "body_subtreemass")}
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for field, values in derived.items():
        np.testing.assert_allclose(getattr(model, field), values, rtol=1e-10)


def test_a_moved_box_is_hit_where_it_is() -> None:
    variation = "{box_pose: {x: 0.002, y: -0.003, yaw_deg: 4}, lid: {mass: 0.15}}"
    env = make(variation, n=1)
    env.reset()
    model = env.batch.get_model(0)
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = env.batch.bind("qpos")[0], env.batch.bind("ctrl")[0]
    contacts = 0
    for _ in range(15):
        env.step(np.array([[0.0, 0.2, -1.0]]))
        for targets in env.servo_targets[0]:
            data.ctrl[:] = targets
            mujoco.mj_step(model, data)
        contacts += data.ncon
    assert contacts > 5
    np.testing.assert_array_equal(env.batch.bind("qpos")[0], data.qpos)


def test_a_delay_moves_the_targets_by_whole_substeps() -> None:
    late, prompt = (make(f"{{servo: {{delay_ms: {ms}}}}}", n=2) for ms in (20, 0))
    rows = {id(env): [] for env in (late, prompt)}
    for env in (late, prompt):
        env.reset(1)
        start = env.batch.bind("ctrl").copy()
        # Away from everything and slow: the bound on the following error must not act.
        for action in ([0.0, 0.3, 0.3], [0.1, -0.2, 0.2], [0.0, 0.1, 0.0]):
            env.step(np.array([action] * 2))
            rows[id(env)].append(env.servo_targets.copy())
    delayed = np.concatenate(rows[id(late)], axis=1)
    direct = np.concatenate(rows[id(prompt)], axis=1)
    np.testing.assert_array_equal(delayed[:, 5:], direct[:, :-5])
    np.testing.assert_array_equal(delayed[:, :5], np.repeat(start[:, None], 5, axis=1))


def test_a_part_of_a_substep_is_shared_between_two_targets() -> None:
    def targets(ms: float) -> np.ndarray:
        env = make(f"{{servo: {{delay_ms: {ms}}}}}", n=2)
        env.reset(1)
        rows = []
        for action in ([0.0, 0.3, 0.3], [0.1, -0.2, 0.2], [0.0, 0.1, 0.0]):
            env.step(np.array([action] * 2))
            rows.append(env.servo_targets.copy())
        return np.concatenate(rows, axis=1)

    expected = 0.75 * targets(20) + 0.25 * targets(24)
    np.testing.assert_allclose(targets(21), expected, rtol=0, atol=1e-12)
    assert np.abs(targets(21) - targets(20)).max() > 1e-4
    # The bounds of what is allowed, and just below.
    assert np.isfinite(targets(100)).all()
    np.testing.assert_allclose(targets(99.999), targets(100), atol=1e-5)


def test_a_late_servo_lags_behind() -> None:
    def after_one_step(ms: float) -> float:
        env = make(f"{{servo: {{delay_ms: {ms}}}}}", n=1)
        y = env.reset(1)[0, 1]
        return float(env.step(np.array([[0.0, 1.0, 0.0]])).observation[0, 1] - y)

    assert 0.0 < after_one_step(40) < 0.75 * after_one_step(0)


def test_sensor_errors_are_seen_but_are_not_there() -> None:
    variation = (
        "{sensors: {joint_noise: 0.001, lid_bias_deg: 5, lid_noise_deg: 0.5, button_noise: 0.001}}"
    )
    env = make(variation, n=200)
    truth = make(n=200).reset(6)
    error = env.reset(6) - truth
    assert np.degrees(error[:, 4].mean()) == pytest.approx(5.0, abs=0.15)
    assert np.degrees(error[:, 4].std()) == pytest.approx(0.5, rel=0.2)
    assert error[:, 5].std() == pytest.approx(0.001, rel=0.2)
    hand = np.linalg.norm(error[:, :3], axis=1)
    assert 3e-4 < np.median(hand) < 2e-3
    # Sensed 5 deg open, which would not count as shut; true lid at 0 counts.
    qpos = env.batch.bind("qpos")
    qpos[:, env.scene.scene_qpos[1]] = 0.02
    result = env.step(np.zeros((200, 3)))
    assert np.all(result.success)
    assert np.all(result.observation[:, 4] > 0.035)


def test_the_fingers_are_off_by_their_error() -> None:
    env, exact = make("{gripper: {opening_error: -0.002}}", n=1), make(n=1)
    opening = [e.reset(0)[0, 3] for e in (env, exact)]
    opening += [e.step(np.zeros((1, 3))).observation[0, 3] for e in (env, exact)]
    assert opening[0] - opening[1] == pytest.approx(-0.002, abs=1e-9)
    assert opening[2] - opening[3] == pytest.approx(-0.002, abs=1e-4)


def test_a_task_without_a_robot_has_no_variation() -> None:
    assert tasks.make_batch("open_press_close", 1, variation="randomised").num_envs == 1
    with pytest.raises(ConfigurationError, match="variation"):
        tasks.make_batch("point_maze", 1, variation="randomised")


def test_the_scripted_motion_survives_the_documented_randomisation() -> None:
    env = make("randomised", seed=0, n=12)
    scripts = [ScriptedOpenPressClose(env.layout) for _ in range(12)]
    observation, inside, truncated = env.reset(), [], False
    while not truncated:
        actions = [script.act(x) for script, x in zip(scripts, observation, strict=True)]
        result = env.step(np.array(actions))
        observation, truncated = result.observation, result.truncated
        inside.append(result.success)
    success = first_success_step(env.layout, np.array(inside)) > 0
    # It knows nothing of late servos, which cost it more time than it has in some episodes.
    assert success.mean() >= 0.4, env.variation_sample
