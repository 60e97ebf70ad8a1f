"""Limit profiles and the table's own consistency."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.robot_models import limits, yumi


@pytest.mark.parametrize("name", limits.PROFILES)
def test_profiles_stay_inside_the_data_sheet(name):
    profile = limits.profile(name)
    assert profile.name == name
    assert np.all(profile.position_lower > yumi.POSITION_LOWER)
    assert np.all(profile.position_upper < yumi.POSITION_UPPER)
    assert np.all(profile.velocity <= 0.5 * yumi.VELOCITY)


@pytest.mark.parametrize("name", limits.PROFILES)
def test_profiles_can_stop_within_a_quarter_of_a_second_and_a_tenth_of_a_radian(name):
    """Stopping time of a trapezoidal braking: v/a + a/j; distance v/2 times that."""
    profile = limits.profile(name)
    shoulder = slice(0, 4)
    time = profile.velocity / profile.acceleration + profile.acceleration / profile.jerk
    assert np.all(time[shoulder] < 0.25)
    assert np.all((0.5 * profile.velocity * time)[shoulder] < 0.11)


def test_careful_is_the_slower_one():
    lab, careful = limits.profile("lab"), limits.profile("careful")
    for field in ("velocity", "acceleration", "jerk"):
        assert np.all(getattr(careful, field) < getattr(lab, field))


def test_limits_cannot_be_changed_by_accident():
    lab = limits.profile("lab")
    with pytest.raises(ValueError, match="read-only"):
        lab.velocity[0] = 100.0
    with pytest.raises(ValueError, match="read-only"):
        yumi.POSITION_LOWER[0] = -100.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        lab.name = "fast"  # type: ignore[misc]


def test_bad_limits_are_refused_in_words():
    lab = limits.profile("lab")
    with pytest.raises(NotFoundError, match="lab, careful"):
        limits.profile("fast")
    with pytest.raises(ConfigurationError, match="velocity must be positive"):
        dataclasses.replace(lab, velocity=np.zeros(7))
    with pytest.raises(ConfigurationError, match="7 finite"):
        dataclasses.replace(lab, jerk=np.ones(6))
    with pytest.raises(ConfigurationError, match="must be below"):
        dataclasses.replace(lab, position_lower=lab.position_upper)


def test_home_and_start_lie_inside_every_profile():
    for name in limits.PROFILES:
        profile = limits.profile(name)
        for q in (*yumi.HOME.values(), yumi.TABLE_CONFIGURATION):
            assert np.all(q > profile.position_lower)
            assert np.all(q < profile.position_upper)


def test_the_hash_follows_the_table(monkeypatch):
    assert len(yumi.MODEL_HASH) == 64
    monkeypatch.setattr(yumi, "JOINT_TORQUES", (35.0, *yumi.JOINT_TORQUES[1:]))
    assert yumi._model_hash() != yumi.MODEL_HASH
    monkeypatch.undo()
    assert yumi._model_hash() == yumi.MODEL_HASH


def test_inertias_can_exist():
    """Principal moments are positive and no one exceeds the sum of the other two."""
    inertials = [yumi.BODY_INERTIAL, *yumi.LINK_INERTIALS, yumi.GRIPPER.base]
    for inertial in inertials:
        xx, yy, zz, xy, xz, yz = inertial.inertia
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert moments[0] > 0.0
        assert moments[2] <= (moments[0] + moments[1]) * (1 + 1e-9)
