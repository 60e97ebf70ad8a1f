"""What the single and the vector Gymnasium environment have in common."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skewmi.batch_env import StepResult
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.sim import tasks
from skewmi.sim.goals import RegionGoals
from skewmi.sim.offscreen import Image
from skewmi.sim.task_spec import Camera

GoalObservation = dict[str, Array]
"""`observation`, `achieved_goal` and `desired_goal`."""

_SEED_END = 2**31


class GoalTask:
    """What the single and the vector environment have in common: one `BatchEnv` with goals.

    Goals and rewards are of what the observation says, errors of its sensors included, for the
    reward must be `compute_reward` of the achieved and the desired goal, and an achieved goal of
    the true scene would tell a policy what no sensor does. `StepResult.success` is of the true one.
    """

    def __init__(
        self,
        task: str,
        num_envs: int,
        render_mode: str | None,
        size: tuple[int, int],
        options: dict[str, Any],
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ConfigurationError(f"render_mode is {render_mode!r}; allowed are None, rgb_array")
        self.batch = tasks.make_batch(task, num_envs, **options)
        self.goals = RegionGoals(self.batch.layout)
        self.desired_goal = self.goals.checked(self.goals.default, num_envs)
        self._size = size
        self._camera: Camera | None = None
        self._seeded = False

    @property
    def layout(self) -> PolicyLayout:
        """Of the task."""
        return self.batch.layout

    @property
    def render_fps(self) -> int:
        """Pictures a second at real time."""
        return max(1, round(1.0 / self.layout.control_dt))

    def spaces(self) -> tuple[gymnasium.spaces.Dict[Any], gymnasium.spaces.Box]:
        """Of one copy. Observations are unbounded: a layout's ranges scale, they do not clip."""
        sizes = {
            "observation": self.layout.observation_dim,
            "achieved_goal": self.goals.dim,
            "desired_goal": self.goals.dim,
        }
        return (
            gymnasium.spaces.Dict(
                {
                    name: gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)
                    for name, size in sizes.items()
                }
            ),
            gymnasium.spaces.Box(-1.0, 1.0, (self.layout.action_dim,), np.float32),
        )

    def reset(
        self,
        seed: int | None,
        options: dict[str, Any] | None,
        random: np.random.Generator,
    ) -> GoalObservation:
        """Start episodes with the goals that `options` asks for."""
        unknown = set(options or {}) - {"desired_goal"}
        if unknown:
            raise ConfigurationError(
                f"reset has no options {sorted(unknown)}; there is 'desired_goal' (and for vector "
                "environments 'reset_mask')"
            )
        goal = (options or {}).get("desired_goal", self.goals.default)
        self.desired_goal = self.goals.checked(goal, self.batch.num_envs)
        if seed is None and not self._seeded:
            # Never seeded: Gymnasium promises a random start then, a BatchEnv begins at seed 0.
            seed = int(random.integers(_SEED_END))
        self._seeded = True
        return self.goal_observation(self.batch.reset(seed))

    def step(self, action: ArrayLike) -> tuple[StepResult, GoalObservation, NDArray[np.bool_]]:
        """Result, goal observation and whether each desired goal is reached."""
        result = self.batch.step(np.asarray(action, dtype=np.float64))
        observation = self.goal_observation(result.observation)
        reached = self.goals.reached(observation["achieved_goal"], self.desired_goal)
        return result, observation, reached

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike) -> Any:
        """1.0 where the goal is reached, else 0.0: a float for single goals, else an array.

        Equal to the reward of a step for the goals in its observation.
        """
        reached = self.goals.reached(achieved_goal, desired_goal)
        return float(reached) if reached.ndim == 0 else reached.astype(np.float64)

    def goal_observation(self, observation: Array) -> GoalObservation:
        """The three entries, each with its own memory."""
        return {
            "observation": observation,
            "achieved_goal": self.goals.achieved(observation),
            "desired_goal": self.desired_goal.copy(),
        }

    def picture(self, index: int) -> Image:
        """Of one copy now."""
        if self._camera is None:
            self._camera = tasks.find(self.layout.task).camera(self.batch, *self._size)
        return self._camera.render(index)

    def close(self) -> None:
        """Give the OpenGL context back."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None


class GoalFace:
    """What both environments show of their task besides Gymnasium's own interface."""

    _task: GoalTask

    @property
    def layout(self) -> PolicyLayout:
        """Names, units and frames of observation and action."""
        return self._task.layout

    @property
    def goal_names(self) -> tuple[str, ...]:
        """Fields that a goal gives."""
        return self._task.goals.names

    def compute_reward(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Any:
        """1.0 where the goal is reached, else 0.0; `info` is not used.

        Args:
            achieved_goal: Shape (..., goal_dim).
            desired_goal: Shape (..., goal_dim).
            info: Anything.

        Returns:
            Shape (...): a float for single goals.
        """
        return self._task.compute_reward(achieved_goal, desired_goal)


def one_of(observation: GoalObservation, index: int) -> GoalObservation:
    """The observation of one copy, with its own memory."""
    return {name: values[index].copy() for name, values in observation.items()}
