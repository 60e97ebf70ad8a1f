"""The press task's box: reached everywhere from the start, with margins and without contact."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from skewmi.robot_models import frames, mjcf, start_search, yumi
from skewmi.robot_models.kinematics import ArmKinematics

START = np.array(yumi.TABLE_CONFIGURATION)
STEP = 0.015
"""Largest hand step of the task, m."""


def sweep() -> tuple[np.ndarray, np.ndarray]:
    """Targets through the whole box in steps the task can make, from the start, each column up
    and down, row after row. Shape (n, 3), base frame; and the start position."""
    low, high = np.array(start_search.TABLE_ROOM.low), np.array(start_search.TABLE_ROOM.high)
    start = np.array(start_search.TABLE_ROOM.start)
    counts = np.ceil((high - low) / STEP).astype(int) + 1
    axes = [np.linspace(low[i], high[i], counts[i]) for i in range(3)]
    waypoints = []
    for i, x in enumerate(axes[0]):
        for j, y in enumerate(axes[1][:: 1 if i % 2 == 0 else -1]):
            waypoints += [(x, y, z) for z in axes[2][:: 1 if (i + j) % 2 == 0 else -1]]
    way_in = np.linspace(start, waypoints[0], 12)[1:]
    return frames.world_to_base(np.concatenate([way_in, waypoints])), frames.world_to_base(start)


@pytest.fixture(scope="module")
def tour():
    """Configurations along the sweep, each solved from the one before, as the task does."""
    arm = ArmKinematics("right")
    targets, _ = sweep()
    q, configurations, errors = START, [], []
    for target in targets:
        result = arm.inverse(target, frames.HAND_DOWN, q, posture=START, max_iterations=4)
        q = result.q
        configurations.append(q)
        errors.append((result.position_error, result.rotation_error))
    return np.array(configurations), np.array(errors)


def test_the_start_is_the_tasks_start():
    position, rotation = ArmKinematics("right").forward(START)
    np.testing.assert_allclose(
        frames.base_to_world(position), start_search.TABLE_ROOM.start, atol=1e-9
    )
    np.testing.assert_allclose(rotation, frames.HAND_DOWN, atol=1e-9)


def test_every_point_is_met_within_a_tenth_of_a_millimetre(tour):
    _, errors = tour
    assert errors[:, 0].max() < 1e-4
    assert np.degrees(errors[:, 1].max()) < 0.05


def test_the_path_is_continuous_and_keeps_its_margins(tour):
    configurations, _ = tour
    arm = ArmKinematics("right")
    steps = np.abs(np.diff(configurations, axis=0))
    # A hand step of 15 mm in a column, at most 25 mm when the sweep changes column.
    assert steps.max() < 0.25
    assert np.degrees(start_search.joint_margin(configurations).min()) > 15.0
    assert start_search.smallest_singular_value(arm, configurations).min() > 0.3


def test_a_point_has_one_configuration_whatever_the_way_there():
    """The posture undoes the drift along the redundant direction, so the elbow stays put."""
    arm = ArmKinematics("right")
    generator = np.random.default_rng(6)
    low, high = start_search.TABLE_ROOM.low, start_search.TABLE_ROOM.high
    start = frames.world_to_base(start_search.TABLE_ROOM.start)
    walkers, position = np.tile(START, (16, 1)), np.tile(start, (16, 1))
    for _ in range(300):
        position = position + generator.uniform(-STEP, STEP, position.shape)
        position = np.clip(position, frames.world_to_base(low), frames.world_to_base(high))
        walkers = arm.inverse(position, frames.HAND_DOWN, walkers, posture=START).q
    for share in np.linspace(0.0, 1.0, 40):
        target = position + share * (start - position)
        walkers = arm.inverse(target, frames.HAND_DOWN, walkers, posture=START).q
    for _ in range(30):
        walkers = arm.inverse(start, frames.HAND_DOWN, walkers, posture=START).q
    assert np.abs(walkers - START).max() < 0.01


def test_nothing_touches_anywhere_in_the_box(tour):
    configurations, _ = tour
    clearance = start_search.Clearance()
    model, data = clearance.model, clearance.data

    table = body = np.inf
    for q in configurations[::3]:
        data.qpos[:7] = q
        data.qpos[7:9] = 0.014
        mujoco.mj_fwdPosition(model, data)
        touching = [
            tuple(model.body(model.geom_bodyid[geom]).name for geom in contact.geom)
            for contact in data.contact
            if contact.dist < 0.0
        ]
        assert not touching
        to_table, to_body = clearance.distances(q)
        table, body = min(table, to_table), min(body, to_body)
    assert table > 0.15
    assert body > 0.10


def test_the_start_is_what_the_search_prefers():
    """No configuration near it, and no other swivel of the elbow, rates clearly better."""
    ours = start_search.rate(START[None])
    assert ours.reached[0]
    assert ours.score[0] > 0.9
    generator = np.random.default_rng(7)
    near = start_search.solve_start(START + generator.normal(0.0, 0.15, (60, 7)))
    far = start_search.solve_start(
        generator.uniform(yumi.POSITION_LOWER, yumi.POSITION_UPPER, (150, 7))
    )
    others = start_search.rate(np.concatenate([near, far]), steps=8)
    assert len(others.score) > 50
    assert others.score.max() < ours.score[0] + 0.02


@pytest.mark.parametrize("side", yumi.ARMS)
def test_home_touches_nothing(side):
    """ABB's own parking pose is free of contact, so the shapes are not too fat."""
    model = mjcf.build_robot(left_arm="jointed").compile()
    data = mujoco.MjData(model)
    for arm in yumi.ARMS:
        for name, angle in zip(yumi.joint_names(arm), yumi.HOME[arm], strict=True):
            data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    letter = yumi.suffix(side)
    pairs = [
        [model.body(model.geom_bodyid[geom]).name for geom in contact.geom]
        for contact in data.contact
    ]
    assert not [pair for pair in pairs if any(name.endswith(f"_{letter}") for name in pair)]
