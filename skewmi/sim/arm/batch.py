"""Tasks with an arm as batched environments on `mujoco.batch`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from skewmi.batch_env import StepResult
from skewmi.errors import ConfigurationError, SimulationError
from skewmi.policy_io import TIME_FIELD, Array, PolicyLayout, assemble_observation
from skewmi.sim.arm import definition, reach
from skewmi.sim.arm.arm_task import ArmTask
from skewmi.sim.arm.batch_variation import BatchVariation
from skewmi.sim.arm.command_path import CommandPath
from skewmi.sim.arm.diagnostics import Diagnostics
from skewmi.sim.arm.randomization import Randomization
from skewmi.sim.arm.scene import ArmScene, hand_rotation, workspace_of
from skewmi.sim.checks import checked_action, checked_num_envs
from skewmi.sim.variation import ModelVariation, VariationSample
from skewmi.success import inside_region


class ArmBatch:
    """`num_envs` robots with a scene each; satisfies `BatchEnv`.

    A control step is the deployed command path, see `CommandPath`.

    Attributes:
        task: As given.
        num_envs, layout: See `BatchEnv`.
        scene: Models and addresses.
        batch: The simulations; runs `scene.physics_model`.
        servo_targets: Controls at every substep of the last step, delayed as the variation says,
            overwritten by the next. Shape (num_envs, substeps, nu).
        variation: How the simulations differ from the nominal one.
    """

    num_envs: int
    layout: PolicyLayout

    def __init__(
        self,
        task: ArmTask,
        num_envs: int,
        *,
        num_threads: int = 0,
        seed: int = 0,
        gripper_action: bool = False,
        time_input: bool = False,
        randomization: Randomization | None = None,
        variation: ModelVariation | str | Path | None = None,
    ) -> None:
        """Make the environment; call `reset` before `step`.

        Args:
            task: What stands before them, and when it is done.
            num_envs: How many robots.
            num_threads: Threads that step them, 0 for all cores. Results do not depend on it.
            seed: Of the start positions and of the variation's values.
            gripper_action: Whether the fingers' speed is a fourth action.
            time_input: Whether the observation ends with step index / episode steps.
            randomization: What differs between episodes; the default varies the hand's start.
            variation: How robot and scene differ from the nominal ones: a variation, its file, or
                the name of a bundled one. Its values are drawn at each reset from a stream of
                their own: the start positions are those of the nominal model. Reward and success
                are of the true state; the observation is what its sensors say.

        Raises:
            ConfigurationError: A number is out of its range, or the variation is not valid.
            NotFoundError: There is no such variation file.
        """
        if num_threads < 0:
            raise ConfigurationError(
                f"num_threads is {num_threads}; it must be 0 (all cores) or more"
            )
        self.num_envs = checked_num_envs(num_envs)
        self.task = task
        self.layout = task.layout(gripper_action=gripper_action, time_input=time_input)
        self.scene = ArmScene(task)
        self.batch = Batch(self.scene.physics_model, self.num_envs, num_threads)
        self._qpos = self.batch.bind("qpos")
        self._workspace = workspace_of(self.layout)
        self._hand_rotation = hand_rotation(self._workspace)
        self._randomization = Randomization() if randomization is None else randomization
        self.variation = task.variations.resolve(variation)
        # The nominal one is none at all, so that it costs nothing.
        self._variation = (
            None
            if self.variation.is_nominal
            else BatchVariation(self.variation, self.scene, self.batch, seed)
        )
        self._rng = np.random.default_rng(seed)
        self._step_index = -1
        self._hand_position_w = np.empty((self.num_envs, 3))
        self._command = CommandPath(self.layout, self.scene, self.num_envs)
        # Without a variation the servos get what is commanded.
        targets = self._command.targets
        self.servo_targets = targets if self._variation is None else targets.copy()
        steps = definition.SUBSTEPS
        sensors = self.scene.model.nsensordata
        self._part = {"sensordata": np.empty((self.num_envs, definition.WATCH_SUBSTEPS, sensors))}
        self._record = {
            "sensordata": np.empty((self.num_envs, steps, self.scene.model.nsensordata))
        }

    def reset(self, seed: int | None = None) -> Array:
        """Start new episodes everywhere; with a seed, restart the random streams from it.

        Returns:
            First observation. Shape (num_envs, observation_dim).
        """
        if seed is not None:
            self._rng = np.random.default_rng(seed)
            if self._variation is not None:
                self._variation.seed(seed)
        starts = self._randomization.sample_starts(self.layout, self.num_envs, self._rng)
        qpos = self.scene.start_positions(self.layout, starts)
        controls = self._command.start(starts, qpos[:, self.scene.arm_qpos])
        if self._variation is not None:
            self._variation.start(qpos, controls)
        self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self._qpos[:] = qpos
        self.batch.bind("ctrl")[:] = controls
        self.batch.warning[:] = 0
        self._record["sensordata"][:] = 0.0
        self._step_index = 0
        self._read()
        return self._observe()[0]

    def step(self, action: Array) -> StepResult:
        """Apply actions in [-1, 1], clipped here. Shape (num_envs, action_dim).

        Raises:
            ConfigurationError: The action's shape is wrong or it is not finite, or there was no
                reset, or the episode is over.
            SimulationError: MuJoCo found a state that is not physical.
        """
        if not 0 <= self._step_index < self.layout.episode_steps:
            raise ConfigurationError(
                f"step {self._step_index + 1} of an episode of {self.layout.episode_steps} steps; "
                "call reset first"
            )
        values = checked_action(action, self.num_envs, self.layout.action_dim)
        self._command.move(values, self._hand_position_w)
        if self._variation is not None:
            self._variation.begin_step()
            self._variation.delay(self._command.targets, self.servo_targets)
        self._roll_out()
        self._check_physics()
        self._step_index += 1
        self._read()
        observation, truth = self._observe()
        inside = inside_region(self.layout, truth)
        return StepResult(
            observation=observation,
            reward=inside.astype(np.float64),
            success=inside,
            truncated=self._step_index == self.layout.episode_steps,
        )

    def _roll_out(self) -> None:
        """Step the physics; where a hand is blocked, its command waits for it."""
        period, steps = definition.WATCH_SUBSTEPS, definition.SUBSTEPS
        for begin in range(0, steps, period):
            if begin:
                hand_w, _ = self.scene.hand_pose(self._qpos)
                held = self._command.wait_for_hands(begin, hand_w)
                if held.size and self._variation is not None:
                    self._variation.delay(self._command.targets, self.servo_targets)
            part = slice(begin, begin + period)
            self.batch.rollout(
                period, self.servo_targets[:, part], record=("sensordata",), out=self._part
            )
            self._record["sensordata"][:, part] = self._part["sensordata"]

    def _check_physics(self) -> None:
        if not self.batch.warning.any():
            return
        bad = np.flatnonzero(self.batch.warning.any(axis=1))
        kinds = np.flatnonzero(self.batch.warning[bad].any(axis=0))
        names = ", ".join(mujoco.mjtWarning(int(kind)).name for kind in kinds)
        raise SimulationError(
            f"the simulation of environments {bad[:5].tolist()} of {self.num_envs} broke down "
            f"at step {self._step_index + 1} ({names}); check the servo and contact parameters"
        )

    def _read(self) -> None:
        self._errors = None if self._variation is None else self._variation.sensor_errors()
        measured = self._qpos
        if self._errors is not None:
            measured = measured.copy()
            measured[:, self.scene.arm_qpos] += self._errors[0]
        self._hand_position_w, _ = self.scene.hand_pose(measured)

    def _observe(self) -> tuple[Array, Array]:
        """What the sensors say, and the same with the scene as it is."""
        values: dict[str, Any] = self.scene.observation_values(self._qpos, self._hand_position_w)
        values[TIME_FIELD] = self._step_index / self.layout.episode_steps
        truth = assemble_observation(self.layout, values)
        if self._errors is None:
            return truth, truth
        for joint, error in zip(self.task.joints, self._errors[1].T, strict=True):
            values[joint.field.name] = values[joint.field.name] + error
        return assemble_observation(self.layout, values), truth

    def compute_reward(self, state: Array) -> Array:
        """1.0 for states in the reward region, else 0.0. Shape (..., >= state_dim) -> (...)."""
        return inside_region(self.layout, state).astype(np.float64)

    def reachable(self, state: Array) -> NDArray[np.bool_]:
        """Whether the task can be in such states at all; see `reach.reachable`."""
        return reach.reachable(self.task, self.layout, state)

    def diagnostics(self) -> Diagnostics:
        """Forces and tracking of the last step (zero forces after a reset)."""
        sensor = self._record["sensordata"]
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
            hand_to_command=np.linalg.norm(self._command.position_w - hand_position_w, axis=-1),
        )

    @property
    def variation_sample(self) -> VariationSample | None:
        """What was drawn at the last reset; None for the nominal model."""
        return None if self._variation is None else self._variation.sample

    def command(self) -> tuple[Array, Array]:
        """What the arm is commanded to at the end of the last step.

        Returns:
            Hand position, world, m, shape (num_envs, 3); joints, rad, shape (num_envs, 7).
        """
        return self._command.position_w.copy(), self._command.q.copy()

    def random_state(self) -> dict[str, object]:
        """JSON-serialisable state of the random streams."""
        state: dict[str, object] = {"generator": self._rng.bit_generator.state}
        if self._variation is not None:
            state["variation"] = self._variation.random_state()
        return state

    def set_random_state(self, state: dict[str, object]) -> None:
        """Inverse of `random_state`.

        Raises:
            ConfigurationError: The state is not one of this environment's.
        """
        try:
            rng = np.random.default_rng()
            rng.bit_generator.state = cast(Mapping[str, Any], state["generator"])
            if self._variation is not None:
                self._variation.set_random_state(cast(Mapping[str, Any], state["variation"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigurationError(f"not a random state of {self.task.name}: {error}") from error
        self._rng = rng
