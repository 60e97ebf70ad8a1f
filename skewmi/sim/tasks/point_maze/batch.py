"""The point maze as a batched environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from skewmi.batch_env import StepResult
from skewmi.errors import ConfigurationError
from skewmi.policy_io import TIME_FIELD, Array, PolicyLayout, assemble_observation
from skewmi.sim.checks import (
    checked_action,
    checked_num_envs,
    checked_num_threads,
    checked_switches,
    checked_width,
)
from skewmi.sim.tasks.point_maze import maze
from skewmi.success import inside_region


class PointMazeBatch:
    """`num_envs` points in the maze, moved together; satisfies `BatchEnv`.

    Stepping is array arithmetic on one thread. Episodes start at the origin, exactly as in
    the original, unless `start_noise` spreads them.
    """

    num_envs: int
    layout: PolicyLayout

    def __init__(
        self,
        num_envs: int,
        *,
        num_threads: int = 0,
        seed: int = 0,
        time_input: bool = False,
        target: str | None = None,
        start_noise: float = 0.0,
    ) -> None:
        """Make the environment; call `reset` before `step`.

        Args:
            num_envs: How many points.
            num_threads: Accepted for all tasks alike; the maze needs one thread.
            seed: Of the start positions.
            time_input: Whether the observation ends with step index / episode_steps.
            target: Name of what is rewarded, see `maze.layout`.
            start_noise: Half-width of the uniform start position per axis, m, below 1.

        Raises:
            ConfigurationError: A value is of another type, or out of its range.
            NotFoundError: There is no such target.
        """
        self.num_envs = checked_num_envs(num_envs)
        checked_num_threads(num_threads)
        # Half the start cell: beyond it stand walls.
        self._start_noise = checked_width(start_noise, "start_noise", 0.5 * maze.CELL_SIZE, "m")
        self.layout = maze.layout(target=target, **checked_switches(time_input=time_input))
        self._generator = np.random.default_rng(seed)
        self._position = np.zeros((self.num_envs, 2))
        self._step_index: int | None = None

    @property
    def position(self) -> Array:
        """Where the points are, x and y in m, as a copy. Shape (num_envs, 2)."""
        return self._position.copy()

    def reset(self, seed: int | None = None) -> Array:
        """Put every point at the start. See `BatchEnv.reset`."""
        if seed is not None:
            self._generator = np.random.default_rng(seed)
        self._position = self._generator.uniform(
            -self._start_noise, self._start_noise, (self.num_envs, 2)
        )
        self._step_index = 0
        return self._observation()

    def step(self, action: Array) -> StepResult:
        """Move every point. See `BatchEnv.step`.

        Raises:
            ConfigurationError: The action has another shape or is not finite, or there is no
                running episode.
        """
        if self._step_index is None or self._step_index >= self.layout.episode_steps:
            raise ConfigurationError(
                f"no running episode (they have {self.layout.episode_steps} steps); call reset"
            )
        action = checked_action(action, self.num_envs, self.layout.action_dim)
        self._position = maze.move(self._position, action)
        self._step_index += 1
        success = inside_region(self.layout, self._position)
        return StepResult(
            observation=self._observation(),
            reward=success.astype(np.float64),
            success=success,
            truncated=self._step_index == self.layout.episode_steps,
        )

    def compute_reward(self, state: Array) -> Array:
        """1.0 within 0.15 m of its target, else 0.0. Shape (..., >= 2) -> (...)."""
        return inside_region(self.layout, state).astype(np.float64)

    def reachable(self, state: Array) -> NDArray[np.bool_]:
        """Whether points are free: the free cells hang together. Shape (..., >= 2) -> (...)."""
        return maze.is_free(state)

    def random_state(self) -> dict[str, object]:
        """State of the random stream. See `BatchEnv.random_state`."""
        return {"start": dict(self._generator.bit_generator.state)}

    def set_random_state(self, state: dict[str, object]) -> None:
        """Inverse of `random_state`.

        Raises:
            ConfigurationError: The state is not one of this environment.
        """
        try:
            self._generator.bit_generator.state = dict(cast("Mapping[str, Any]", state["start"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigurationError(
                f"not a random state of the point maze ({error!r}); pass what random_state gave"
            ) from error

    def _observation(self) -> Array:
        assert self._step_index is not None
        return assemble_observation(
            self.layout,
            {
                "x": self._position[:, 0],
                "y": self._position[:, 1],
                TIME_FIELD: self._step_index / self.layout.episode_steps,
            },
        )


make_batch = PointMazeBatch
