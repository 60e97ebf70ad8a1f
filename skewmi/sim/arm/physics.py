"""Simulated arms that follow commands, with sensors: what tasks of the arm run on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from skewmi.errors import SimulationError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.sim.arm import definition
from skewmi.sim.arm.batch_variation import BatchVariation
from skewmi.sim.arm.command_path import CommandPath
from skewmi.sim.arm.diagnostics import Diagnostics
from skewmi.sim.arm.known import Known
from skewmi.sim.arm.scene import ArmScene, hand_rotation, workspace_of
from skewmi.sim.arm.variation_keys import COMMAND_DELAY_MS
from skewmi.sim.variation import ModelVariation


class ArmPhysics:
    """`num_envs` simulations of one scene, stepped together.

    A control step is the deployed command path, see `CommandPath`.

    Args:
        scene: Models and addresses.
        layout: Of the task.
        num_envs: How many.
        num_threads: Threads that step them, 0 for all cores.
        variation: How they differ from the nominal model.
        seed: Of the variation's values.
        known: What is known of the robots, which says nothing of how they are.

    Attributes:
        scene: As given.
        batch: The simulations; runs `scene.physics_model`.
        command: What the arms are commanded to.
        servo_targets: Controls at every substep of the last step, delayed as the variation says,
            overwritten by the next. Shape (num_envs, substeps, nu).
        varied: The variation at work; None for the nominal model.
        hand_position_w: Hands as the sensors have them, world, m. Shape (num_envs, 3).
    """

    def __init__(
        self,
        scene: ArmScene,
        layout: PolicyLayout,
        num_envs: int,
        num_threads: int,
        variation: ModelVariation,
        seed: int,
        known: Known | None = None,
    ) -> None:
        self.scene, self._known = scene, known
        self.batch = Batch(scene.physics_model, num_envs, num_threads)
        feed_forward = None if known is None else known.feed_forward()
        stiffness = None if known is None else known.stiffness(workspace_of(layout))
        self.command = CommandPath(layout, scene, num_envs, feed_forward, stiffness)
        # The nominal variation is none at all, so that it costs nothing.
        nominal = variation.is_nominal
        self.varied = None if nominal else BatchVariation(variation, scene, self.batch, seed)
        # Without a variation the servos get what is commanded.
        targets = self.command.targets
        self.servo_targets = targets if self.varied is None else targets.copy()
        self.hand_position_w: Array = np.empty((num_envs, 3))
        self._qpos = self.batch.bind("qpos")
        self._hand_rotation = hand_rotation(workspace_of(layout))
        sensors = scene.model.nsensordata
        # Friction that depends on the speed is set anew before every substep.
        sticks = self.varied is not None and self.varied.sticks
        self._stretch = 1 if sticks else definition.WATCH_SUBSTEPS
        self._part = {"sensordata": np.empty((num_envs, self._stretch, sensors))}
        self._sensordata = np.empty((num_envs, definition.SUBSTEPS, sensors))

    def start(self, layout: PolicyLayout, hand_position_w: Array) -> None:
        """Begin episodes with the hands where asked, world, m. Shape (num_envs, 3)."""
        qpos = self.scene.start_positions(layout, hand_position_w)
        controls = self.command.start(hand_position_w, qpos[:, self.scene.arm_qpos])
        if self.varied is not None:
            self.varied.start(qpos, controls)
            self.command.delay_by(1e-3 * self.varied.sample.get(COMMAND_DELAY_MS))
        self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self._qpos[:] = qpos
        self.batch.bind("ctrl")[:] = controls
        self.batch.warning[:] = 0
        self._sensordata[:] = 0.0
        self._read_sensors()
        self._zero: Array | None = None
        if self._known is not None:
            errors = None if self._errors is None else self._errors[1]
            self._zero = self._known.zero(self.scene.task.joints, errors)

    def step(self, action: Array) -> None:
        """Take a control step; where a hand is blocked, its command waits for it.

        Args:
            action: In [-1, 1], clipped here. Shape (num_envs, action_dim).

        Raises:
            SimulationError: MuJoCo found a state that is not physical.
        """
        self.command.move(action, self.hand_position_w)
        compensated = self.command.feed_forward is not None
        if self.varied is not None:
            self.varied.begin_step()
            if not compensated:
                self.varied.delay(self.command.targets, self.servo_targets)
        period, steps = definition.WATCH_SUBSTEPS, definition.SUBSTEPS
        for begin in range(0, steps, period):
            if begin:
                held = self.command.wait_for_hands(begin, self._hand_w())
                if held.size and self.varied is not None and not compensated:
                    self.varied.delay(self.command.targets, self.servo_targets)
            if compensated:
                self.command.follow(slice(begin, begin + period))
                if self.varied is not None:
                    self.varied.delay(self.command.targets, self.servo_targets)
            for at in range(begin, begin + period, self._stretch):
                self._advance(slice(at, at + self._stretch))
        self._check()
        self._read_sensors()

    def _advance(self, part: slice) -> None:
        if self.varied is not None and self.varied.sticks:
            self.varied.rub()
        self.batch.rollout(
            self._stretch, self.servo_targets[:, part], record=("sensordata",), out=self._part
        )
        self._sensordata[:, part] = self._part["sensordata"]

    def _hand_w(self) -> Array:
        """Hands as measured, but for the sensors' noise, world, m. Shape (num_envs, 3)."""
        if self.varied is None:
            return self.scene.hand_pose(self._qpos)[0]
        measured = self.varied.measured(self._qpos[:, self.scene.arm_qpos])
        return self.scene.arm_pose(measured)[0]

    def _check(self) -> None:
        if not self.batch.warning.any():
            return
        bad = np.flatnonzero(self.batch.warning.any(axis=1))
        kinds = np.flatnonzero(self.batch.warning[bad].any(axis=0))
        names = ", ".join(mujoco.mjtWarning(int(kind)).name for kind in kinds)
        raise SimulationError(
            f"the simulation of environments {bad[:5].tolist()} of {self.batch.nsim} broke down "
            f"({names}); check the servo and contact parameters"
        )

    def _read_sensors(self) -> None:
        self._errors = None if self.varied is None else self.varied.sensor_errors()
        measured = self._qpos
        if self._errors is not None:
            measured = measured.copy()
            measured[:, self.scene.arm_qpos] += self._errors[0]
        self.hand_position_w, _ = self.scene.hand_pose(measured)

    def values(self) -> dict[str, Array]:
        """Every observation field but time, the scene as it is. Each shape (num_envs,)."""
        return self.scene.observation_values(self._qpos, self.hand_position_w)

    def with_errors(self, values: Mapping[str, Any]) -> dict[str, Any] | None:
        """These values as the scene's sensors have them, less the zero that is known of them.

        None if every sensor is ideal and nothing is taken off.
        """
        if self._errors is None and self._zero is None:
            return None
        off = np.zeros((self.batch.nsim, len(self.scene.task.joints)))
        if self._errors is not None:
            off += self._errors[1]
        if self._zero is not None:
            off -= self._zero
        seen = dict(values)
        for joint, error in zip(self.scene.task.joints, off.T, strict=True):
            seen[joint.field.name] = seen[joint.field.name] + error
        return seen

    def diagnostics(self) -> Diagnostics:
        """Forces and tracking of the last step (zero forces after a reset)."""
        sensor = self._sensordata
        on_hand = sensor[..., self.scene.hand_force]
        on_arm = sensor[..., self.scene.arm_force] - on_hand
        hand_force = np.linalg.norm(on_hand, axis=-1)
        hand_position_w, hand_rotation_w = self.scene.hand_pose(self._qpos)
        relative = np.einsum("ji,njk->nik", self._hand_rotation, hand_rotation_w)
        cosine = (np.trace(relative, axis1=1, axis2=2) - 1.0) / 2.0
        return Diagnostics(
            hand_force_peak=hand_force.max(axis=1),
            hand_force_mean=hand_force.mean(axis=1),
            arm_force_peak=np.linalg.norm(on_arm, axis=-1).max(axis=1),
            hand_tilt=np.arccos(np.clip(cosine, -1.0, 1.0)),
            hand_to_command=np.linalg.norm(self.command.position_w - hand_position_w, axis=-1),
        )
