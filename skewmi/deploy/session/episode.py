"""The moving part of an episode: to the start pose, then the policy, one cycle per robot state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.session.hand_follower import HandFollower
from skewmi.deploy.session.observer import ArmState, Observer
from skewmi.deploy.session.pace import action_cycles
from skewmi.deploy.session.robot_client import LateChunkError
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.wire.messages import JointStates, encode_joint_states
from skewmi.errors import CommandRefusedError
from skewmi.hand_command import integrate_command
from skewmi.policy_io import Array, Policy, inside_region
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS

START_ATTEMPTS = 3
"""Start motions after one that was late and therefore stopped half-way."""

RESYNCS = 10
"""How often per episode the arm may come to rest because its commands were late."""

REACHED = 0.02
"""Largest joint error at which the start pose counts as reached, rad."""


@dataclass(frozen=True)
class PolicyEnd:
    """How the policy's part of an episode ended."""

    success: bool
    steps: int
    """Control steps that the policy was asked for."""
    observation: Array
    held_back: int
    """Cycles in which the planner braked instead of following, e.g. at the edge of the box."""
    held_back_reason: str


class EpisodeRunner:
    """Runs start motions and policies on a stream.

    Args:
        policy: What decides.
        planner: Plans hand motion.
        observer: Where states come from.
        stream: Where chunks go to.
        times: Stage times.
        limits: That start motions keep.
        speed: 1 for the speed of training; less stretches every control step, to whole cycles.
        supervise: Called every cycle with the newest state; raises to stop, and
            `LateChunkError` if the robot server refused a chunk for being late.
        resync: Waits until the arm rests; gives where the server holds it and the newest state.
        publish_policy: Called with encoded observation and action after every control step, and
            with the observation that ended the episode, and None.
        publish_gripper: Called with an opening, m.
    """

    def __init__(
        self,
        policy: Policy,
        planner: Planner,
        observer: Observer,
        stream: ChunkStream,
        times: CycleTimes,
        limits: JointLimits,
        *,
        speed: float,
        supervise: Callable[[ArmState], None],
        resync: Callable[[], tuple[Array, ArmState]],
        publish_policy: Callable[[bytes, bytes | None], None],
        publish_gripper: Callable[[float], None],
    ) -> None:
        self._policy = policy
        self._layout = policy.layout
        self._planner = planner
        self._observer = observer
        self._stream = stream
        self._times = times
        self._limits = limits
        self._supervise = supervise
        self._resync = resync
        self._publish_policy = publish_policy
        self._publish_gripper = publish_gripper
        self._action_cycles = action_cycles(self._layout.control_dt, speed)
        self._action_names = tuple(field.name for field in self._layout.action)
        self._scale = self._layout.action_scale
        self.steps = 0
        """Control steps of the present or last episode."""

    def move_to(self, q_commanded: Array, q_goal: Array, state: ArmState) -> ArmState:
        """Move in joint space and wait until the arm is there.

        Args:
            q_commanded: Where the robot server holds the arm, rad. Shape (7,).
            q_goal: Where to go, rad. Shape (7,).
            state: Newest state.

        Returns:
            The newest state, with the arm at rest at `q_goal`.

        Raises:
            LimitViolationError: The way breaks a limit.
            CommandRefusedError: The arm did not arrive.
        """
        q = q_commanded
        for _ in range(START_ATTEMPTS):
            state, q, arrived = self._try_move(q, q_goal, state)
            if arrived:
                error = float(np.abs(state.q - q_goal).max())
                if error > REACHED:
                    raise CommandRefusedError(
                        f"the arm stands {error:.3f} rad from the start configuration; "
                        f"at most {REACHED} rad are allowed: is something in its way, or were "
                        "commands lost?"
                    )
                return state
        raise CommandRefusedError(f"{START_ATTEMPTS} start motions came too late; is the CPU free?")

    def _try_move(self, q: Array, q_goal: Array, state: ArmState) -> tuple[ArmState, Array, bool]:
        """One attempt; gives up, braking, when a chunk would be late."""
        stream = self._stream
        motion = StartMotion(q, q_goal, self._limits)
        stream.begin(q, state.stamp_ns)
        cycle, late, rest_ns = 0, False, 1 << 62
        while True:
            assert stream.sent is not None
            if cycle >= motion.cycles or late:
                rest_ns = min(rest_ns, stream.rest_ns)
            if state.stamp_ns >= rest_ns:
                return state, stream.sent.trajectory.q[-1], not late
            self._times.start(state.received_ns)
            self._observer.check_scene()
            for splice in () if late else stream.due(state.stamp_ns, state.received_ns):
                # Braking has begun: this motion cannot be taken up again, another one can.
                if splice != CYCLE_TICKS:
                    late = True
                    break
                chunk = motion.chunk(cycle)
                self._times.lap("plan")
                stream.send(chunk)
                cycle += 1
            self._times.stop()
            state = self._observer.next_state()
            try:
                self._supervise(state)
            except LateChunkError:
                q, state = self._resync()
                return state, q, False

    def run_policy(self, q_start: Array, state: ArmState) -> PolicyEnd:
        """Let the policy command the hand until success or the end of the episode's time.

        Args:
            q_start: Where the robot server holds the arm, rad. Shape (7,).
            state: Newest state.

        Raises:
            SkewmiError: Whatever stops an episode; nothing has been sent since.
        """
        layout, observer, stream, times = self._layout, self._observer, self._stream, self._times
        planner, policy = self._planner, self._policy
        workspace = layout.workspace
        assert workspace is not None
        self.steps = 0
        policy.reset()
        planner.reset(q_start)
        stream.begin(q_start, state.stamp_ns)
        control_s = self._action_cycles * CYCLE_NS / 1e9
        opening = workspace.gripper_opening
        step, held, wait, resyncs, held_back, reason = 0, 0, 0, 0, 0, ""
        waiting = False
        follower = HandFollower(layout, observer, stream, state)
        while True:
            times.start(state.received_ns)
            observer.check_scene()
            for splice in stream.due(state.stamp_ns, state.received_ns):
                # After a late cycle the next action is due as much sooner.
                wait -= splice // CYCLE_TICKS
                acts = wait < 0
                if acts:
                    wait = max(0, wait + self._action_cycles)
                    hand = observer.hand_position(state)
                    observation = observer.observation(state, hand, step)
                    times.lap("observe")
                    held = held + 1 if step and bool(inside_region(layout, observation)) else 0
                    success = held >= layout.success_hold_steps
                    if success or step == layout.episode_steps:
                        # What decided the outcome belongs to the record, too.
                        self._publish_step(state.stamp_ns, observation)
                        return PolicyEnd(success, step, observation, held_back, reason)
                    action = policy.act(observation)
                    times.lap("policy")
                    command = planner.command_position
                    ahead = follower.ahead(state, command)
                    stall = follower.stall_of_step(state, ahead, command)
                    target = integrate_command(layout, command, action, ahead, stall)
                    # Lag costs a policy more than a cut corner: with corners kept, 93 of 100
                    # deployed episodes succeeded instead of 99.
                    planner.set_target(target, control_s, at_once=True)
                    waiting = False
                    step += 1
                    self.steps = step
                elif not waiting and follower.must_wait(state, target):
                    # As in training, the command ends where the hand no longer follows it.
                    planner.set_target(follower.commanded(state), CYCLE_NS / 1e9, at_once=True)
                    waiting = True
                chunk = planner.step(splice)
                times.lap("plan")
                stream.send(chunk)
                if planner.held_back is not None:
                    held_back += 1
                    reason = planner.held_back
                if acts:
                    if layout.action_dim > 3:
                        travel = float(np.clip(action[3], -1.0, 1.0)) * self._scale[3]
                        opening = float(np.clip(opening + travel, 0.0, 0.025))
                        self._publish_gripper(opening)
                    self._publish_step(state.stamp_ns, observation, action)
                    times.lap("record")
            times.stop()
            state = observer.next_state()
            try:
                self._supervise(state)
            except LateChunkError:
                resyncs += 1
                if resyncs > RESYNCS:
                    raise
                q, state = self._resync()
                planner.reset(q)
                stream.begin(q, state.stamp_ns)

    def _publish_step(self, stamp_ns: int, observation: Array, action: Array | None = None) -> None:
        layout = self._layout
        seen = _encode(stamp_ns, layout.observation_names, observation)
        done = None if action is None else _encode(stamp_ns, self._action_names, action)
        self._publish_policy(seen, done)


def _encode(stamp_ns: int, names: tuple[str, ...], values: Array) -> bytes:
    nothing = values[:0]
    return encode_joint_states(JointStates(stamp_ns, names, values, nothing, nothing))
