"""From drawn transitions to a batch: goals relabelled, rewards recomputed."""

from __future__ import annotations

import numpy as np
import torch

from skewmi.policy_io import Array
from skewmi.train.inputs import InputNormalizer
from skewmi.train.replay import Index, Replay, Transitions
from skewmi.train.sac.sac import Batch


def relabel(
    drawn: Transitions,
    history: Replay,
    proposals: Array,
    future_fraction: float,
    proposal_fraction: float,
    generator: np.random.Generator,
) -> Array:
    """Goals of drawn transitions.

    A fraction gets a state reached later in its episode ("future", arXiv:1707.01495), a fraction
    one of the present proposals, and the rest keeps the one it was collected with.

    Args:
        drawn: Transitions.
        history: Where they came from.
        proposals: Present goals. Shape (k, goal_dim); without goals (goal_dim 0) there is
            nothing to relabel.
        future_fraction: Probability of the first kind.
        proposal_fraction: Probability of the second kind.
        generator: Of the random choices.

    Returns:
        Shape (n, goal_dim).
    """
    if drawn.goal.shape[1] == 0:
        return drawn.goal.astype(np.float64)
    n = len(drawn.step)
    kind = generator.random(n)[:, None]
    future = history.future_states(drawn.episode, drawn.step, generator)
    proposed = proposals[generator.integers(len(proposals), size=n)]
    goals: Array = np.where(
        kind < future_fraction,
        future,
        np.where(kind < future_fraction + proposal_fraction, proposed, drawn.goal),
    )
    return goals


def n_step_return(rewards: Array, length: Index, discount: float) -> Array:
    """sum_{k < length} discount^k rewards_k.

    Args:
        rewards: Shape (n, n_step).
        length: Integer. Shape (n,).
        discount: Per step.

    Returns:
        Shape (n,).
    """
    k = np.arange(rewards.shape[1])
    summed: Array = (rewards * np.where(k < length[:, None], discount**k, 0.0)).sum(1)
    return summed


def make_batch(
    drawn: Transitions,
    goals: Array,
    rewards: Array,
    inputs: InputNormalizer,
    *,
    discount: float,
    bootstrap_at_timeout: bool,
    device: torch.device,
) -> Batch:
    """Transitions with their new goals as tensors, rewards summed.

    Args:
        drawn: Transitions.
        goals: Of each. Shape (n, goal_dim).
        rewards: Of each of its steps, towards that goal. Shape (n, n_step).
        inputs: Of the networks.
        discount: Per step.
        bootstrap_at_timeout: Whether the end of an episode has a future.
        device: Of the tensors.
    """
    returns = n_step_return(rewards, drawn.length, discount)
    discounts = discount**drawn.length
    if not bootstrap_at_timeout:
        discounts = np.where(drawn.at_end, 0.0, discounts)
    return Batch(
        inputs=inputs(drawn.observation, goals).to(device),
        actions=torch.from_numpy(np.ascontiguousarray(drawn.action)).to(device),
        returns=torch.as_tensor(returns, dtype=torch.float32).to(device),
        next_inputs=inputs(drawn.next_observation, goals).to(device),
        discounts=torch.as_tensor(discounts, dtype=torch.float32).to(device),
    )
