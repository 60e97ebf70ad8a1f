"""One episode: preflight, the way to the start, the policy, and rest, whatever happens."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.report import EpisodeReport
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.deploy.session.approach import Approach
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.interrupt import StopRequestedError
from skewmi.deploy.session.policy_motion import PolicyMotion
from skewmi.deploy.session.preflight import Preflight
from skewmi.deploy.session.refused import LateChunkError, OutOfStepError
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.states import SessionEvent, SessionState
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.timing import BUSY_ADVICE
from skewmi.errors import SkewmiError, TransportError
from skewmi.policy_io import Array, PolicyLayout

RECOVERIES = 10
"""How often per episode the arm may come to rest because its commands were late."""

_log = logging.getLogger(__name__)


@dataclass
class _Ending:
    """How an episode ends, as far as that is known."""

    outcome: SessionState
    reason: str
    go_on: bool
    """Whether another episode may follow."""


class EpisodeRunner:
    """Runs episodes, one after the other.

    Args:
        layout: Of the policy.
        options: Seed, whether to send anything.
        preflight: What comes before any motion.
        approach: Moves the arm to the start.
        policy: The motion that the policy commands.
        loop: Carries it out.
        checks: That every chunk has to pass.
        robot: Gets the arm back at the end.
        status: Told what happens.
    """

    def __init__(
        self,
        layout: PolicyLayout,
        options: DeployOptions,
        preflight: Preflight,
        approach: Approach,
        policy: PolicyMotion,
        loop: ControlLoop,
        checks: ChunkChecks,
        robot: RobotClient,
        status: SessionStatus,
    ) -> None:
        self._layout = layout
        self._options = options
        self._preflight = preflight
        self._approach = approach
        self._policy = policy
        self._loop = loop
        self._checks = checks
        self._robot = robot
        self._status = status

    @property
    def steps(self) -> tuple[int, int]:
        """Control steps of the present or last episode, and how many there may be."""
        return self._policy.steps, self._layout.episode_steps

    def run(self, index: int) -> tuple[EpisodeReport, bool]:
        """Run an episode; it ends at rest. Nothing that goes wrong in it leaves here.

        Args:
            index: Which, from 0.

        Returns:
            What happened, and whether another episode may follow.
        """
        seed = int(np.random.SeedSequence([self._options.seed, index]).generate_state(1)[0])
        self._policy.forget()
        go_on = self._move(seed)
        ending = _Ending(self._status.state, self._status.reason, go_on)
        at_rest = self._give_back(ending)
        self._status.fire(SessionEvent.AT_REST, f"after {ending.outcome.value}")
        stopping = ending.outcome is SessionState.STOPPING
        final = self._policy.observation
        names = self._layout.observation_names[: len(final)]
        report = EpisodeReport(
            index,
            "stopped" if stopping else ending.outcome.value,
            ending.reason,
            self._policy.steps,
            seed,
            dict(zip(names, map(float, final), strict=True)),
            {} if at_rest is None else dict(at_rest.contact),
            self._policy.smoothness(),
        )
        return report, ending.go_on

    def _move(self, seed: int) -> bool:
        """The part in which the arm is ours. Whatever ends it: nothing is sent afterwards.

        Returns:
            Whether another episode may follow.
        """
        try:
            self._carry_out(seed)
        except StopRequestedError as error:
            self._status.fire(SessionEvent.STOP, str(error))
            return False
        except TransportError as error:
            self._status.fire(SessionEvent.FAULT, str(error))
            return False
        except SkewmiError as error:
            self._status.fire(SessionEvent.STOP, str(error))
        except Exception as error:
            _log.exception("the cycle failed")
            self._status.fire(SessionEvent.FAULT, f"{type(error).__name__}: {error}")
            return False
        return True

    def _carry_out(self, seed: int) -> None:
        """Preflight, way to the start, policy.

        Raises:
            Exception: Anything at all.
        """
        self._checks.boxed = False
        ready = self._preflight.run(seed)
        self._status.fire(
            SessionEvent.READY, "hashes and limits agree, states are fresh, way is free"
        )
        state, q = ready.state, ready.q
        at_start = "dry run: the arm stays where it is"
        if not self._options.dry_run:
            state = self._approach.run(ready.q_goal, q, state)
            q, at_start = ready.q_goal, "the arm rests at the start"
        self._status.fire(SessionEvent.AT_START, at_start)
        self._checks.boxed = True
        self._run_policy(q, state)
        end = self._policy
        reason = "the task is solved" if end.success else f"{end.steps} steps are used up"
        if end.held_back:
            reason += f"; held back for {end.held_back} cycles ({end.held_back_reason})"
        self._status.fire(SessionEvent.SUCCESS if end.success else SessionEvent.TIME_OVER, reason)

    def _run_policy(self, q: Array, state: ArmState) -> None:
        """Let the policy command the hand until success or the end of the episode's time."""
        recoveries = 0
        while True:
            try:
                self._loop.run(self._policy, q, state)
            except OutOfStepError as error:
                recoveries += 1
                if recoveries > RECOVERIES:
                    if isinstance(error, LateChunkError):
                        raise LateChunkError(f"{error}; {BUSY_ADVICE}") from error
                    raise
                q, state = self._loop.recover(error)
            else:
                return

    def _give_back(self, ending: _Ending) -> RobotDescription | None:
        """Give the arm back; what the robot server says when it rests, if it does."""
        try:
            at_rest = self._robot.disarm()
            # What came last may have been somebody else's: by now the robot server's own has come.
            self._loop.confirm_senders()
        except SkewmiError as error:
            self._add_fault(ending, str(error))
            return None
        if at_rest is not None and at_rest.state == ServerState.FAULT.value:
            ending.go_on = False
            if ending.outcome is not SessionState.FAULT:
                self._add_fault(ending, f"the robot server is in fault: {at_rest.reason}")
        return at_rest

    def _add_fault(self, ending: _Ending, what: str) -> None:
        ending.go_on = False
        ending.outcome, ending.reason = SessionState.FAULT, f"{ending.reason}; then {what}"
        self._status.fire(SessionEvent.FAULT, ending.reason)
