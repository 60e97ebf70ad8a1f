"""Goals for goal-conditioned learners: the reward region, moved to where the goal is.

A goal is a value for each field that the task's reward region talks about (x and y in a maze;
the angle of a door), and a state reaches it when it lies in the reward region
translated so that the region's centre is the goal. With the default goal, the region's own
centre, this is exactly the task's sparse reward; with any other goal, such as one that hindsight
replay puts in, it asks for the same precision elsewhere.

Whether a goal is reached is judged by the state that is handed in. Taken from an observation, that
is what the sensors say: with a variation that gives them errors, the true scene may be elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout


class RegionGoals:
    """Goals of one task.

    Attributes:
        names: Fields that a goal gives, in the order of the layout.
        default: Centre of the reward region, read-only. Shape (goal_dim,).
    """

    def __init__(self, layout: PolicyLayout) -> None:
        """Read the fields and the centre off the layout.

        Raises:
            ConfigurationError: The task has no reward region.
        """
        if not layout.reward_region:
            raise ConfigurationError(
                f"task {layout.task!r} has no reward region, so it has no goals"
            )
        centre: dict[str, float] = {}
        for ball in layout.reward_region:
            for name, value in zip(ball.fields, ball.centre, strict=True):
                centre.setdefault(name, value)
        self.names = tuple(name for name in layout.observation_names if name in centre)
        self.default: Array = np.array([centre[name] for name in self.names])
        self.default.setflags(write=False)
        self._columns = [layout.observation_names.index(name) for name in self.names]
        self._balls = [
            ([self.names.index(name) for name in ball.fields], np.array(ball.centre), ball.radius)
            for ball in layout.reward_region
        ]

    @property
    def dim(self) -> int:
        """Length of a goal."""
        return len(self.names)

    def achieved(self, observation: Array) -> Array:
        """The goal a state has reached: a copy of its goal fields. Shape (..., goal_dim).

        Of an observation with errors of the sensors it is the measured one.
        """
        goal: Array = observation[..., self._columns]  # indexing with a list copies
        return goal

    def reached(self, achieved_goal: ArrayLike, desired_goal: ArrayLike) -> NDArray[np.bool_]:
        """Whether the achieved goals lie in the region moved to the desired ones.

        Args:
            achieved_goal: Shape (..., goal_dim).
            desired_goal: Shape (..., goal_dim); broadcast against `achieved_goal`.

        Returns:
            Shape (...).

        Raises:
            ConfigurationError: A goal has another length.
        """
        achieved = np.asarray(achieved_goal, dtype=np.float64)
        desired = np.asarray(desired_goal, dtype=np.float64)
        for goal in (achieved, desired):
            if goal.ndim == 0 or goal.shape[-1] != self.dim:
                raise ConfigurationError(
                    f"a goal has shape {goal.shape}; its last axis must have {self.dim} entries "
                    f"({', '.join(self.names)})"
                )
        # Subtracting first keeps the default goal exact: achieved - default + default would round.
        same = desired == self.default
        moved = np.where(same, achieved, achieved - desired + self.default)
        inside = np.ones(moved.shape[:-1], dtype=np.bool_)
        for columns, centre, radius in self._balls:
            inside &= np.linalg.norm(moved[..., columns] - centre, axis=-1) <= radius
        return inside

    def checked(self, goal: ArrayLike, num_envs: int) -> Array:
        """A user's goal, one for all or one each. Shape (num_envs, goal_dim), own memory.

        Raises:
            ConfigurationError: The shape fits neither, or a number is not finite.
        """
        try:
            values = np.asarray(goal, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ConfigurationError(f"desired_goal is not an array of numbers: {error}") from error
        if values.shape not in ((self.dim,), (num_envs, self.dim)):
            raise ConfigurationError(
                f"desired_goal has shape {values.shape}; it takes ({self.dim},) or "
                f"{(num_envs, self.dim)}: {', '.join(self.names)}"
            )
        if not np.isfinite(values).all():
            raise ConfigurationError(f"desired_goal is {values.tolist()}; it must be finite")
        return np.broadcast_to(values, (num_envs, self.dim)).copy()
