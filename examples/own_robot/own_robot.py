"""A robot of your own for `skewmi robot`: its package's entry point names the function `make`.

    pip install ./examples/own_robot
    skewmi robot --backend own_robot

This one moves towards its command like a servo with a time constant. For a real arm, `write` sends
to your driver and `read` waits for its next cycle; the robot server judges every chunk, keeps lease
and states, publishes and serves. `HoldBackend` brings pace, gripper and lock-step.
"""

import numpy as np

from skewmi.deploy.robot.backend import RobotBackend
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.robot_models import yumi
from skewmi.trajectory import JointPoint

LAG_S = 0.02
"""Time in which 63 % of a step is done, s."""


class LaggingArm(HoldBackend):
    """An arm that follows its command with a first-order lag; satisfies `RobotBackend`."""

    name = "own_robot"
    _shown = np.array(yumi.HOME["right"])

    def write(self, command: JointPoint) -> None:
        """Move on by one cycle: x' = (command - x) / LAG_S, exactly."""
        part = 1.0 - np.exp(-self.period_ns / 1e9 / LAG_S)
        velocity = (command.q - self._shown) / LAG_S
        self._shown = self._shown + part * (command.q - self._shown)
        super().write(JointPoint(self._shown, velocity, command.a))


def make(options: BackendOptions) -> RobotBackend:
    """What `skewmi robot --backend own_robot` serves."""
    return LaggingArm(np.array(yumi.HOME["right"]), lock_step=options.lock_step)
