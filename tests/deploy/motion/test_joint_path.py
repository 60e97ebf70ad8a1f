"""A motion along a path keeps the path, the limits and the speed, wherever it begins and ends."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.deploy.motion.joint_path import JointPath, chebyshev_places
from skewmi.deploy.motion.path_motion import PathMotion
from skewmi.deploy.safety import limits as checks
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_NS, JointTrajectory

ARM = ArmKinematics("right")
TIP = 0.1357
START = np.array(yumi.TABLE_CONFIGURATION)


def hand_line(rng: np.random.Generator) -> JointPath:
    """A straight line of the flange of some centimetres, its orientation kept."""
    position, rotation = ARM.forward(START)
    way = rng.uniform(-0.05, 0.05, 3)
    length = float(np.linalg.norm(way))
    places = position + chebyshev_places(length, 10)[:, None] / length * way
    q = [START]
    for place in places:
        q.append(ARM.inverse(place, rotation, q[-1], max_iterations=20).q)
    return JointPath.through(np.array(q[1:]), length)


def anywhere(rng: np.random.Generator, hand: bool) -> JointPath:
    return hand_line(rng) if hand else JointPath.line(START, START + rng.uniform(-0.3, 0.3, 7))


@pytest.mark.parametrize("hand", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_it_keeps_path_limits_and_speed(
    hand: bool, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    profile = limits.profile(("lab", "careful")[seed % 2])
    path = anywhere(rng, hand)
    s_start, s_end = rng.uniform(0.0, path.length, 2)
    speed = float(rng.choice((0.0095, 0.1)))
    motion = path.motion(s_start, s_end, profile, speed, TIP)
    monkeypatch.setattr(checks, "MAX_SAMPLES", len(motion))
    usage = checks.ChunkChecker(profile, None, ARM.forward).check(motion.q, motion.v, motion.a)
    assert max(usage.as_dict().values()) <= 1.0
    for row, s in ((0, s_start), (-1, s_end)):
        np.testing.assert_allclose(motion.q[row], path.at(s), atol=1e-12)
        assert not np.any(motion.v[row])
        assert not np.any(motion.a[row])
    position, rotation = ARM.forward(motion.q)
    for point in (position, position + TIP * rotation[..., 2]):
        assert np.linalg.norm(np.diff(point, axis=0), axis=1).max() / 0.004 <= 1.002 * speed
    for q in motion.q[:: max(1, len(motion) // 20)]:
        np.testing.assert_allclose(path.at(path.nearest(q)), q, atol=1e-9)
    PathMotion(motion, profile)


@pytest.mark.parametrize("seed", range(4))
def test_whoever_stops_on_the_way_goes_on_from_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    profile = limits.profile("lab")
    path = anywhere(rng, bool(seed % 2))
    whole = PathMotion(path.motion(0.0, path.length, profile, 0.1, TIP), profile)
    stop = whole.chunk(int(rng.integers(0, whole.cycles)))
    rests = stop.q[-1]
    s = path.nearest(rests)
    motion = path.motion(s, path.length, profile, 0.1, TIP, rests)
    np.testing.assert_array_equal(motion.q[0], rests)
    np.testing.assert_allclose(motion.q[-1], path.at(path.length), atol=1e-12)
    # It begins with no more of a step than the checker's third differences may have.
    before = JointTrajectory.resting(rests, 4)
    q = np.concatenate((before.q, motion.q))
    jerk = np.diff(q, 3, axis=0) / (GRID_NS / 1e9) ** 3
    assert (np.abs(jerk) <= profile.jerk).all()


@pytest.mark.parametrize("way", [0.1, 1e-3, 1e-6, 1e-9, 0.0])
@pytest.mark.parametrize("seed", range(4))
def test_what_the_arm_is_off_fades_within_limits_and_speed(
    seed: int, way: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However short the way is: what is off is up to a milliradian of each joint."""
    rng = np.random.default_rng(seed)
    profile = limits.profile(("lab", "careful")[seed % 2])
    path = anywhere(rng, bool(seed // 2))
    s_start = rng.uniform(0.3, 0.7) * path.length
    s_end = s_start + rng.choice((-1.0, 1.0)) * way * path.length
    rests = path.at(s_start) + rng.uniform(-1e-3, 1e-3, 7)
    speed = float(rng.choice((0.002, 0.1)))
    motion = path.motion(s_start, s_end, profile, speed, TIP, rests)
    np.testing.assert_array_equal(motion.q[0], rests)
    np.testing.assert_allclose(motion.q[-1], path.at(s_end), atol=1e-12)
    monkeypatch.setattr(checks, "MAX_SAMPLES", len(motion))
    usage = checks.ChunkChecker(profile, None, ARM.forward).check(motion.q, motion.v, motion.a)
    assert max(usage.as_dict().values()) <= 1.0
    # The derivatives are those of the positions.
    h = GRID_NS / 1e9
    over = (h / 2.0) * (motion.v[1:] + motion.v[:-1]) + h**2 / 12.0 * -np.diff(motion.a, axis=0)
    np.testing.assert_allclose(np.diff(motion.q, axis=0), over, atol=profile.jerk.max() * h**3 / 12)
    position, rotation = ARM.forward(motion.q)
    for point in (position, position + TIP * rotation[..., 2]):
        assert np.linalg.norm(np.diff(point, axis=0), axis=1).max() / h <= 1.002 * speed
    PathMotion(motion, profile)


def test_a_path_back_is_the_same_path() -> None:
    rng = np.random.default_rng(2)
    path = hand_line(rng)
    s = rng.uniform(0.0, path.length, 9)
    np.testing.assert_allclose(path.reversed().at(s), path.at(path.length - s), atol=1e-12)
    for order in (1, 2):
        numeric = (path.at(s + 1e-6, order - 1) - path.at(s - 1e-6, order - 1)) / 2e-6
        np.testing.assert_allclose(path.at(s, order), numeric, atol=1e-5 * 100.0**order)


def test_a_hands_path_is_straight_to_a_micrometre() -> None:
    path = hand_line(np.random.default_rng(7))
    position, _ = ARM.forward(path.at(np.linspace(0.0, path.length, 50)))
    line = np.linspace(position[0], position[-1], 50)
    assert np.abs(position - line).max() < 1e-6


def test_no_way_is_rest_and_no_length_is_refused() -> None:
    path = JointPath.line(START, START)
    assert len(path.motion(0.0, 1.0, limits.profile("lab"), 0.1)) == 2
    with pytest.raises(ConfigurationError, match="length is 0"):
        JointPath.through(np.array([START, START]), 0.0)
