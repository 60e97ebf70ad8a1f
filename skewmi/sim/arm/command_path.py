"""The deployed command path in the batched task: actions to servo targets at every substep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.command_integrator import integrate_command, remembered_stall, stalled
from skewmi.policy_io import Array, PolicyLayout
from skewmi.sim.arm import definition
from skewmi.sim.arm.scene import ArmScene, workspace_of


class CommandPath:
    """Commands of `n` arms.

    An action moves the commanded hand position (`integrate_command`), inverse kinematics follows
    it from the commanded configuration, and the servos' targets run linearly to the new one over
    the substeps, with the velocity of that line as feed-forward. Where the hand is held up, the
    line ends.

    Args:
        layout: Of the task.
        scene: Gives kinematics and controls.
        n: Number of arms.

    Attributes:
        position_w: Commanded hand position at the end of the step, world, m. Shape (n, 3).
        q: Commanded joints there, rad. Shape (n, 7).
        opening: Commanded travel of each finger from closed, m. Shape (n,).
        targets: Controls at every substep of the step. Shape (n, substeps, nu).
    """

    def __init__(self, layout: PolicyLayout, scene: ArmScene, n: int) -> None:
        self._layout, self._scene, self._workspace = layout, scene, workspace_of(layout)
        self.position_w: Array = np.empty((n, 3))
        self.q: Array = np.empty((n, 7))
        self.opening: Array = np.empty(n)
        # Held from step to step, because allocating them costs as much as several substeps.
        steps = definition.SUBSTEPS
        self.targets: Array = np.empty((n, steps, scene.model.nu))
        self._fraction = (np.arange(1, steps + 1) / steps)[:, None]

    def start(self, position_w: Array, q: Array) -> Array:
        """Command the arms to where they start.

        Args:
            position_w: Hand, world, m. Shape (n, 3).
            q: Joints, rad. Shape (n, 7).

        Returns:
            Controls that hold them there. Shape (n, nu).
        """
        self.position_w, self.q = position_w, q
        self._stall = np.zeros(len(q))
        self.opening = np.full(len(q), self._workspace.gripper_opening)
        return self._scene.controls(q, self.opening)

    def move(self, action: Array, hand_w: Array, hand_travel_w: Array) -> None:
        """Lay out the targets of the coming step.

        Args:
            action: In [-1, 1], clipped here. Shape (n, action_dim).
            hand_w: Measured hand, world, m. Shape (n, 3).
            hand_travel_w: Its motion in the last step, m. Shape (n, 3).
        """
        self._begin_w, self._begin_q = self.position_w, self.q
        opening_before = self.opening
        self._moving = np.ones(len(action), dtype=np.bool_)
        self._stall = remembered_stall(
            self._layout, self._stall, self.position_w - hand_w, hand_travel_w
        )
        self.position_w = integrate_command(
            self._layout, self.position_w, action, hand_w, self._stall
        )
        self.q = self._scene.arm_positions(self._workspace, self.position_w, self.q)
        if self._layout.action_dim == 4:
            travel = np.clip(action[:, 3], -1.0, 1.0) * self._layout.action_scale[3]
            self.opening = np.clip(opening_before + travel, 0.0, definition.FINGER_MAX)
        velocity = (self.q - self._begin_q) / self._layout.control_dt
        first = self._scene.controls(self._begin_q, opening_before, velocity)
        last = self._scene.controls(self.q, self.opening, velocity)
        np.multiply((last - first)[:, None, :], self._fraction, out=self.targets)
        self.targets += first[:, None, :]

    def wait_for_hands(self, substep: int, hand_w: Array, moved_w: Array) -> NDArray[np.int64]:
        """End the step's command where it is, for hands that do not follow it.

        Args:
            substep: How many substeps of the step are done.
            hand_w: Measured hand now, world, m. Shape (n, 3).
            moved_w: Its motion in the last `WATCH_SUBSTEPS`, m. Shape (n, 3).

        Returns:
            Indices of the arms whose targets changed.
        """
        done = substep / definition.SUBSTEPS
        now_w = self._begin_w + done * (self.position_w - self._begin_w)
        rate = definition.SUBSTEPS / definition.WATCH_SUBSTEPS
        stall = stalled(self._layout, now_w - hand_w, moved_w * rate)
        # A command that comes back to the hand shall do so.
        away = np.linalg.norm(self.position_w - hand_w, axis=1)
        away -= np.linalg.norm(now_w - hand_w, axis=1)
        stops = self._moving & (away > 0.0) & (stall > self._workspace.stop_blockage)
        held = np.flatnonzero(stops)
        if held.size:
            self._moving[held] = False
            self._stall[held] = np.maximum(self._stall[held], stall[held])
            self.position_w, self.q = self.position_w.copy(), self.q.copy()
            self.position_w[held] = now_w[held]
            self.q[held] = self._begin_q[held] + done * (self.q[held] - self._begin_q[held])
            arm = np.ix_(held, np.arange(substep, definition.SUBSTEPS), self._scene.arm_ctrl)
            self.targets[arm] = self.q[held][:, None, :]
        return held
