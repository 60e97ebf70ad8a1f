"""The tasks as Gymnasium vector environments; `skewmi.sim.gym_envs` registers them."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError
from skewmi.sim.gym_task import GoalFace, GoalObservation, GoalTask, one_of
from skewmi.sim.offscreen import Image


class GoalVectorEnv(GoalFace, VectorEnv[Any, Any, NDArray[Any]]):
    """`num_envs` copies of a task on one threaded simulation.

    All episodes end together. With the autoreset mode NEXT_STEP, the step after that one ignores
    its action and starts new episodes (reward 0); with SAME_STEP the very step that ends them
    returns the first observation of the next ones and the last in `info["final_obs"]`; with
    DISABLED, `reset` is the caller's. An automatic reset goes back to the default goal.
    """

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
        **options: Any,
    ) -> None:
        """Make it; arguments as `GoalEnv`.

        Raises:
            ConfigurationError: A value or the name of an option is not allowed.
        """
        try:
            self._mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            allowed = ", ".join(mode.value for mode in AutoresetMode)
            raise ConfigurationError(
                f"autoreset_mode is {autoreset_mode!r}; allowed are {allowed}"
            ) from error
        self._task = GoalTask(task, num_envs, render_mode, (width, height), options)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": self._task.render_fps,
            "autoreset_mode": self._mode,
        }
        self.single_observation_space, self.single_action_space = self._task.spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[GoalObservation, dict[str, Any]]:
        """Start episodes everywhere.

        Args:
            seed: Of the start states; None goes on with the random streams.
            options: `desired_goal` of shape (goal_dim,) or (num_envs, goal_dim); `reset_mask` of
                shape (num_envs,), bool, as Gymnasium's own vector environments take it with
                AutoresetMode.DISABLED: which copies to start anew. All copies end together
                here, so that those that ended are all of them.

        Raises:
            ConfigurationError: An option or its value is not allowed, or the mask would start
                some copies anew and let the others go on.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if mask is not None:
            self._check_mask(mask)
        super().reset(seed=seed)
        self._ended = False
        return self._task.reset(seed, options, self.np_random), {}

    def _check_mask(self, mask: Any) -> None:
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ConfigurationError(
                f"reset_mask has shape {mask.shape} and type {mask.dtype}; it must be "
                f"({self.num_envs},) and bool"
            )
        if not mask.all():
            raise ConfigurationError(
                f"reset_mask names {int(mask.sum())} of {self.num_envs} copies; all episodes start "
                "and end together here, so reset all of them, or make environments of one copy"
            )

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[GoalObservation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Take one control step everywhere. Actions in [-1, 1], shape (num_envs, action_dim).

        Raises:
            ConfigurationError: The action has another shape or is not finite, or the episodes
                are over and the autoreset mode is DISABLED.
        """
        never = np.zeros(self.num_envs, dtype=np.bool_)
        if self._ended and self._mode is AutoresetMode.NEXT_STEP:
            observation, _ = self.reset()
            return observation, np.zeros(self.num_envs), never, never.copy(), {}
        result, observation, reached = self._task.step(actions)
        self._ended = result.truncated
        every = np.ones(self.num_envs, dtype=np.bool_)
        info: dict[str, Any] = {
            "success": result.success,
            "_success": every,
            "is_success": reached.copy(),
            "_is_success": every.copy(),
        }
        if self._ended and self._mode is AutoresetMode.SAME_STEP:
            last = np.empty(self.num_envs, dtype=object)
            last[:] = [one_of(observation, index) for index in range(self.num_envs)]
            info = {
                "final_obs": last,
                "_final_obs": every.copy(),
                "final_info": info,
                "_final_info": every.copy(),
            }
            observation, _ = self.reset()
        truncated = np.full(self.num_envs, result.truncated)
        return observation, reached.astype(np.float64), never, truncated, info

    def render(self) -> tuple[Image, ...] | None:
        """One picture per copy, each (height, width, 3), or None without a render mode."""
        if self.render_mode is None:
            return None
        return tuple(self._task.picture(index) for index in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Give the OpenGL context back."""
        self._task.close()
