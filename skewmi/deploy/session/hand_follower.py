"""Whether the hand follows its command while a policy acts, and where it is about to be."""

from __future__ import annotations

import numpy as np

from skewmi.command_integrator import remembered_stall, stalled
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.stream import ChunkStream
from skewmi.policy_io import Array, PolicyLayout

FOLLOWING, NOT_FOLLOWING = 0.005, 0.010
"""Distances of measured from commanded hand up to which, and from which on, the arm counts as
following and as held up, m; linear between."""


class HandFollower:
    """Compares measured with commanded hand, control step by step and cycle by cycle.

    Args:
        layout: Of the policy; must have a workspace.
        observer: Gives hand positions of joint angles.
        stream: Knows what was commanded for a time not long ago.
        state: Newest arm state; the arm rests.
    """

    def __init__(
        self, layout: PolicyLayout, observer: Observer, stream: ChunkStream, state: ArmState
    ) -> None:
        assert layout.workspace is not None
        self._layout, self._stop_lead = layout, layout.workspace.stop_blockage
        self._observer, self._stream = observer, stream
        self._of_step = self._of_cycle = observer.hand_position(state)
        self._stamp_ns = state.stamp_ns
        self._stall = 0.0

    def commanded(self, state: ArmState) -> Array:
        """Where the hand was commanded to be when `state` was measured, world, m. Shape (3,)."""
        return self._observer.hand_of(self._stream.commanded(state.stamp_ns))

    def stall_of_step(self, state: ArmState, ahead_w: Array, command_w: Array) -> float:
        """See `hand_command.remembered_stall`; call it once per control step.

        Args:
            state: Newest arm state.
            ahead_w: From `ahead`, world, m. Shape (3,).
            command_w: Present end of the commanded motion, world, m. Shape (3,).

        Returns:
            Full actions.
        """
        hand = self._observer.hand_position(state)
        travel, self._of_step = hand - self._of_step, hand
        self._stall = float(
            remembered_stall(self._layout, np.array(self._stall), command_w - ahead_w, travel)
        )
        return self._stall

    def ahead(self, state: ArmState, command_w: Array) -> Array:
        """Where the measured hand will be once it has made the motion that is under way.

        `integrate_command` bounds how far the command runs ahead of the hand. In training the
        hand is measured when the command is given; here about 0.1 s of commanded motion (the
        stream's lead, the planner's shaping) is still to come when the policy acts, and would
        count as lead.
        So that motion is added, as long as the arm follows. An arm that is held up does not
        follow: then the bound is on command against measured hand, as it should be.

        Args:
            state: Newest arm state.
            command_w: Present end of the commanded motion, world, m. Shape (3,).

        Returns:
            World, m. Shape (3,).
        """
        hand, commanded = self._observer.hand_position(state), self.commanded(state)
        deviation = float(np.linalg.norm(hand - commanded))
        trust = (NOT_FOLLOWING - deviation) / (NOT_FOLLOWING - FOLLOWING)
        ahead: Array = hand + min(max(trust, 0.0), 1.0) * (command_w - commanded)
        return ahead

    def must_wait(self, state: ArmState, target_w: Array) -> bool:
        """Whether the command must end here: the hand is held up, and it would go further away.

        Args:
            state: Newest arm state; call it with every new one.
            target_w: Where the command goes, world, m. Shape (3,).
        """
        hand = self._observer.hand_position(state)
        elapsed_s = (state.stamp_ns - self._stamp_ns) / 1e9
        if elapsed_s <= 0.0:
            return False
        travel = (hand - self._of_cycle) * (self._layout.control_dt / elapsed_s)
        self._of_cycle, self._stamp_ns = hand, state.stamp_ns
        error = self.commanded(state) - hand
        further = float(np.linalg.norm(target_w - hand)) > float(np.linalg.norm(error))
        stall = float(stalled(self._layout, error, travel))
        if stall <= self._stop_lead:
            return False
        self._stall = max(self._stall, stall)
        return further
