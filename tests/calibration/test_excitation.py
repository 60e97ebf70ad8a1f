"""Whatever the seed, an excitation is a motion that a robot server would carry out."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.calibration.clear_space import CLEARANCE, ClearSpace, Obstacle
from skewmi.calibration.excitation import REST_S, Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.deploy.safety import limits as checks
from skewmi.deploy.safety.guard import Guard
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_S, JointTrajectory

SPACE = ClearSpace()
KINEMATICS = ArmKinematics("right")


def checked(
    motion: JointTrajectory, name: str, monkeypatch: pytest.MonkeyPatch
) -> checks.LimitUsage:
    """By the robot server's own checks, the whole motion as if it were one chunk."""
    monkeypatch.setattr(checks, "MAX_SAMPLES", len(motion))
    checker = checks.ChunkChecker(limits.profile(name), None, KINEMATICS.forward)
    return checker.check(motion.q, motion.v, motion.a)


@pytest.mark.parametrize("name", ["lab", "careful"])
@pytest.mark.parametrize("seed", [0, 2, 20260])
def test_it_is_within_all_limits_clear_and_at_rest_at_its_ends(
    name: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    centre = excitation_centre() + rng.uniform(-0.1, 0.1, 7)
    seconds = float(rng.uniform(4.0, 9.0))
    motion = Excitation(seconds, seed).motion(centre, limits.profile(name), SPACE)
    usage = checked(motion, name, monkeypatch)
    assert max(usage.as_dict().values()) <= 1.0
    # It is worth its time: some limit binds.
    assert max(usage.velocity, usage.acceleration, usage.jerk, usage.tcp_speed) > 0.9
    Guard(limits.profile(name)).check(motion.q[::25], motion.v[::25], motion.a[::25])
    assert abs(motion.duration_s - seconds) <= GRID_S / 2.0 + 1e-9
    rest = round(REST_S / GRID_S)
    for part in (motion.q[: rest + 1], motion.q[-rest - 1 :]):
        np.testing.assert_array_equal(part, np.tile(centre, (rest + 1, 1)))
    assert (np.ptp(motion.q, axis=0) > 0.02).all()


def test_it_is_what_its_seed_says_and_other_joints_do_not_change_a_joint() -> None:
    profile = limits.profile("lab")
    first = Excitation(5.0, 3).motion(excitation_centre(), profile, SPACE)
    again = Excitation(5.0, 3).motion(excitation_centre(), profile, SPACE)
    other = Excitation(5.0, 4).motion(excitation_centre(), profile, SPACE)
    np.testing.assert_array_equal(first.q, again.q)
    assert np.abs(first.q - other.q).max() > 0.01
    wrist = Excitation(5.0, 3, joints=(False,) * 6 + (True,))
    alone = wrist.motion(excitation_centre(), profile, SPACE)
    np.testing.assert_array_equal(alone.q[:, :6], np.tile(excitation_centre()[:6], (len(alone), 1)))
    assert np.corrcoef(alone.q[:, 6], first.q[:, 6])[0, 1] > 0.999


def test_it_shrinks_before_an_obstacle_and_keeps_clear_of_it() -> None:
    profile = limits.profile("lab")
    free = Excitation(5.0, 0).motion(excitation_centre(), profile, SPACE)
    # Below the finger tips, 8 mm further off at the centre than the arm keeps clear of it.
    top = float(KINEMATICS.forward(free.q[0])[0][2]) - 0.136 - CLEARANCE - 0.008
    box = Obstacle((0.39, -0.13, top / 2.0), (0.1, 0.1, top / 2.0))
    space = ClearSpace((box,))
    assert space.first_touch(free.q[::5]) is not None
    motion = Excitation(5.0, 0).motion(excitation_centre(), profile, space)
    assert space.first_touch(motion.q) is None
    assert 0.05 < np.ptp(motion.q[:, 0]) / np.ptp(free.q[:, 0]) < 1.0


def test_places_without_room_are_refused() -> None:
    profile = limits.profile("lab")
    inside = Obstacle((0.39, -0.13, 0.3), (0.1, 0.1, 0.1))
    with pytest.raises(ConfigurationError, match="obstacle_0"):
        Excitation(5.0).motion(excitation_centre(), profile, ClearSpace((inside,)))
    with pytest.raises(ConfigurationError, match="inside the limits"):
        Excitation(5.0).motion(profile.position_upper + 0.1, profile, SPACE)


@pytest.mark.parametrize(
    "bad",
    [
        {"seconds": 1.0},
        {"seconds": float("nan")},
        {"seconds": 1e9},
        {"seed": -1},
        {"joints": (True,) * 6},
        {"joints": (False,) * 7},
        {"excursion": 0.0},
        {"tcp_speed": float("inf")},
    ],
)
def test_what_cannot_be_meant_is_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError):
        Excitation(**bad)  # type: ignore[arg-type]
