"""The simulated scene behind the emulated controller: servos and contact of the simulated robot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.egm_emulator.control_law import Target
from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import Side
from skewmi.trajectory import GRID_S, Array, JointPoint

_NOTHING = np.zeros(7)


class ScenePlant:
    """The right arm in its task's scene, and a left arm that is where it is told to be.

    One physics step of 4 ms per cycle of the controller. A cycle takes 4.032 ms, so physics go
    0.8 % slower than the controller; speeds are scaled by as much.

    Args:
        simulation: Of the right arm and the scene.
        period_s: Of the controller's cycle.
    """

    def __init__(self, simulation: ArmSimulation, period_s: float) -> None:
        self.simulation = simulation
        self._stretch = period_s / GRID_S
        self._left: Array = np.array(yumi.HOME["left"])

    def position(self, side: Side) -> Array:
        """Measured joints, of the right arm with the variation's sensor errors."""
        if side == "left":
            return self._left
        return self.simulation.robot_state(0).position[:7]

    def follow(self, targets: Mapping[Side, Target]) -> None:
        """Let the servos follow for one cycle.

        Raises:
            BackendFaultError: MuJoCo found a state that is not physical.
        """
        if "left" in targets:
            self._left = targets["left"].q
        right = targets["right"]
        self.simulation.command = JointPoint(right.q, self._stretch * right.v, _NOTHING)
        self.simulation.step()
