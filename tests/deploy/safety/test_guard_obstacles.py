"""The guard keeps clear of boxes: as the other model sees them, and however it gets there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.calibration.clear_space import ClearSpace
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.safety.guard import CLEARANCE, Guard
from skewmi.deploy.safety.obstacles import scene_obstacles
from skewmi.deploy.wire.scene_geometry import ScenePart
from skewmi.errors import LimitViolationError
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.frames import base_to_world, rotation_from_quaternion
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.obstacle import Obstacle

LAB = limits.profile("lab")
START = np.array(yumi.TABLE_CONFIGURATION)
FLANGE = ArmKinematics("right").forward(START)[0]


def test_obstacles_are_kept_clear_of_as_the_other_model_sees_them() -> None:
    """Random boxes, turned: MuJoCo's judgement and the guard's, where they are not a hair apart."""
    rng = np.random.default_rng(7)
    bare = ClearSpace((), CLEARANCE + 0.001)
    judged = {True: 0, False: 0}
    for _ in range(8):
        x, y, z = (FLANGE + rng.uniform(-0.25, 0.25, 3)).tolist()
        half_x, half_y, half_z = rng.uniform(0.01, 0.08, 3).tolist()
        yaw = float(rng.uniform(-np.pi, np.pi))
        box = Obstacle((x, y, z), (half_x, half_y, half_z), yaw, "a box")
        guard = Guard(LAB, obstacles=(box,))
        near, far = (ClearSpace((box,), CLEARANCE + off) for off in (-0.001, 0.001))
        for q in START + rng.uniform(-0.4, 0.4, (12, 7)):
            if bare.first_touch(q[None]) is not None:
                continue  # the robot touches itself
            clear = far.first_touch(q[None]) is None
            if not clear and near.first_touch(q[None]) is None:
                continue
            judged[clear] += 1
            if clear:
                guard.clearance.check(q[None])
            else:
                with pytest.raises(LimitViolationError, match="a box"):
                    guard.clearance.check(q[None])
    assert min(judged.values()) > 10, judged


def test_an_obstacle_in_the_way_is_seen_whatever_was_measured_before() -> None:
    """Distances are bounded from where they were measured last: that must hide nothing."""
    x, y, _ = FLANGE.tolist()
    guard, free = (
        Guard(LAB, obstacles=(Obstacle((x, y - 0.16, 0.2), (0.02, 0.02, 0.2)),)),
        Guard(LAB),
    )
    goal = START + np.array([-0.6, 0, 0, 0, 0, 0, 0])
    way = StartMotion(START, goal, LAB).trajectory
    free.check(way.q, way.v, way.a)
    met = []
    for first in range(0, len(way), 10):
        part = way.part(slice(first, first + 11))
        try:
            guard.check(part.q, part.v, part.a)
        except LimitViolationError as error:
            met.append(str(error))
    assert met
    assert all("to obstacle 0" in words for words in met)


SIZES = st.tuples(*[st.floats(0.001, 0.2)] * 3)
PLACES = st.tuples(*[st.floats(-0.5, 0.5)] * 3)
TURNS = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
PARTS = st.builds(
    lambda joint, size, place, turn: ScenePart(
        "part", joint, size, place, tuple(np.array(turn) / np.linalg.norm(turn)), (0, 0, 0, 1)
    ),
    st.sampled_from(["", "lid", "button"]),
    SIZES,
    PLACES,
    TURNS,
)


@settings(deadline=None, max_examples=100)
@given(parts=st.lists(PARTS, max_size=8), margin=st.sampled_from([0.0, 0.01]))
def test_every_shape_above_the_table_is_in_a_box_and_no_box_in_another(
    parts: list[ScenePart], margin: float
) -> None:
    boxes = scene_obstacles(parts, margin)
    assert len(boxes) <= len({part.joint for part in parts})
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    lows = [np.array(box.centre) - box.half_size for box in boxes]
    highs = [np.array(box.centre) + box.half_size for box in boxes]
    for part in parts:
        rotation = rotation_from_quaternion(part.quaternion_wxyz)
        world = corners * part.half_size @ rotation.T + part.position
        if world[:, 2].max() <= 0.002:
            continue
        inside = [
            (base_to_world(low) - 1e-9 <= world).all()
            and (world <= base_to_world(high) + 1e-9).all()
            for low, high in zip(lows, highs, strict=True)
        ]
        assert any(inside)
    for one, (low, high) in enumerate(zip(lows, highs, strict=True)):
        for other, (outer_low, outer_high) in enumerate(zip(lows, highs, strict=True)):
            if one != other:
                assert not ((outer_low < low).all() and (high < outer_high).all())
