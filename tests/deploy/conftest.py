"""Simulated robots in processes of their own, for the tests of a module."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from skewmi.deploy.robot.process import simulated_robot_process


@pytest.fixture(scope="module")
def lock_step_robot() -> Iterator[str]:
    with simulated_robot_process("open_press_close", "lab", lock_step=True) as locator:
        yield locator


@pytest.fixture(scope="module")
def robot() -> Iterator[str]:
    with simulated_robot_process("open_press_close", "lab", lock_step=False) as locator:
        yield locator
