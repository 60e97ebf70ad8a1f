"""Places of a path are near each other, from end to end, however it bends."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.session.path_places import JOINT_STEP, places_along
from skewmi.robot_models import yumi

Q = np.array(yumi.TABLE_CONFIGURATION)


@pytest.mark.parametrize("turn", [0.0, 1e-6, 0.0301, 0.7, 2.0])
def test_a_line_is_seen_at_every_joint_step(turn: float) -> None:
    path = JointPath.line(Q, Q + turn * np.linspace(-1.0, 0.5, 7))
    places = places_along(path)
    assert len(places) >= 2
    np.testing.assert_allclose(places[0], path.at(0.0), atol=1e-15)
    np.testing.assert_allclose(places[-1], path.at(1.0), atol=1e-15)
    assert np.abs(np.diff(places, axis=0)).max(initial=0.0) <= JOINT_STEP


def test_a_joint_that_turns_there_and_back_is_seen_as_often() -> None:
    bend = np.zeros((3, 7))
    bend[:, 2] = 0.0, 0.0, 0.4
    path = JointPath(np.vstack((Q, np.zeros((1, 7)), bend[2:])), 0.1)
    places = places_along(path)
    assert np.abs(places[0] - places[-1]).max() < 1e-12
    assert len(places) >= 1.5 / JOINT_STEP
