"""How much better actions were than expected: generalized advantage estimates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array


def advantages(
    rewards: Array,
    values: Array,
    next_values: Array,
    terminated: NDArray[np.bool_],
    truncated: NDArray[np.bool_],
    *,
    discount: float,
    trace_decay: float,
) -> Array:
    """Generalized advantage estimates (arXiv:1506.02438), of the step and of those that follow.

        A_t = sum_k (gamma lambda)^k delta_{t+k},  delta_t = r_t + gamma V(s_{t+1}) - V(s_t)

    The sum ends with the episode. After a terminal state there is nothing, so its value does not
    count; after a time limit there would have been more, so the value of the state that was cut
    off does.

    Args:
        rewards: After each step. Shape (n, steps).
        values: Of the state before each step. Shape (n, steps).
        next_values: Of the state after each step, in the same episode. Shape (n, steps).
        terminated: Whether the task ended there. Shape (n, steps).
        truncated: Whether only the time did. Shape (n, steps).
        discount: gamma, per step.
        trace_decay: lambda.

    Returns:
        Shape (n, steps). The last column looks no further ahead, whatever its flags say.
    """
    delta = rewards + discount * np.where(terminated, 0.0, next_values) - values
    goes_on = ~(terminated | truncated)
    result = np.empty_like(delta)
    following = np.zeros(len(delta))
    for t in reversed(range(delta.shape[1])):
        following = delta[:, t] + discount * trace_decay * goes_on[:, t] * following
        result[:, t] = following
    return result


def explained_variance(values: Array, returns: Array) -> float:
    """1 - Var(returns - values) / Var(returns): 1 is a perfect value, 0 as good as a constant."""
    variance = float(returns.var())
    return 0.0 if variance == 0.0 else 1.0 - float((returns - values).var()) / variance
