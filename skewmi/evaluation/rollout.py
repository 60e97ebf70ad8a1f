"""Run a policy in a batched environment, and count how often it succeeds.

Needs numpy only, so that an ONNX file is evaluated without torch.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.batch_env import BatchEnv, StepResult
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, Policy, PolicyLayout, require_same_layout
from skewmi.success import first_success_step

Observer = Callable[[StepResult, int], None]
"""Called after every step with its result and how many of the environments count, the first ones:
all but in the last round. Whatever else it wants to know it asks the environment itself."""

Z_95 = 1.959963984540054
"""The 97.5 % point of the normal distribution: two-sided 95 % intervals."""


@dataclass(frozen=True)
class Episodes:
    """What happened. One column an episode; every episode has `episode_steps` steps.

    Attributes:
        layout: Of the environment.
        observation: What the policy saw before each step. Shape (n_steps, n, observation_dim).
        action: What it answered. Shape (n_steps, n, action_dim).
        in_region: Whether the step ended inside the reward region. Shape (n_steps, n).
        final_observation: After the last step. Shape (n, observation_dim).
    """

    layout: PolicyLayout
    observation: Array
    action: Array
    in_region: NDArray[np.bool_]
    final_observation: Array

    @property
    def first_success_step(self) -> NDArray[np.int64]:
        """See `success.first_success_step`. Shape (n,)."""
        return first_success_step(self.layout, self.in_region)

    @property
    def success(self) -> NDArray[np.bool_]:
        """Shape (n,)."""
        return self.first_success_step > 0


def run_episodes(
    policy: Policy,
    env: BatchEnv,
    episodes: int,
    seed: int,
    *,
    progress: Callable[[int, int], None] | None = None,
    observer: Observer | None = None,
) -> Episodes:
    """Run whole episodes, `env.num_envs` at a time; the surplus of the last round is dropped.

    The environment is seeded once, at the start; equal arguments give equal episodes.

    Args:
        policy: Whose layout must be the environment's.
        env: The task.
        episodes: How many to run.
        seed: Of the environment's random streams.
        progress: Called with (steps done, steps in all) after every step.
        observer: See `Observer`; it must not change the environment.

    Raises:
        ConfigurationError: `episodes` is below 1.
        LayoutMismatchError: The policy was made for another layout.
    """
    if episodes < 1:
        raise ConfigurationError(f"episodes is {episodes}; at least 1 is needed")
    require_same_layout(env.layout, policy.layout, "the policy")
    n_steps = env.layout.episode_steps
    rounds = math.ceil(episodes / env.num_envs)
    runs = []
    for round_index in range(rounds):
        observation = env.reset(seed) if round_index == 0 else env.reset()
        policy.reset()
        counted = min(env.num_envs, episodes - round_index * env.num_envs)
        seen, taken, inside = [], [], []
        for step in range(n_steps):
            action = policy.act(observation)
            result = env.step(action)
            seen.append(observation)
            taken.append(action)
            inside.append(result.success)
            observation = result.observation
            if observer is not None:
                observer(result, counted)
            if progress is not None:
                progress(round_index * n_steps + step + 1, rounds * n_steps)
        runs.append((np.stack(seen), np.stack(taken), np.stack(inside), observation))
    return Episodes(
        layout=env.layout,
        observation=np.concatenate([run[0] for run in runs], axis=1)[:, :episodes],
        action=np.concatenate([run[1] for run in runs], axis=1)[:, :episodes],
        in_region=np.concatenate([run[2] for run in runs], axis=1)[:, :episodes],
        final_observation=np.concatenate([run[3] for run in runs])[:episodes],
    )


def wilson_interval(successes: int, trials: int, z: float = Z_95) -> tuple[float, float]:
    """Confidence interval of a success probability that stays sensible at 0 and 100 %.

    (p + z^2/2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2/n), p = successes / trials
    (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927).

    Args:
        successes: In 0..trials.
        trials: At least 1.
        z: Half-width in standard deviations; the default gives 95 %.

    Returns:
        Lower and upper bound, in [0, 1].

    Raises:
        ConfigurationError: The numbers are not a count of successes.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ConfigurationError(f"{successes} successes of {trials} trials is not a count")
    p = successes / trials
    centre = p + z * z / (2 * trials)
    half = z * math.sqrt(p * (1.0 - p) / trials + z * z / (4 * trials * trials))
    scale = 1.0 + z * z / trials
    # Exact where rounding would give 1e-17.
    low = 0.0 if successes == 0 else (centre - half) / scale
    high = 1.0 if successes == trials else (centre + half) / scale
    return low, high


def summarise(episodes: Episodes) -> dict[str, object]:
    """Figures of an evaluation, JSON-serialisable.

    Returns:
        "episodes", "successes", "success_rate", "success_rate_interval_95" (Wilson),
        "first_success_step" and "first_success_time_s" (min, median, mean, max over successful
        episodes; None without any), "share_of_steps_in_region", and per state field
        "final_state" (min, mean, max, std over episodes, in the field's unit).
    """
    first = episodes.first_success_step
    successes, trials = int((first > 0).sum()), int(first.size)
    steps = first[first > 0]
    names = [field.name for field in episodes.layout.state_fields]
    return {
        "episodes": trials,
        "successes": successes,
        "success_rate": successes / trials,
        "success_rate_interval_95": list(wilson_interval(successes, trials)),
        "first_success_step": _spread(steps),
        "first_success_time_s": _spread(steps * episodes.layout.control_dt),
        "share_of_steps_in_region": float(episodes.in_region.mean()),
        "final_state": {
            name: _spread(column) | {"std": float(column.std())}
            for name, column in zip(
                names, episodes.final_observation[:, : len(names)].T, strict=True
            )
        },
    }


def _spread(values: NDArray[np.number]) -> dict[str, float | None]:
    if values.size == 0:
        return {"min": None, "median": None, "mean": None, "max": None}
    return {
        "min": float(values.min()),
        "median": float(np.median(values)),
        "mean": float(values.mean()),
        "max": float(values.max()),
    }
