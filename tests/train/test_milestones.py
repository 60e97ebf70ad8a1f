"""First times."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.batch_env import Condition, Event
from skewmi.errors import ConfigurationError
from skewmi.train.milestones import Discoveries


def test_first_times_are_the_first(make_corridor, corridor_config) -> None:
    layout = make_corridor().layout
    found = Discoveries(layout, corridor_config.task_metrics.events)
    observations, rewards = np.zeros((4, 40, 3)), np.zeros((4, 40))
    assert found.add(observations, rewards, 0, 0) == []
    observations[1, 30:, 0] = 3.0
    observations[3, 7, 0] = 3.0  # the earliest step, though not the first row
    assert found.add(observations, rewards, 4, 160) == ["right side"]
    assert found.first["right side"] == {"trajectory": 4 + 3 + 1, "step": 160 + 8 * 4}
    rewards[0, 5] = 1.0
    assert found.add(observations, rewards, 8, 320) == ["reward"]
    assert found.first["right side"]["trajectory"] == 8


def test_event_of_an_unknown_field_is_refused(make_corridor) -> None:
    event = Event("lid", (Condition("lid_angle", low=0.5),))
    with pytest.raises(ConfigurationError, match="lid_angle"):
        Discoveries(make_corridor().layout, (event,))
