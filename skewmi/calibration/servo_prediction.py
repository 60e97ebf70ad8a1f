"""Where an arm in free space should be by now: the servo model, stepped as time goes on.

What `servo_model.ServoModel` computes for a whole recording, here one command after the other.
"""

from __future__ import annotations

from collections import deque

import mujoco
import numpy as np

from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S, JointTrajectory


class ServoPrediction:
    """One arm that follows commands.

    Args:
        servo: What its servos are taken to be.
        model: Gives the arm, and what its controller adds for velocities.
    """

    def __init__(self, servo: DelayedServo, model: ServoModel) -> None:
        self.servo = servo
        self._lead = model.velocity_lead
        self._arm = model.arm(servo.parameters)
        self._data = mujoco.MjData(self._arm.model)
        self._whole, self._part = divmod(servo.delay_s / GRID_S, 1.0)
        self._coming: deque[Array] = deque()

    def begin(self, q: Array, commanded: Array) -> None:
        """Rest, however the arm rests: friction may hold it off its command.

        Args:
            q: Where it is, rad. Shape (7,).
            commanded: Where it is told to be, and has been, rad. Shape (7,).
        """
        mujoco.mj_resetData(self._arm.model, self._data)
        self._data.qpos[self._arm.qpos] = q
        size = int(self._whole) + 2
        self._coming = deque([np.array(commanded)] * size, maxlen=size)

    def step(self, commands: JointTrajectory) -> Array:
        """Follow commands, one every 4 ms.

        Returns:
            Where it is after them, rad. Shape (7,).
        """
        for target in commands.q + self._lead * commands.v:
            self._coming.append(target)
            # As `servo_model.late_targets`: between two commands linear.
            late = (1.0 - self._part) * self._coming[1] + self._part * self._coming[0]
            self._data.ctrl[self._arm.actuators] = late
            if (stiction := self.servo.stiction) is not None:
                speed = self._data.qvel[self._arm.dofs]
                own = self.servo.parameters
                friction = own.frictionloss + own.kp * stiction.left(speed)
                self._arm.model.dof_frictionloss[self._arm.dofs] = friction
            mujoco.mj_step(self._arm.model, self._data)
        q: Array = self._data.qpos[self._arm.qpos].copy()
        return q
