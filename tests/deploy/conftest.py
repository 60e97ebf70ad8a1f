"""Simulated robots in processes of their own, for the tests of a module."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from skewmi.deploy.robot.process import spawn_robot


@pytest.fixture(scope="module")
def lock_step_robot() -> Iterator[str]:
    """Locator of one that waits for its session."""
    with spawn_robot("sim", "open_press_close", "lab", lock_step=True) as locator:
        yield locator


@pytest.fixture(scope="module")
def robot() -> Iterator[str]:
    """Locator of one that runs in real time."""
    with spawn_robot("sim", "open_press_close", "lab", lock_step=False) as locator:
        yield locator
