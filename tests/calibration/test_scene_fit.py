"""Touches tell where a box stands: whatever pose, and by another computation of what touches."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from skewmi.calibration.finger_contact import touching_points
from skewmi.calibration.scene_faces import FACES, SHIFT, TURN, Face, Part, faces_of, top_of
from skewmi.calibration.scene_fit import TOUCH_SIGMA, Touch, fit_scene
from skewmi.errors import ConfigurationError
from skewmi.robot_models import mjcf, yumi
from skewmi.robot_models.frames import HAND_DOWN, rotation_about
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import Array

BOX = Part("box", (0.28, -0.15, 0.0), (0.50, 0.003, 0.083))
FACE = faces_of([BOX])
ARM = ArmKinematics("right")
SPOTS = (("near", -0.035), ("near", 0.03), ("far", 0.0), ("left", -0.06), ("left", 0.055))


class Hand:
    """The robot's own hand beside the displaced box, in MuJoCo: what is nearest to what."""

    def __init__(self, pose: Array, opening: float) -> None:
        spec = mjcf.build_robot(left_arm="absent", collision=True, visual=False)
        low, high = np.array(BOX.low), np.array(BOX.high)
        x, y, yaw = pose
        centre = (low + high) / 2.0 + (x, y, 0.0)
        spec.worldbody.add_geom(
            name="box",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=centre,
            size=(high - low) / 2.0,
            quat=(np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)),
        )
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._opening = opening
        self._qpos = [self._model.joint(name).qposadr[0] for name in yumi.joint_names("right")]
        for name in yumi.finger_names("right"):
            self._data.qpos[self._model.joint(name).qposadr[0]] = opening
        self._box = self._model.geom("box").id
        self._fingers = [
            geom
            for geom in range(self._model.ngeom)
            if "finger" in self._model.body(self._model.geom_bodyid[geom]).name
            and self._model.body(self._model.geom_bodyid[geom]).name.startswith("gripper_r")
        ]

    def distance(self, q: Array) -> float:
        self._data.qpos[self._qpos] = q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return min(
            mujoco.mj_geomDistance(self._model, self._data, geom, self._box, 1.0, np.zeros(6))
            for geom in self._fingers
        )


def touch(face: Face, offset: float, hand: Hand, opening: float, rng: np.random.Generator) -> Array:
    """Where the joints are when a hand, not quite upright, has come to a face."""
    rotation = HAND_DOWN
    turn = 0.0 if face.axis == 0 else np.pi / 2.0
    tilt = rng.uniform(-0.01, 0.01, 3)
    for axis in range(3):
        rotation = rotation_about(axis, tilt[axis]) @ rotation
    rotation = rotation_about(2, turn) @ rotation
    far, near = 0.04, -0.03
    q = np.array(yumi.TABLE_CONFIGURATION)
    for _ in range(40):
        away = (far + near) / 2.0
        place = face.place(offset, 0.20) + away * face.normal
        result = ARM.inverse(place, rotation, q, max_iterations=60)
        assert result.position_error < 1e-5
        q = result.q
        far, near = (away, near) if hand.distance(q) > 0.0 else (far, away)
    return q


@pytest.mark.parametrize("seed", range(3))
def test_it_finds_the_box_that_the_robots_own_fingers_touch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(-SHIFT, SHIFT, 2), rng.uniform(-TURN, TURN)])
    opening = float(rng.uniform(0.005, 0.012))
    hand = Hand(pose, opening)
    touches = []
    for name, offset in SPOTS:
        q = touch(FACE[name], offset, hand, opening, rng)
        points = touching_points(*ARM.forward(q), opening, BOX.high[2])
        touches.append(Touch(FACE[name], points))
    fit = fit_scene(touches)
    # MuJoCo's distances are exact to a micrometre or two, over 0.1 m.
    np.testing.assert_allclose(fit.pose[:2], pose[:2], atol=5e-6)
    assert fit.pose[2] == pytest.approx(pose[2], abs=5e-5)
    assert np.abs(fit.residuals).max() < 5e-6


def drawn(pose: Array, rng: np.random.Generator, count: int) -> list[Touch]:
    """Exact touches of points, spread over all faces of a displaced box."""
    touches = []
    for number in range(count):
        face = FACE[list(FACES)[number % 4]]
        point = face.place(float(rng.uniform(-0.9, 0.9)) * face.reach, 0.05)
        middle = np.array([*face.middle, 0.0])
        moved = rotation_about(2, pose[2]) @ (point - middle) + middle + (pose[0], pose[1], 0.0)
        touches.append(Touch(face, moved[None], rng.normal(0.0, 1e-4, 2)))
    return touches


def test_intervals_hold_what_touches_have_in_common_too() -> None:
    rng = np.random.default_rng(3)
    squares, held = [], 0
    for _ in range(150):
        pose = np.array([*rng.uniform(-SHIFT, SHIFT, 2), rng.uniform(-TURN, TURN)])
        touches = drawn(pose, rng, 7)
        common = rng.normal(size=2)
        noisy = []
        for one in touches:
            normal = rotation_about(2, pose[2]) @ one.face.normal
            off = one.common @ common + rng.normal(0.0, TOUCH_SIGMA)
            noisy.append(Touch(one.face, one.points + off * normal, one.common))
        fit = fit_scene(noisy)
        error = fit.pose - pose
        squares.append(error @ np.linalg.solve(fit.covariance, error))
        held += int((np.abs(error) <= 1.96 * np.sqrt(np.diag(fit.covariance))).sum())
    # Chi square with three degrees of freedom, a little less: intervals only ever grow.
    assert 2.0 < np.mean(squares) < 3.3
    assert 0.92 < held / 450 < 0.99


def test_a_touch_that_does_not_fit_shows_and_widens_the_intervals() -> None:
    rng = np.random.default_rng(4)
    touches = drawn(np.array([0.002, -0.001, 0.03]), rng, 8)
    good = fit_scene(touches)
    assert good.chi_squared < 1e-6
    bad = Touch(touches[0].face, touches[0].points + 0.002, touches[0].common)
    found = fit_scene([bad, *touches[1:]])
    assert found.chi_squared > 10.0
    assert np.argmax(np.abs(found.residuals)) == 0
    assert (np.diag(found.covariance) > 9.0 * np.diag(good.covariance)).all()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["near", "left"], "x, y and yaw need three"),
        (["near", "far", "near", "far"], "do not tell x, y and yaw"),
        (["near"] * 5, "do not tell x, y and yaw"),
    ],
)
def test_touches_that_do_not_tell_are_refused(names: list[str], message: str) -> None:
    rng = np.random.default_rng(5)
    touches = [
        Touch(FACE[name], FACE[name].place(float(rng.uniform(-0.05, 0.05)), 0.05)[None])
        for name in names
    ]
    with pytest.raises(ConfigurationError, match=message):
        fit_scene(touches)


def test_a_box_beyond_belief_is_refused() -> None:
    rng = np.random.default_rng(6)
    with pytest.raises(ConfigurationError, match="is it the right face"):
        fit_scene(drawn(np.array([0.03, 0.0, 0.0]), rng, 6))


def test_a_face_ends_where_its_lowest_part_does() -> None:
    low = Part("low", (0.0, 0.0, 0.0), (0.1, 0.1, 0.05))
    tall = Part("tall", (0.1, 0.0, 0.0), (0.2, 0.1, 0.08))
    back = Part("back", (0.2, 0.02, 0.0), (0.3, 0.1, 0.08))
    parts = [low, tall, back]
    right = faces_of(parts)["right"]
    assert top_of(right, parts, -0.1, 0.01) == 0.05
    assert top_of(right, parts, -0.05, 0.01) == 0.05
    assert top_of(right, parts, 0.0, 0.01) == 0.08
    with pytest.raises(ConfigurationError, match="gap 100 mm"):
        top_of(right, parts, 0.1, 0.01)
