"""The deployed command path in the batched task: actions to servo targets at every substep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.command_integrator import CommandIntegrator
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.sim.arm import definition
from skewmi.sim.arm.command_delay import CommandLine, DelayedCommands
from skewmi.sim.arm.scene import ArmScene, workspace_of
from skewmi.trajectory import GRID_NS


class CommandPath:
    """Commands of `n` arms.

    An action moves the commanded hand (`CommandIntegrator`), inverse kinematics follows it from
    the commanded configuration, and the servos' targets run linearly to the new one over the
    substeps, with the velocity of that line as feed-forward. Where the hand is blocked, the line
    ends.

    With `delay_by`, targets come later and smoother than that, as those of a deployed session.

    With a feed-forward of known servos the line is its reference. What is sent then depends on the
    ticks before, and `follow` has to be called for every part of the step before it is taken.

    Args:
        layout: Of the task.
        scene: Gives kinematics and controls.
        n: Number of arms.
        feed_forward: Of servos that are known; None for that of the nominal ones.
        stiffness: Of the hand that they make, relative to training's; None for that of training.

    Attributes:
        feed_forward: As given.
        q: Commanded joints at the end of the step, rad. Shape (n, 7).
        targets: Controls at every substep of the step. Shape (n, substeps, nu).
    """

    def __init__(
        self,
        layout: PolicyLayout,
        scene: ArmScene,
        n: int,
        feed_forward: FeedForward | None = None,
        stiffness: Array | None = None,
    ) -> None:
        self.feed_forward = feed_forward
        self._layout, self._scene, self._workspace = layout, scene, workspace_of(layout)
        self.integrator = CommandIntegrator(layout, definition.FINGER_MAX, stiffness)
        self.q: Array = np.empty((n, 7))
        # Held from step to step, because allocating them costs as much as several substeps.
        steps = definition.SUBSTEPS
        self.targets: Array = np.empty((n, steps, scene.model.nu))
        self._fraction = (np.arange(1, steps + 1) / steps)[:, None]
        self._delayed: DelayedCommands | None = None

    @property
    def position_w(self) -> Array:
        """Commanded hand at the end of the step, world, m. Shape (n, 3)."""
        return self.integrator.position_w

    def start(self, position_w: Array, q: Array) -> Array:
        """Command the arms to where they start.

        Args:
            position_w: Hand, world, m. Shape (n, 3).
            q: Joints, rad. Shape (n, 7).

        Returns:
            Controls that hold them there. Shape (n, nu).
        """
        self.integrator.start(position_w)
        self.q, self._delayed = q, None
        if self.feed_forward is not None:
            self.feed_forward.start(q)
        return self._scene.controls(q, self.integrator.opening)

    def delay_by(self, delay_s: Array) -> None:
        """Let every command of the episode that begins be late; see `DelayedCommands`.

        Args:
            delay_s: Of each arm, s. Shape (n,).
        """
        self._delayed = DelayedCommands(delay_s, self.q, self.position_w) if delay_s.any() else None

    def move(self, action: Array, hand_w: Array) -> None:
        """Lay out the targets of the coming step.

        Args:
            action: In [-1, 1], clipped here. Shape (n, action_dim).
            hand_w: Measured hand, world, m. Shape (n, 3).
        """
        integrator, delayed = self.integrator, self._delayed
        ahead_w = None if delayed is None else delayed.ahead(self.position_w, hand_w)
        integrator.begin_step(action, hand_w, ahead_w=ahead_w)
        self._begin_q = self.q
        self.q = self._scene.arm_positions(self._workspace, integrator.position_w, self.q)
        velocity = (self.q - self._begin_q) / self._layout.control_dt
        first = self._scene.controls(self._begin_q, integrator.opening_before, velocity)
        last = self._scene.controls(self.q, integrator.opening, velocity)
        np.multiply((last - first)[:, None, :], self._fraction, out=self.targets)
        self.targets += first[:, None, :]
        self._velocity = velocity
        if delayed is not None:
            hands = integrator.begin_w, integrator.position_w
            delayed.lay(CommandLine(self._begin_q, self.q, velocity, *hands))
            late = self._scene.controls(delayed.q, 0.0, delayed.velocity)
            self.targets[..., self._scene.arm_ctrl] = late[..., self._scene.arm_ctrl]

    def follow(self, part: slice) -> None:
        """Put what the feed-forward sends into the arms' targets of some substeps.

        Args:
            part: The substeps that come next.
        """
        assert self.feed_forward is not None
        arm = self._scene.arm_ctrl
        for substep in range(part.start, part.stop):
            reference, velocity = self._reference(substep)
            self.targets[:, substep, arm] = self.feed_forward.step(reference, velocity)

    def _reference(self, substep: int) -> tuple[Array, Array]:
        """Joints and their velocities at a substep, rad and rad/s. Each shape (n, 7)."""
        if self._delayed is not None:
            return self._delayed.q[:, substep], self._delayed.velocity[:, substep]
        left = (substep + 1 - definition.SUBSTEPS) * definition.SIM_DT
        return self.q + left * self._velocity, self._velocity

    def wait_for_hands(self, substep: int, hand_w: Array) -> NDArray[np.int64]:
        """End the step's command where it is, for hands that do not follow it.

        Args:
            substep: How many substeps of the step are done.
            hand_w: Measured hand now, world, m. Shape (n, 3).

        Returns:
            Indices of the arms whose targets changed.
        """
        delayed, since_ns = self._delayed, substep * GRID_NS
        if delayed is None:
            held = self.integrator.watch(hand_w, since_ns)
        else:
            commanded_w, coming_w = delayed.look(substep, hand_w)
            held = self.integrator.watch(
                hand_w, since_ns, commanded_w=commanded_w, coming_error_w=coming_w
            )
        if held.size:
            self.q = self.q.copy()
            if delayed is None:
                done = substep / definition.SUBSTEPS
                self.q[held] = self._begin_q[held] + done * (self.q[held] - self._begin_q[held])
            else:
                self.q[held] = delayed.hold(held, substep, self.position_w[held])
            arm = np.ix_(held, np.arange(substep, definition.SUBSTEPS), self._scene.arm_ctrl)
            self.targets[arm] = self.q[held][:, None, :]
            self._velocity[held] = 0.0
        return held
