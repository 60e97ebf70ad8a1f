"""What options of a task may be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skewmi.errors import ConfigurationError
from skewmi.sim import tasks
from skewmi.sim.checks import checked_switches, checked_width


@pytest.mark.parametrize("value", [0, 1, 3, 1.0, "true", None, [True], {}])
def test_a_switch_is_true_or_false_and_nothing_like_it(value: object) -> None:
    with pytest.raises(ConfigurationError, match=r"^second is .*; it must be true or false$"):
        checked_switches(first=True, second=value)
    assert checked_switches(first=np.True_, second=False) == {"first": True, "second": False}


@pytest.mark.parametrize(
    "value", ["a", "0.3", True, None, [0.1], {}, -0.1, 1, 1.0, 10**400, np.nan, np.inf]
)
def test_a_width_is_a_number_within_its_bounds(value: object) -> None:
    with pytest.raises(ConfigurationError, match=r"^width is .*; it must be a number from 0 to "):
        checked_width(value, "width", 1.0, "m")


@pytest.mark.parametrize("value", [0, 0.0, 0.5, np.float32(0.5), np.int64(0)])
def test_numbers_of_every_kind_are_widths(value: float) -> None:
    assert checked_width(value, "width", 1.0, "m") == float(value)


@pytest.mark.parametrize(
    ("task", "option", "value"),
    [
        ("point_maze", "start_noise", "a"),
        ("point_maze", "start_noise", True),
        ("point_maze", "time_input", 3),
        ("open_press_close", "time_input", 3),
        ("open_press_close", "gripper_action", 2),
        ("open_press_close", "randomization", 3),
        ("door_open", "randomization", {"start_offset": [0, 0, 0]}),
    ],
)
def test_options_of_another_type_are_refused_by_name(task: str, option: str, value: Any) -> None:
    with pytest.raises(ConfigurationError, match=f"^{option} is "):
        tasks.make_batch(task, 1, num_threads=1, **{option: value})
