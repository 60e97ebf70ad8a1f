"""The session: connects policy and robot server, episode by episode, and always ends at rest.

Nothing that goes wrong in an episode leaves `run`: it becomes a stop or a fault with its reason.
Stopping means to send nothing more; the chunk that the robot server accepted last ends at rest.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial

import numpy as np

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.report import DeployReport, EpisodeReport
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.deploy.session.episode import EpisodeRunner
from skewmi.deploy.session.observer import ArmState, Observer
from skewmi.deploy.session.pace import action_cycles, followed_speed, planning_limits
from skewmi.deploy.session.preflight import check_agreement, check_way, draw_start
from skewmi.deploy.session.robot_client import RobotClient, StopRequestedError
from skewmi.deploy.session.states import (
    SESSION_TABLE,
    STATUS_NAME,
    SessionEvent,
    SessionState,
)
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.state_machine import StateMachine, Transition
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import (
    ERROR,
    OK,
    WARN,
    Status,
    encode_status,
)
from skewmi.deploy.wire.transport import Link
from skewmi.errors import ConfigurationError, SkewmiError, TransportError
from skewmi.policy_io import Array, Policy
from skewmi.robot_models import yumi
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS

_log = logging.getLogger(__name__)

_WARM_CYCLES = 10


class Session:
    """Runs episodes of one policy on one robot server.

    Args:
        policy: What decides.
        options: How.
        link: An open session to the robot server.
        report: Filled in as the run goes on.
        stop: Set from outside to end the run with a smooth stop.
        on_event: Told in words what happens.

    Raises:
        LayoutMismatchError: The robot server is not what the policy was made for.
        ConfigurationError: The robot server's limits or pace differ.
        TransportError: No robot server answers.
    """

    def __init__(
        self,
        policy: Policy,
        options: DeployOptions,
        link: Link,
        report: DeployReport,
        stop: threading.Event,
        on_event: Callable[[str], None],
    ) -> None:
        self._options = options
        self._report = report
        self._stop = stop
        self._on_event = on_event
        self._clock_ns = 0
        self._status = link.publisher(topics.YUMI_STATUS)
        self._machine = StateMachine(SESSION_TABLE, self._on_transition)
        limits = planning_limits(options.limits, options.speed)
        self._robot = RobotClient(link, dry_run=options.dry_run)
        description = self._robot.describe(with_scene=True)
        if description.lock_step != options.lock_step:
            pace = {True: "in lock-step", False: "in real time"}
            raise ConfigurationError(
                f"the robot server runs {pace[description.lock_step]}, this run is to be "
                f"{pace[options.lock_step]}; give --lock-step to both or to none"
            )
        self._check_agreement = partial(
            check_agreement, policy.layout, options.robot_model_hash, limits
        )
        self._check_agreement(description)
        self._clock_ns = description.clock_ns
        self._stops = description.stops
        workspace = policy.layout.workspace
        assert workspace is not None
        self._workspace = workspace
        self._layout = policy.layout
        observations = link.publisher(topics.POLICY_OBSERVATION)
        actions = link.publisher(topics.POLICY_ACTION)
        self._observer = Observer(
            link,
            policy.layout,
            yumi.joint_names("right"),
            yumi.finger_names("right")[0],
            description.scene_fields,
            lock_step=options.lock_step,
            state_period_s=description.state_period_ns / 1e9,
            on_repeat=self._on_repeat,
        )
        self._limits = limits
        self._times = CycleTimes()
        self._checks = ChunkChecks(limits, workspace)
        self._stream = ChunkStream(
            self._robot.put_chunk,
            description.joint_names,
            self._checks.stages,
            self._times,
            lock_step=options.lock_step,
            lead_ns=round(options.lead_ms * 1e6),
        )

        planner = Planner(workspace, limits)
        hand_speed = planner.hand_bounds.speed
        followed = followed_speed(policy.layout, options.speed, hand_speed)
        cycles = action_cycles(policy.layout.control_dt, followed)
        speed = report.speed = policy.layout.control_dt * 1e9 / (cycles * CYCLE_NS)
        if speed < options.speed:
            why = "control steps take whole cycles of 20 ms"
            if followed < options.speed:
                why = f"limits {limits.name} allow the hand {1e3 * hand_speed:.0f} mm/s"
            report.notes.append(
                f"{why}: every control step takes {1.0 / speed:.1f} times as long as in training"
            )
            on_event(report.notes[-1])

        def publish_policy(observation: bytes, action: bytes | None) -> None:
            observations.put(observation)
            if action is not None:
                actions.put(action)

        self._runner = EpisodeRunner(
            policy,
            planner,
            self._observer,
            self._stream,
            self._times,
            limits,
            speed=speed,
            supervise=self._supervise,
            resync=self._resync,
            publish_policy=publish_policy,
            publish_gripper=self._open_gripper,
        )
        self._warm_up(policy, Planner(workspace, limits))
        self._fire(SessionEvent.CONNECTED, f"{description.backend} robot, {description.task}")

    def _warm_up(self, policy: Policy, planner: Planner) -> None:
        """Do once what every cycle does: first calls load code and build tables."""
        self._stream.warm_up()
        start = np.array(self._workspace.start_configuration)
        planner.reset(start)
        earlier = np.tile(start, (3, 1))
        planner.set_target(np.array(self._workspace.start) + 0.01, self._layout.control_dt)
        policy.reset()
        policy.act(np.zeros(self._layout.observation_dim))
        for cycle in range(_WARM_CYCLES):
            present = planner.present
            chunk = planner.step()
            self._checks.boxed = cycle % 2 == 0
            for _, check in self._checks.stages:
                check(chunk, present, earlier)
            earlier = chunk.q[CYCLE_TICKS - 3 : CYCLE_TICKS]

    @property
    def state(self) -> SessionState:
        return self._machine.state

    def run(self) -> None:
        """Run all episodes; what happened is in the report."""
        for index in range(self._options.episodes):
            if index > 0:
                self._fire(SessionEvent.NEXT_EPISODE, f"episode {index + 1}")
            with hot_loop(priority=not self._options.lock_step) as granted:
                go_on = self._episode(index)
            self._report.granted = granted
            if not go_on:
                break
        self._fire(SessionEvent.FINISH, "all episodes are over")
        report = self._report
        report.usage = self._stream.usage
        report.cycles = self._times.cycles
        report.cycle_ms = self._times.cycle_percentiles_ms()
        report.stage_ms = self._times.stage_percentiles_ms()
        report.missed_cycles = self._stream.missed_cycles
        report.interrupted = self._stop.is_set()

    def _episode(self, index: int) -> bool:
        """One episode; whether to go on with the next."""
        seed = int(np.random.SeedSequence([self._options.seed, index]).generate_state(1)[0])
        final, go_on = np.zeros(0), True
        self._runner.steps = 0
        try:
            self._checks.boxed = False
            state, q, q_goal = self._preflight(seed)
            self._fire(SessionEvent.READY, "hashes and limits agree, states are fresh, way is free")
            at_start = "dry run: the arm stays where it is"
            if not self._options.dry_run:
                state = self._runner.move_to(q, q_goal, state)
                q, at_start = q_goal, "the arm rests at the start"
            self._fire(SessionEvent.AT_START, at_start)
            self._checks.boxed = True
            end = self._runner.run_policy(q, state)
            final = end.observation
            reason = "the task is solved" if end.success else f"{end.steps} steps are used up"
            if end.held_back:
                reason += f"; held back for {end.held_back} cycles ({end.held_back_reason})"
            self._fire(SessionEvent.SUCCESS if end.success else SessionEvent.TIME_OVER, reason)
        except StopRequestedError as error:
            go_on = False
            self._fire(SessionEvent.STOP, str(error))
        except TransportError as error:
            go_on = False
            self._fire(SessionEvent.FAULT, str(error))
        except SkewmiError as error:
            self._fire(SessionEvent.STOP, str(error))
        except Exception as error:
            _log.exception("the cycle failed")
            go_on = False
            self._fire(SessionEvent.FAULT, f"{type(error).__name__}: {error}")
        outcome, reason = self._machine.state, self._machine.reason
        at_rest = None
        try:
            at_rest = self._robot.disarm()
        except SkewmiError as error:
            go_on = False
            outcome, reason = SessionState.FAULT, f"{reason}; then {error}"
            self._fire(SessionEvent.FAULT, reason)
        if at_rest is not None and at_rest.state == ServerState.FAULT.value:
            go_on = False
            if outcome is not SessionState.FAULT:
                outcome = SessionState.FAULT
                reason = f"{reason}; then the robot server is in fault: {at_rest.reason}"
                self._fire(SessionEvent.FAULT, reason)
        self._fire(SessionEvent.AT_REST, f"after {outcome.value}")
        steps = self._runner.steps
        words = "stopped" if outcome is SessionState.STOPPING else outcome.value
        if outcome in (SessionState.STOPPING, SessionState.FAULT):
            self._report.stops.append(reason)
        names = self._layout.observation_names[: len(final)]
        values = dict(zip(names, map(float, final), strict=True))
        contact = {} if at_rest is None else dict(at_rest.contact)
        self._report.episodes.append(
            EpisodeReport(index, words, reason, steps, seed, values, contact)
        )
        self._on_event(f"episode {index + 1}: {words} after {steps} steps ({reason})")
        return go_on and not self._stop.is_set()

    def _preflight(self, seed: int) -> tuple[ArmState, Array, Array]:
        """Armed robot server, way to the start checked, fresh states.

        Returns:
            The newest state, where the arm is held, and where the episode starts, rad.
        """
        self._check_interrupt()
        # Armed first: a scene that somebody else works in must not be reset.
        self._robot.arm()
        description = self._robot.describe()
        self._check_agreement(description)
        if description.simulated:
            self._robot.reset_scene(seed)
            description = self._robot.describe()
        if description.stops > self._stops:
            # Between two episodes a stop changes no state: nothing else tells of it.
            raise StopRequestedError("somebody has asked to stop since the last episode")
        self._clock_ns = description.clock_ns
        self._open_gripper(self._workspace.gripper_opening)
        q = np.array(description.commanded_position)
        q_goal = draw_start(self._workspace, seed, self._options.start_spread, q)
        check_way(q, q_goal, self._limits, self._checks)
        # Checking takes a while: what was fresh before is not any more.
        state = self._observer.fresh_state()
        self._check_interrupt()
        return state, q, q_goal

    def _supervise(self, state: ArmState) -> None:
        """Every cycle: has somebody asked to stop, and does the robot server still follow?"""
        self._clock_ns = state.stamp_ns
        self._check_interrupt()
        self._robot.check(late_is_final=self._options.lock_step)

    def _check_interrupt(self) -> None:
        if self._stop.is_set():
            raise StopRequestedError("interrupted")

    def _on_repeat(self) -> None:
        if self._machine.state in (SessionState.TO_START, SessionState.RUNNING):
            self._check_interrupt()
            self._robot.check(late_is_final=True)

    def _resync(self) -> tuple[Array, ArmState]:
        q = self._robot.wait_for_hold()
        self._stream.missed_cycles += 1
        state = self._observer.fresh_state()
        self._check_interrupt()
        return q, state

    def _open_gripper(self, opening: float) -> None:
        self._robot.open_gripper(opening, self._clock_ns)

    def _fire(self, event: SessionEvent, reason: str) -> None:
        self._machine.fire(event, reason, self._clock_ns)

    def _on_transition(self, transition: Transition[SessionState]) -> None:
        _log.info("%s", transition)
        level = {SessionState.FAULT: ERROR, SessionState.STOPPING: WARN}.get(transition.target, OK)
        values = {
            "state": transition.target.value,
            "reason": transition.reason,
            "from": transition.source.value,
            "event": transition.event,
        }
        message = f"{transition.target.value}: {transition.reason}"
        status = Status(transition.stamp_ns, STATUS_NAME, level, message, values)
        try:
            self._status.put(encode_status(status))
        except TransportError:
            _log.warning("cannot report %s", transition)
