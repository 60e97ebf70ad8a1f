"""Episodes of a scripted motion in a batch, and what they did to the scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skewmi.policy_io import Policy, PolicyLayout
from skewmi.sim.arm.arm_task import ArmTask
from skewmi.sim.arm.batch import ArmBatch
from skewmi.success import first_success_step

NUM_ENVS = 6


class ScriptedEpisodes:
    """One episode of a script in every environment.

    Args:
        task: What stands before the arm.
        script: Makes a script from the layout.
        seed: Of starts and noise.
        delay_steps: Control steps by which actions are late.
        noise: Standard deviation of the hand's reading, m.
        options: Of the environment.
    """

    def __init__(
        self,
        task: ArmTask,
        script: Callable[[PolicyLayout], Policy],
        seed: int,
        *,
        delay_steps: int = 0,
        noise: float = 0.0,
        **options,
    ) -> None:
        env = ArmBatch(task, NUM_ENVS, num_threads=1, seed=seed, **options)
        scripts = [script(env.layout) for _ in range(NUM_ENVS)]
        rng = np.random.default_rng(seed)
        observation = env.reset()
        self.starts = observation[:, :3]
        pending = [np.zeros((NUM_ENVS, env.layout.action_dim))] * delay_steps
        inside, self.states, self.diagnostics = [], [], []
        truncated = False
        while not truncated:
            seen = observation.copy()
            seen[:, :3] += noise * rng.standard_normal((NUM_ENVS, 3))
            pending.append(np.array([s.act(x) for s, x in zip(scripts, seen, strict=True)]))
            result = env.step(pending.pop(0))
            observation, truncated = result.observation, result.truncated
            inside.append(result.success)
            self.states.append(observation)
            self.diagnostics.append(env.diagnostics())
        self.states = np.array(self.states)
        self.inside = np.array(inside)
        self.layout = env.layout
        self.success_step = first_success_step(env.layout, self.inside)

    def figure(self, name: str) -> np.ndarray:
        """One figure of the diagnostics. Shape (steps, NUM_ENVS)."""
        return np.array([getattr(d, name) for d in self.diagnostics])
