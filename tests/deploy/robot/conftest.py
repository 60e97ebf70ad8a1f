"""A simulated robot without its wires, at the task's start."""

from __future__ import annotations

import pytest
from lone_motions import LAB
from lone_robot import LoneRobot

from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation


@pytest.fixture(scope="session")
def simulation() -> ArmSimulation:
    return ArmSimulation()


@pytest.fixture
def robot(simulation: ArmSimulation) -> LoneRobot:
    simulation.reset(seed=0)
    return LoneRobot(MujocoBackend(simulation, lock_step=True), LAB)
