"""Random actions are nobody else's random numbers."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.evaluation.agents import RandomAgent
from skewmi.sim import tasks


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_the_first_action_is_not_where_the_hand_starts(seed: int) -> None:
    env = tasks.make_batch("open_press_close", 3, num_threads=1, seed=seed)
    observation = env.reset(seed)
    action = RandomAgent(env.layout, seed).act(observation)
    assert env.layout.workspace is not None
    offset = observation[:, :3] - np.array(env.layout.workspace.start)
    # Chance makes three rows of three numbers agree in direction to 0.9 about never.
    cosine = np.sum(offset * action) / (np.linalg.norm(offset) * np.linalg.norm(action))
    assert abs(cosine) < 0.9


def test_the_first_actions_are_not_where_points_start() -> None:
    env = tasks.make_batch("point_maze", 50, seed=0, start_noise=0.5)
    observation = env.reset(0)
    action = RandomAgent(env.layout, 0).act(observation)
    assert abs(np.corrcoef(observation.ravel(), action.ravel())[0, 1]) < 0.5
