"""Whether states lie in the reward region, and when an episode has succeeded; numpy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout


def inside_region(layout: PolicyLayout, state: Array) -> NDArray[np.bool_]:
    """Whether states lie in the reward region.

    Args:
        layout: Whose region.
        state: State or observation, shape (..., >= state_dim), fields in layout order.

    Returns:
        Shape (...). False everywhere if the layout has no region.
    """
    state = np.asarray(state, dtype=np.float64)
    if not layout.reward_region:
        return np.zeros(state.shape[:-1], dtype=np.bool_)
    names = layout.observation_names
    inside = np.ones(state.shape[:-1], dtype=np.bool_)
    for ball in layout.reward_region:
        square: Array | float = 0.0
        for name, centre in zip(ball.fields, ball.centre, strict=True):
            offset = state[..., names.index(name)] - centre
            square = square + offset * offset
        inside &= np.sqrt(square) <= ball.radius
    return inside


def first_success_step(layout: PolicyLayout, in_region: NDArray[np.bool_]) -> NDArray[np.int64]:
    """After how many steps an episode succeeded: the region held for `success_hold_steps`.

    Args:
        layout: Gives the number of consecutive steps that must end inside the region.
        in_region: Whether each step ended inside the region; row t is after step t + 1.
            Shape (n_steps, ...).

    Returns:
        Number of steps taken when the last of them was reached for the first time, at least
        `success_hold_steps`; -1 where that never happened. Shape (...).
    """
    in_region = np.asarray(in_region, dtype=np.bool_)
    held = np.zeros(in_region.shape[1:], dtype=np.int64)
    first = np.full(in_region.shape[1:], -1, dtype=np.int64)
    for step, inside in enumerate(in_region, start=1):
        held = np.where(inside, held + 1, 0)
        first = np.where((first < 0) & (held >= layout.success_hold_steps), step, first)
    return first


def episode_success(layout: PolicyLayout, in_region: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether episodes succeeded; arguments as `first_success_step`. Shape (...)."""
    success: NDArray[np.bool_] = first_success_step(layout, in_region) > 0
    return success
