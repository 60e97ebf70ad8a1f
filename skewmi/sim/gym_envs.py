"""The tasks as Gymnasium environments, for everybody's learners.

Importing this module registers every task of the registry, those of other packages included, by
an id made of its name: task `open_drawer` is `skewmi/OpenDrawer-v0`. `IDS` lists them.

    import gymnasium
    from skewmi.sim import gym_envs

    env = gymnasium.make(gym_envs.gym_id("open_drawer"))
    envs = gymnasium.make_vec("skewmi/OpenDrawer-v0", num_envs=25)

Observations are dictionaries as goal-conditioned learners expect them: `observation` (the task's
own layout, raw units), `achieved_goal` and `desired_goal` (see `skewmi.sim.goals`). The desired
goal is the centre of the task's reward region unless `reset(options={"desired_goal": ...})` asks
for another one, for that episode. The reward is `compute_reward(achieved_goal, desired_goal,
info)`: 1.0 at every step that ends with the goal reached, else 0.0. Episodes never terminate; they
are truncated after the layout's `episode_steps`. `info["success"]` says whether the step ended in
the *task's* reward region, `info["is_success"]` whether it ended with the *desired goal* reached.
With a variation that gives the sensors errors, `achieved_goal`, reward and `info["is_success"]` are
of what they say, as `observation` is; `info["success"]` alone is of the true scene.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from skewmi.sim import tasks
from skewmi.sim.gym_task import GoalFace, GoalObservation, GoalTask, one_of
from skewmi.sim.offscreen import Image


class GoalEnv(GoalFace, gymnasium.Env[Any, Any]):
    """One copy of a task. Module docstring: observation, goal, reward, info."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        task: str,
        *,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
        **options: Any,
    ) -> None:
        """Make it.

        Args:
            task: One of `tasks.names()`.
            render_mode: None or "rgb_array".
            width: Of the pictures, pixels.
            height: Of the pictures, pixels.
            options: Of the task, for example `time_input`.

        Raises:
            ConfigurationError: A value or the name of an option is not allowed.
        """
        options = {"num_threads": 1, **options}
        self._task = GoalTask(task, 1, render_mode, (width, height), options)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": self._task.render_fps}
        self.observation_space, self.action_space = self._task.spaces()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[GoalObservation, dict[str, Any]]:
        """Start an episode; the option `desired_goal`, shape (goal_dim,), is its goal."""
        super().reset(seed=seed)
        return one_of(self._task.reset(seed, options, self.np_random), 0), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[GoalObservation, float, bool, bool, dict[str, Any]]:
        """Take one control step with an action in [-1, 1], shape (action_dim,).

        Raises:
            ConfigurationError: The action has another shape or is not finite, or the episode
                is over.
        """
        result, observation, reached = self._task.step(np.asarray(action)[None])
        info = {"success": bool(result.success[0]), "is_success": bool(reached[0])}
        return one_of(observation, 0), float(reached[0]), False, result.truncated, info

    def render(self) -> Image | None:
        """A picture, shape (height, width, 3), or None without a render mode."""
        return None if self.render_mode is None else self._task.picture(0)

    def close(self) -> None:
        """Give the OpenGL context back."""
        self._task.close()


def gym_id(task: str) -> str:
    """The id of a task in Gymnasium's registry."""
    return f"skewmi/{''.join(word.capitalize() for word in task.split('_'))}-v0"


IDS = {gym_id(name): name for name in tasks.names()}
"""Registered id -> task."""


def register() -> None:
    """Register every id of `IDS` that is not registered yet; importing the module does it."""
    for name, task in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="skewmi.sim.gym_envs:GoalEnv",
                vector_entry_point="skewmi.sim.gym_vector:GoalVectorEnv",
                kwargs={"task": task},
            )


register()
