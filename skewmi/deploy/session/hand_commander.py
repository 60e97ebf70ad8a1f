"""The commanded hand of a deployed policy: the actions of training, handed to the planner."""

from __future__ import annotations

from skewmi.command_integrator import CommandIntegrator
from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.session.arm_delay import ArmDelay
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.stream import ChunkStream
from skewmi.motion_under_way import LONGEST_REACTION_S, ErrorGrowth, hand_ahead
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import yumi


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
        self._growth = ErrorGrowth(1)
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
        hand_w = self._hand(state)
        commanded_w = self._commanded(state)
        self._growth.begin(commanded_w - hand_w, state.stamp_ns)
        ahead_w = hand_ahead(hand_w, commanded_w, self.integrator.position_w)
        self.integrator.begin_step(action[None], hand_w, ahead_w=ahead_w)
        self._planner.set_target(self.integrator.position_w[0], self._step_s)

    def watch(self, state: ArmState) -> None:
        """Let the command end where the hand does not follow it.

        Args:
            state: Newest arm state; call it with every one within a step.
        """
        hand_w, commanded_w = self._hand(state), self._commanded(state)
        since_ns = state.stamp_ns - self._step_stamp_ns
        coming_w = self._growth.coming(commanded_w - hand_w, state.stamp_ns, self._reaction_s)
        held = self.integrator.watch(
            hand_w, since_ns, commanded_w=commanded_w, coming_error_w=coming_w
        )
        if held.size:
            self._planner.hold(self.integrator.position_w[0])

    def _hand(self, state: ArmState) -> Array:
        """Measured hand, world, m. Shape (1, 3)."""
        return self._observer.hand_position(state)[None]

    def _commanded(self, state: ArmState) -> Array:
        """Where the hand was commanded to be as `state` shows it, world, m. Shape (1, 3)."""
        shown_ns = state.stamp_ns - self._delay.ns
        return self._observer.hand_of(self._stream.commanded(shown_ns))[None]
