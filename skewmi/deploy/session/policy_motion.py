"""The motion that a policy commands, from the start of an episode to its end."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.hand_commander import HandCommander
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.policy_topics import PolicyTopics
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import CycleTimes
from skewmi.policy_io import Array, Policy
from skewmi.smoothness import smoothness
from skewmi.success import inside_region
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS, GRID_S, JointTrajectory


class PolicyMotion:
    """A motion for the control loop: control steps until success or the end of the episode's time.

    Args:
        policy: What decides.
        planner: Plans hand motion.
        observer: Makes observations of states.
        stream: Knows what was commanded for a time not long ago.
        robot: Whose gripper is commanded, and how late its arm is.
        topics: Where observations and actions are published.
        times: Stage times.
        step_cycles: Planner cycles that a control step takes.

    Attributes:
        steps: Control steps that the policy was asked for in this episode.
        success: Whether the task is solved.
        observation: What decided the episode's outcome; empty before.
        held_back: Cycles in which the planner braked instead of following, e.g. at the edge of
            the box.
        held_back_reason: Why it did last.
    """

    steps: int
    success: bool
    observation: Array
    held_back: int
    held_back_reason: str

    def __init__(
        self,
        policy: Policy,
        planner: Planner,
        observer: Observer,
        stream: ChunkStream,
        robot: RobotClient,
        topics: PolicyTopics,
        times: CycleTimes,
        step_cycles: int,
        stiffness: Array | None = None,
    ) -> None:
        self._policy = policy
        self._layout = policy.layout
        self._planner = planner
        self._observer = observer
        self._robot = robot
        self._topics = topics
        self._times = times
        self._step_cycles, self._lead_ns = step_cycles, round(1e9 * stream.lead_s)
        step_s = step_cycles * CYCLE_NS / 1e9
        self.commander = HandCommander(
            policy.layout, planner, observer, stream, step_s, robot.delay, stiffness
        )
        """What the hand is commanded to; of the present or last episode."""
        self.forget()

    def forget(self) -> None:
        """Forget the last episode."""
        self.steps = 0
        self.success = False
        self.observation = np.zeros(0)
        self.held_back = 0
        self.held_back_reason = ""
        self._wait_cycles = 0
        self._held_steps = 0
        self._acted: tuple[Array, Array] | None = None
        self._begun = False
        self._chunk: JointTrajectory | None = None
        self._accelerations: list[Array] = []

    def begin(self, q: Array, state: ArmState) -> None:
        """See `Motion`: the first time the policy forgets, too."""
        del state
        self._planner.reset(q)
        self._chunk = None
        if self._begun:
            self.commander.resume()
            return
        self._begun = True
        self._observer.begin_episode()
        self._policy.reset()
        self.commander.start()

    def is_over(self, state: ArmState) -> bool:
        """The policy decides that when it is asked."""
        del state
        return False

    def next_chunk(self, state: ArmState, splice: int) -> JointTrajectory | None:
        """The next cycle of the commanded motion; None after the last control step."""
        # After a late cycle the next action is due as much sooner.
        self._wait_cycles -= splice // CYCLE_TICKS
        self._acted = None
        if acts := self._wait_cycles < 0:
            self._wait_cycles = max(0, self._wait_cycles + self._step_cycles)
            observation = self._observe(state)
            if self._is_decided(observation):
                # What decided the outcome belongs to the record, too.
                self._topics.publish(state.stamp_ns, observation)
                self.observation = observation
                return None
            self._act(state, observation)
        else:
            self.commander.watch(state)
        chunk = self._planner.step(splice)
        if self._chunk is not None:
            self._accelerations.append(self._chunk.a[:splice])
        self._chunk = chunk
        if self._planner.held_back is not None:
            self.held_back += 1
            self.held_back_reason = self._planner.held_back
        if acts and self.commander.opening is not None:
            # For when the chunk begins, and before it: it is what a robot in lock-step waits for.
            self._robot.open_gripper(self.commander.opening, state.stamp_ns + self._lead_ns)
        return chunk

    def after_sending(self, state: ArmState) -> None:
        """Publish the control step, if there was one."""
        if self._acted is None:
            return
        observation, action = self._acted
        self._topics.publish(state.stamp_ns, observation, action)
        self._times.lap("record")

    def smoothness(self) -> dict[str, float]:
        """Of the commanded motion so far: see `skewmi.smoothness`; empty if there was none."""
        if not self._accelerations:
            return {}
        return smoothness(np.concatenate(self._accelerations), GRID_S)

    def _observe(self, state: ArmState) -> Array:
        hand = self._observer.hand_position(state)
        observation = self._observer.observation(state, hand, self.steps)
        self._times.lap("observe")
        return observation

    def _is_decided(self, observation: Array) -> bool:
        """Whether the episode ends with this observation."""
        rewarded = self.steps > 0 and bool(inside_region(self._layout, observation))
        self._held_steps = self._held_steps + 1 if rewarded else 0
        self.success = self._held_steps >= self._layout.success_hold_steps
        return self.success or self.steps == self._layout.episode_steps

    def _act(self, state: ArmState, observation: Array) -> None:
        """Ask the policy, and command the hand for a control step."""
        action = self._policy.act(observation)
        self._times.lap("policy")
        self.commander.begin_step(action, state)
        self.steps += 1
        self._acted = observation, action
