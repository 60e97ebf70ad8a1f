"""Tasks with an arm as batched environments on `mujoco.batch`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from skewmi.batch_env import StepResult
from skewmi.calibration.calibration_file import Calibration
from skewmi.errors import ConfigurationError
from skewmi.policy_io import TIME_FIELD, Array, PolicyLayout, assemble_observation
from skewmi.sim.arm import reach
from skewmi.sim.arm.arm_task import ArmTask
from skewmi.sim.arm.diagnostics import Diagnostics
from skewmi.sim.arm.known import Known
from skewmi.sim.arm.physics import ArmPhysics
from skewmi.sim.arm.randomization import Randomization
from skewmi.sim.arm.scene import ArmScene
from skewmi.sim.checks import (
    checked_action,
    checked_num_envs,
    checked_num_threads,
    checked_switches,
)
from skewmi.sim.variation import ModelVariation, VariationSample
from skewmi.success import inside_region
from skewmi.yaml_text import shown


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
        target: str | None = None,
        randomization: Randomization | None = None,
        variation: ModelVariation | str | Path | None = None,
        calibration: Calibration | str | Path | None = None,
    ) -> None:
        """Make the environment; call `reset` before `step`.

        Args:
            task: What stands before them, and when it is done.
            num_envs: How many robots.
            num_threads: Threads that step them, 0 for all cores. Results do not depend on it.
            seed: Of the start positions and of the variation's values.
            gripper_action: Whether the fingers' speed is a fourth action.
            time_input: Whether the observation ends with step index / episode steps.
            target: Name of the region that is rewarded; without it, the task's own.
            randomization: What differs between episodes; the default varies the hand's start.
            variation: How robot and scene differ from the nominal ones: a variation, its file, or
                the name of a bundled one. Its values are drawn at each reset from a stream of
                their own: the start positions are those of the nominal model. Reward and success
                are of the true state; the observation is what its sensors say.
            calibration: What is known of the robot, whatever the variation says that it is: a
                calibration, its file, or its JSON. Servos get feed-forward from it, hinges are read
                from their zero, and the policy works in the frame of the box that it knows.

        Raises:
            ConfigurationError: A value is of another type or out of range, or variation or
                calibration not valid.
            NotFoundError: There is no such target, variation or calibration file.
        """
        self.task = task
        switches = checked_switches(gripper_action=gripper_action, time_input=time_input)
        self.layout = task.layout(target=target, **switches)
        self._randomization = _checked(randomization)
        self.num_envs = checked_num_envs(num_envs)
        self.variation = task.variations.resolve(variation)
        known = Known.of(calibration)
        self.scene = ArmScene(task, known.displacement if known else None)
        self._placed = self.scene.placed(self.layout)
        self._physics = ArmPhysics(
            self.scene,
            self._placed,
            self.num_envs,
            checked_num_threads(num_threads),
            self.variation,
            seed,
            known,
        )
        self.batch, self.servo_targets = self._physics.batch, self._physics.servo_targets
        self._rng = np.random.default_rng(seed)
        self._step_index = -1

    def reset(self, seed: int | None = None) -> Array:
        """Start new episodes everywhere; with a seed, restart the random streams from it.

        Returns:
            First observation. Shape (num_envs, observation_dim).
        """
        if seed is not None:
            self._rng = np.random.default_rng(seed)
            if self._physics.varied is not None:
                self._physics.varied.seed(seed)
        starts = self._randomization.sample_starts(self.layout, self.num_envs, self._rng)
        self._physics.start(self._placed, starts)
        self._step_index = 0
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
        self._physics.step(values)
        self._step_index += 1
        observation, truth = self._observe()
        inside = inside_region(self.layout, truth)
        return StepResult(
            observation=observation,
            reward=inside.astype(np.float64),
            success=inside,
            truncated=self._step_index == self.layout.episode_steps,
        )

    def _observe(self) -> tuple[Array, Array]:
        """What the sensors say, and the same with the scene as it is."""
        values: dict[str, Any] = self._physics.values()
        values[TIME_FIELD] = self._step_index / self.layout.episode_steps
        truth = assemble_observation(self.layout, values)
        seen = self._physics.with_errors(values)
        return truth if seen is None else assemble_observation(self.layout, seen), truth

    def compute_reward(self, state: Array) -> Array:
        """1.0 for states in the reward region, else 0.0. Shape (..., >= state_dim) -> (...)."""
        return inside_region(self.layout, state).astype(np.float64)

    def reachable(self, state: Array) -> NDArray[np.bool_]:
        """Whether the task can be in such states at all; see `reach.reachable`."""
        return reach.reachable(self.task, self.layout, state)

    def diagnostics(self) -> Diagnostics:
        """Forces and tracking of the last step (zero forces after a reset)."""
        return self._physics.diagnostics()

    @property
    def variation_sample(self) -> VariationSample | None:
        """What was drawn at the last reset; None for the nominal model."""
        varied = self._physics.varied
        return None if varied is None else varied.sample

    def command(self) -> tuple[Array, Array]:
        """What the arm is commanded to at the end of the last step.

        Returns:
            Hand position, world, m, shape (num_envs, 3); joints, rad, shape (num_envs, 7).
        """
        return self._physics.command.position_w.copy(), self._physics.command.q.copy()

    def random_state(self) -> dict[str, object]:
        """JSON-serialisable state of the random streams."""
        state: dict[str, object] = {"generator": self._rng.bit_generator.state}
        if self._physics.varied is not None:
            state["variation"] = self._physics.varied.random_state()
        return state

    def set_random_state(self, state: dict[str, object]) -> None:
        """Inverse of `random_state`.

        Raises:
            ConfigurationError: The state is not one of this environment's.
        """
        try:
            rng = np.random.default_rng()
            rng.bit_generator.state = cast(Mapping[str, Any], state["generator"])
            if self._physics.varied is not None:
                self._physics.varied.set_random_state(cast(Mapping[str, Any], state["variation"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigurationError(f"not a random state of {self.task.name}: {error}") from error
        self._rng = rng


def _checked(randomization: object) -> Randomization:
    if randomization is None:
        return Randomization()
    if not isinstance(randomization, Randomization):
        raise ConfigurationError(
            f"randomization is {shown(randomization)}; it must be a Randomization, which can be "
            "given from Python alone: no --option can say one"
        )
    return randomization
