"""Watchers that fall asleep, all at once: the arm can be stopped all the same."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "faults"))

from fault_robot import Robot
from floods import watchers


@pytest.mark.slow
def test_skewmi_stop_takes_less_than_a_second_while_32_watchers_sleep(tmp_path: Path) -> None:
    """From when they fall asleep until Zenoh has given up their sessions and closed them."""
    with Robot(tmp_path / "targets", lock_step=False) as robot:
        seen = watchers(robot, 32)
    assert seen["stops"] > 10
    assert seen["stops_failed"] == 0, seen
    assert seen["longest_stop_s"] < 1.0, seen
