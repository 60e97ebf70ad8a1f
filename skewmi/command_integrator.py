"""From actions to the commanded hand: one class, the same in simulation and deployment.

An action moves the commanded position by up to one action scale per axis, on a line that takes a
control step. The command stays in the workspace box, and close to the hand: an arm that cannot
follow would otherwise build up force against whatever holds it, as far as its servos can. Its
distance from the hand is the following error, measured in full actions.

- A hand that follows may have an error of `Workspace.free_following_error`.
- A hand that is blocked may have one of `held_following_error` from the next step on, until it
  moves again: a blockage is remembered, or a command that has come back would lunge again.
- Within a step, whoever moves the command looks every 20 ms (`CommandIntegrator.watch`), and the
  line ends where the blockage exceeds `stop_blockage`.

These bound a force by a distance, for the arm of training. An arm that is known to be softer has
to be commanded further ahead for the same force: its following errors are multiplied by its
stiffness relative to that arm (`robot_models.hand_stiffness`) before they are measured.

Numpy only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout, Workspace

EXPLAINED_DELAY = 0.4
"""Delay of an arm behind its command that is not taken for an obstacle, control steps. With those
of 0.1 s it is 40 ms, as late as users of ABB's externally guided motion report tuned arms to be
(abb_libegm, issue 49); with 0.47 and more the first contact would see an error of a full action."""
FADING = 0.8
"""Of a remembered blockage per control step."""
SOFTEST = 3.0
"""How much further ahead than in training a soft arm may be commanded at most."""
NOTICED_BLOCKAGE = 0.6
"""Fraction of `held_following_error` from which on a blockage lowers the bound on the following
error; at all of it that is `held_following_error`, so that pushing on settles there."""


def present_blockage(
    layout: PolicyLayout,
    following_error_w: Array,
    hand_travel_w: Array,
    stiffness: Array | None = None,
) -> Array:
    """How far the hand is behind its command by more than a delay explains, in full actions.

    A late arm is behind its command as well, but it moves: |error| - delay |travel|.

    Args:
        layout: Gives the scale of actions.
        following_error_w: Commanded less measured hand position, m. Shape (..., 3).
        hand_travel_w: Motion of the measured hand in a control step, m. Shape (..., 3).
        stiffness: Of the hand relative to training's. Shape (3, 3); None for that of training.

    Returns:
        Shape (...); negative where the hand follows.
    """
    scale = layout.action_scale[:3]
    behind = _length(following_error_w / scale, scale, stiffness)
    travel: Array = np.linalg.norm(hand_travel_w / scale, axis=-1)
    return behind - EXPLAINED_DELAY * travel


def remembered_blockage(
    layout: PolicyLayout,
    blockage_before: Array,
    following_error_w: Array,
    hand_travel_w: Array,
    stiffness: Array | None = None,
) -> Array:
    """The present blockage, or what is left of the last ones: they fade, faster if the hand moves.

    Args:
        layout: Gives the scale of actions.
        blockage_before: What this function gave at the last control step, or the largest blockage
            that has ended a line since; 0 at first. Shape (...).
        following_error_w: Commanded less measured hand position, m. Shape (..., 3).
        hand_travel_w: Motion of the measured hand in the last control step, m. Shape (..., 3).
        stiffness: See `present_blockage`.

    Returns:
        In full actions. Shape (...).
    """
    travel: Array = np.linalg.norm(hand_travel_w / layout.action_scale[:3], axis=-1)
    present = present_blockage(layout, following_error_w, hand_travel_w, stiffness)
    remembered: Array = np.maximum(present, FADING * blockage_before - travel)
    return np.maximum(remembered, 0.0)


def next_position(
    layout: PolicyLayout,
    position_w: Array,
    action: Array,
    hand_w: Array,
    blockage: Array | float,
    stiffness: Array | None = None,
) -> Array:
    """Next commanded hand: the action added, clipped to following error and workspace box.

    Args:
        layout: Gives scale, box and following errors; must have a workspace.
        position_w: Present commanded position, world, m. Shape (..., 3).
        action: In [-1, 1] (clipped here). Shape (..., action_dim); the first three components
            are the velocity x, y, z.
        hand_w: Measured hand position, world, m. Shape (..., 3).
        blockage: From `remembered_blockage`. Shape (...).
        stiffness: See `present_blockage`.

    Returns:
        Commanded position at the end of the coming control step, world, m. Shape (..., 3).

    Raises:
        ConfigurationError: The layout has no workspace.
    """
    workspace = _workspace_of(layout)
    scale = layout.action_scale[:3]
    free, held = workspace.free_following_error, workspace.held_following_error
    noticed = np.clip((blockage / held - NOTICED_BLOCKAGE) / (1.0 - NOTICED_BLOCKAGE), 0.0, 1.0)
    bound = free + noticed * (held - free)
    error = (position_w - hand_w) / scale + np.clip(action[..., :3], -1.0, 1.0)
    length = _length(error, scale, stiffness)
    error = error * np.minimum(1.0, bound / np.maximum(length, 1e-12))[..., None]
    position: Array = np.clip(hand_w + error * scale, workspace.low, workspace.high)
    return position


def _length(error: Array, scale: Array, stiffness: Array | None) -> Array:
    """Of following errors in full actions: by the force, as training's arm would have them.

    Never more than they are, and never less than a third: wrong constants can do no more.
    Shape (..., 3) -> (...).
    """
    length: Array = np.linalg.norm(error, axis=-1)
    if stiffness is None:
        return length
    felt = np.linalg.norm((error * scale) @ stiffness.T / scale, axis=-1)
    bounded: Array = np.clip(felt, length / SOFTEST, length)
    return bounded


class CommandIntegrator:
    """The commanded hands of `n` arms, from one control step to the next.

    `begin_step` lays a line for a control step; `watch` ends it where the hand does not follow.
    Who follows the line, and how, is the caller's business.

    Args:
        layout: Gives scale, box, following errors and the length of a step; must have a workspace.
        gripper_travel: Travel of a finger from closed to open, m.
        stiffness: Of the hand relative to training's, world axes; see
            `robot_models.hand_stiffness`. Shape (3, 3); None for that of training.

    Attributes:
        position_w: Commanded hand at the end of the line, world, m. Shape (n, 3).
        begin_w: Where the line begins. Shape (n, 3).
        opening: Commanded travel of each finger from closed at the end of the step, m. Shape (n,).
        opening_before: The same at its beginning. Shape (n,).
        blockage: What is remembered, full actions. Shape (n,).

    Raises:
        ConfigurationError: The layout has no workspace.
    """

    position_w: Array
    begin_w: Array
    opening: Array
    opening_before: Array
    blockage: Array

    def __init__(
        self, layout: PolicyLayout, gripper_travel: float, stiffness: Array | None = None
    ) -> None:
        self._stiffness = stiffness
        self._layout, self._workspace = layout, _workspace_of(layout)
        self._gripper_travel = gripper_travel
        self._step_ns = round(layout.control_dt * 1e9)

    @property
    def moves_gripper(self) -> bool:
        """Whether the actions have a component for the fingers; else they keep their opening."""
        return self._layout.action_dim == 4

    def start(self, position_w: Array) -> None:
        """Command the hands to where they are, the fingers to the layout's opening; forget all.

        Args:
            position_w: World, m. Shape (n, 3).
        """
        n = len(position_w)
        self.blockage = np.zeros(n)
        self.opening = np.full(n, self._workspace.gripper_opening)
        self.opening_before = self.opening
        self._hand_w: Array | None = None
        self.resume(position_w)

    def resume(self, position_w: Array) -> None:
        """Go on from elsewhere, without a line; fingers and blockages are as they were.

        Args:
            position_w: World, m. Shape (n, 3).
        """
        self.position_w = np.array(position_w, dtype=np.float64)
        self.begin_w = self.position_w
        self._moving = np.zeros(len(position_w), dtype=np.bool_)

    def begin_step(self, action: Array, hand_w: Array, *, ahead_w: Array | None = None) -> None:
        """Lay the line of the coming control step.

        Args:
            action: In [-1, 1], clipped here. Shape (n, action_dim).
            hand_w: Measured hand, world, m. Shape (n, 3).
            ahead_w: Where that hand will be when this step's line begins, as far as it follows:
                for a caller whose arm still has commanded motion to make when it is measured,
                which would count as following error. Without it, it is `hand_w`. Shape (n, 3).
        """
        hand_w = np.array(hand_w, dtype=np.float64)
        travel_w = hand_w - (hand_w if self._hand_w is None else self._hand_w)
        near_w = hand_w if ahead_w is None else ahead_w
        layout = self._layout
        self.blockage = remembered_blockage(
            layout, self.blockage, self.position_w - near_w, travel_w, self._stiffness
        )
        self.begin_w, self.opening_before = self.position_w, self.opening
        self.position_w = next_position(
            layout, self.begin_w, action, near_w, self.blockage, self._stiffness
        )
        if self.moves_gripper:
            travel = np.clip(action[:, 3], -1.0, 1.0) * layout.action_scale[3]
            self.opening = np.clip(self.opening_before + travel, 0.0, self._gripper_travel)
        self._moving = np.ones(len(action), dtype=np.bool_)
        self._hand_w = self._seen_w = hand_w
        self._seen_ns = 0

    def watch(
        self,
        hand_w: Array,
        since_ns: int,
        *,
        commanded_w: Array | None = None,
        coming_error_w: Array | float = 0.0,
    ) -> NDArray[np.int64]:
        """End the lines of hands that are blocked, where they are commanded to be now.

        Call it with every look at the hands within a step, some 20 ms after the last one: a
        blockage is judged by the motion between the two.

        Args:
            hand_w: Measured hand, world, m. Shape (n, 3).
            since_ns: Time from the measurement that `begin_step` got to this one, ns. What is not
                newer than the last one is not looked at.
            commanded_w: Where the hand was commanded to be when it was measured, for a caller
                whose commands take time; clipped to the box where a line ends. Without it, it is
                the line's point after `since_ns`. Shape (n, 3).
            coming_error_w: What will be added to the following error before the end of a line
                shows in the hand's command, m: for the same caller, or it would always end too
                late. Shape (n, 3).

        Returns:
            Indices of the arms whose line has ended with this call.
        """
        elapsed_ns = since_ns - self._seen_ns if self._moving.any() else 0
        if elapsed_ns <= 0:
            return np.empty(0, dtype=np.int64)
        hand_w = np.array(hand_w, dtype=np.float64)
        if commanded_w is None:
            done = min(since_ns / self._step_ns, 1.0)
            commanded_w = self.begin_w + done * (self.position_w - self.begin_w)
        travel_w = (hand_w - self._seen_w) * (self._step_ns / elapsed_ns)
        self._seen_w, self._seen_ns = hand_w, since_ns
        error_w = commanded_w - hand_w + coming_error_w
        blockage = present_blockage(self._layout, error_w, travel_w, self._stiffness)
        # A command that comes back to the hand shall do so.
        away = np.linalg.norm(self.position_w - hand_w, axis=1)
        away -= np.linalg.norm(commanded_w - hand_w, axis=1)
        stops = self._moving & (away > 0.0) & (blockage > self._workspace.stop_blockage)
        held = np.flatnonzero(stops)
        if held.size:
            self._moving[held] = False
            self.blockage[held] = np.maximum(self.blockage[held], blockage[held])
            self.position_w = self.position_w.copy()
            self.position_w[held] = np.clip(
                commanded_w[held], self._workspace.low, self._workspace.high
            )
        return held


def _workspace_of(layout: PolicyLayout) -> Workspace:
    if layout.workspace is None:
        raise ConfigurationError(f"task {layout.task!r} has no workspace to command a hand in")
    return layout.workspace
