"""From actions to the commanded hand position; the same in simulation and deployment.

An action moves the commanded position by up to one action scale per axis. The command stays in
the workspace box, and close to the hand: an arm that cannot follow would otherwise build up force
against whatever holds it, as far as its servos can. Distances between command and hand are
measured in full actions.

- A hand that follows may be led by `Workspace.free_following_error`.
- A hand that is held up may be led by `held_following_error` from the next step on, until it
  moves again: its stall is remembered, or a command that has come back would lunge again.
- Within a step, whoever moves the command looks every 20 ms and ends it where the stall exceeds
  `stop_blockage`.

Numpy only.
"""

from __future__ import annotations

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout

EXPLAINED_DELAY = 0.4
"""Delay of an arm behind its command that is not taken for an obstacle, control steps. With those
of 0.1 s it is 40 ms, as late as users of ABB's externally guided motion report tuned arms to be
(abb_libegm, issue 49); with 0.47 and more the first contact would lead by a full action."""
FADING = 0.8
"""Of a remembered stall per control step."""
NOTICED_STALL = 0.6
"""Share of `held_following_error` from which on a stall shortens the lead; at all of it the lead is
`held_following_error`, so that pushing on settles there."""


def stalled(layout: PolicyLayout, error_w: Array, hand_travel_w: Array) -> Array:
    """How far the hand is behind its command by more than a delay explains, in full actions.

    A late arm is behind its command as well, but it moves: |error| - delay |travel|.

    Args:
        layout: Gives the scale of actions.
        error_w: Commanded less measured hand position, m. Shape (..., 3).
        hand_travel_w: Motion of the measured hand in a control step, m. Shape (..., 3).

    Returns:
        Shape (...); negative where the hand follows.
    """
    scale = layout.action_scale[:3]
    behind: Array = np.linalg.norm(error_w / scale, axis=-1)
    travel: Array = np.linalg.norm(hand_travel_w / scale, axis=-1)
    return behind - EXPLAINED_DELAY * travel


def remembered_stall(
    layout: PolicyLayout, stall_before: Array, error_w: Array, hand_travel_w: Array
) -> Array:
    """The present stall, or what is left of the last ones: they fade, faster if the hand moves.

    Args:
        layout: Gives the scale of actions.
        stall_before: What this function gave at the last control step, or the largest stall
            since; 0 at first. Shape (...).
        error_w: Commanded less measured hand position, m. Shape (..., 3).
        hand_travel_w: Motion of the measured hand in the last control step, m. Shape (..., 3).

    Returns:
        In full actions. Shape (...).
    """
    travel: Array = np.linalg.norm(hand_travel_w / layout.action_scale[:3], axis=-1)
    present = stalled(layout, error_w, hand_travel_w)
    remembered: Array = np.maximum(present, FADING * stall_before - travel)
    return np.maximum(remembered, 0.0)


def integrate_command(
    layout: PolicyLayout,
    command_position_w: Array,
    action: Array,
    hand_position_w: Array,
    stall: Array | float,
) -> Array:
    """Next commanded hand position: the action added, clipped to lead and workspace box.

    Called once per control step with the same arguments in simulation and deployment.

    Args:
        layout: Gives scale, box and leads; must have a workspace.
        command_position_w: Present commanded position, world frame, m. Shape (..., 3).
        action: In [-1, 1] (clipped here). Shape (..., action_dim); the first three components
            are the velocity x, y, z.
        hand_position_w: Measured hand position, world frame, m. Shape (..., 3).
        stall: From `remembered_stall`. Shape (...).

    Returns:
        Commanded position at the end of the coming control step, m. Shape (..., 3).

    Raises:
        ConfigurationError: The layout has no workspace.
    """
    workspace = layout.workspace
    if workspace is None:
        raise ConfigurationError(f"task {layout.task!r} has no workspace to command a hand in")
    scale = layout.action_scale[:3]
    error_w = command_position_w - hand_position_w
    share = np.clip(
        (stall / workspace.held_following_error - NOTICED_STALL) / (1.0 - NOTICED_STALL), 0.0, 1.0
    )
    bound = workspace.free_following_error + share * (
        workspace.held_following_error - workspace.free_following_error
    )
    lead = error_w / scale + np.clip(action[..., :3], -1.0, 1.0)
    distance = np.linalg.norm(lead, axis=-1)
    lead = lead * np.minimum(1.0, bound / np.maximum(distance, 1e-12))[..., None]
    target: Array = np.clip(hand_position_w + lead * scale, workspace.low, workspace.high)
    return target
