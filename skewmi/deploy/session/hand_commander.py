"""The commanded hand of a deployed policy: the actions of training, handed to the planner."""

from __future__ import annotations

import numpy as np

from skewmi.command_integrator import CommandIntegrator
from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.session.arm_delay import ArmDelay
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.stream import ChunkStream
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import yumi

FOLLOWING, NOT_FOLLOWING = 0.005, 0.010
"""Distances of measured from commanded hand up to which, and from which on, the arm counts as
following and as blocked, m; linear between."""


LONGEST_REACTION_S = 0.05
"""What is looked ahead by at most, s: with more, an arm that is late looks like a blocked one."""


class HandCommander:
    """Integrates actions by what is measured of the hand, and sets the planner's targets.

    Planning and sending take time: when a state is measured, some 0.1 s of commanded motion (the
    stream's lead, the planner's shaping) is still to come. In training there is none. All that is
    said of it here is where the hand was commanded to be at that time, and where it is about to
    be; the rest is `CommandIntegrator`'s. An arm that shows its commands late (ABB's controllers
    take some 20 ms) is compared with what it was commanded that much earlier: late is not blocked.

    Args:
        layout: Of the policy; must have a workspace.
        planner: Plans hand motion.
        observer: Gives hand positions of joint angles.
        stream: Knows what was commanded for a time not long ago.
        step_s: How long a control step takes: longer than in training for a slowed-down one, s.
        delay: Of the arm behind its commands.
        stiffness: Of the hand relative to training's, if it is known; see `CommandIntegrator`.
            Shape (3, 3).
    """

    def __init__(
        self,
        layout: PolicyLayout,
        planner: Planner,
        observer: Observer,
        stream: ChunkStream,
        step_s: float,
        delay: ArmDelay,
        stiffness: Array | None = None,
    ) -> None:
        self.integrator = CommandIntegrator(layout, yumi.GRIPPER.travel, stiffness)
        self._planner, self._observer, self._stream = planner, observer, stream
        self._step_s = step_s
        self._delay = delay
        self._step_stamp_ns = 0
        self._seen = (np.zeros(3), 0)
        reaction_s = stream.lead_s + planner.hand_bounds.stopping_s
        self._reaction_s = min(reaction_s, LONGEST_REACTION_S)

    @property
    def opening(self) -> float | None:
        """Commanded travel of each finger from closed, m; None if the policy does not move them."""
        return float(self.integrator.opening[0]) if self.integrator.moves_gripper else None

    def start(self) -> None:
        """Begin an episode where the planner, just reset, rests."""
        self.integrator.start(self._planner.command_position[None])

    def resume(self) -> None:
        """Go on where the planner, reset in the middle of an episode, rests."""
        self.integrator.resume(self._planner.command_position[None])

    def begin_step(self, action: Array, state: ArmState) -> None:
        """Command the coming control step.

        Args:
            action: The policy's. Shape (action_dim,).
            state: Newest arm state, which the policy has seen.
        """
        self._step_stamp_ns = state.stamp_ns
        hand_w = self._observer.hand_position(state)
        commanded_w = self._commanded(state)
        self._seen = (commanded_w - hand_w, state.stamp_ns)
        ahead_w = self._ahead(hand_w, commanded_w)
        self.integrator.begin_step(action[None], hand_w[None], ahead_w=ahead_w[None])
        self._planner.set_target(self.integrator.position_w[0], self._step_s)

    def watch(self, state: ArmState) -> None:
        """Let the command end where the hand does not follow it.

        Args:
            state: Newest arm state; call it with every one within a step.
        """
        hand_w, commanded_w = self._observer.hand_position(state), self._commanded(state)
        since_ns = state.stamp_ns - self._step_stamp_ns
        held = self.integrator.watch(
            hand_w[None],
            since_ns,
            commanded_w=commanded_w[None],
            coming_error_w=self._coming_error(hand_w, commanded_w, state.stamp_ns)[None],
        )
        if held.size:
            self._planner.hold(self.integrator.position_w[0])

    def _coming_error(self, hand_w: Array, commanded_w: Array, stamp_ns: int) -> Array:
        """What the following error grows by before a command that is ended now slows the hand
        down, if it goes on as since the last look.

        Args:
            hand_w: Measured, world, m. Shape (3,).
            commanded_w: Where it was commanded to be then. Shape (3,).
            stamp_ns: When that was.

        Returns:
            World, m. Shape (3,).
        """
        error_before_w, before_ns = self._seen
        self._seen = (error_w, _) = (commanded_w - hand_w, stamp_ns)
        elapsed_s = 1e-9 * (stamp_ns - before_ns)
        if elapsed_s <= 0.0:
            return np.zeros(3)
        coming_w: Array = (error_w - error_before_w) * (self._reaction_s / elapsed_s)
        return coming_w

    def _commanded(self, state: ArmState) -> Array:
        """Where the hand was commanded to be as `state` shows it, world, m. Shape (3,)."""
        shown_ns = state.stamp_ns - self._delay.ns
        return self._observer.hand_of(self._stream.commanded(shown_ns))

    def _ahead(self, hand_w: Array, commanded_w: Array) -> Array:
        """Where the measured hand will be once it has made the motion that is under way.

        That motion is added as long as the arm follows. An arm that is blocked does not: then the
        bound is on command against measured hand, as it should be.

        Args:
            hand_w: Measured, world, m. Shape (3,).
            commanded_w: Where it was commanded to be then. Shape (3,).

        Returns:
            World, m. Shape (3,).
        """
        deviation = float(np.linalg.norm(hand_w - commanded_w))
        trust = (NOT_FOLLOWING - deviation) / (NOT_FOLLOWING - FOLLOWING)
        under_way_w = self.integrator.position_w[0] - commanded_w
        ahead_w: Array = hand_w + min(max(trust, 0.0), 1.0) * under_way_w
        return ahead_w
