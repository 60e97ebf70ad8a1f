"""The motion in joint space to where an episode starts."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.refused import OutOfStepError, given_up
from skewmi.deploy.session.stream import ChunkStream
from skewmi.errors import CommandRefusedError
from skewmi.policy_io import Array
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_TICKS, JointTrajectory

START_ATTEMPTS = 3
"""Start motions after one that was late and therefore stopped half-way."""

REACHED = 0.02
"""Largest joint error at which the start pose counts as reached, rad."""
SETTLING_NS = 500_000_000
"""How long an arm that is farther away gets to arrive once its motion is over."""

_NEVER_NS = 1 << 62


class Approach:
    """Moves the arm to where an episode starts.

    Args:
        loop: Carries out the motion.
        stream: Where its chunks go to.
        limits: To keep.
        flange_speed: That the robot admits, m/s.
        reached: Largest joint error at which the arm has arrived, rad.
    """

    def __init__(
        self,
        loop: ControlLoop,
        stream: ChunkStream,
        limits: JointLimits,
        flange_speed: float = TCP_SPEED_LIMIT,
        reached: float = REACHED,
    ) -> None:
        self._reached = reached
        self._flange_speed = flange_speed
        self._loop = loop
        self._stream = stream
        self._limits = limits

    def run(self, q_goal: Array, q: Array, state: ArmState) -> ArmState:
        """Move in joint space and wait until the arm is there.

        Args:
            q_goal: Where to go, rad. Shape (7,).
            q: Where the robot server holds the arm, rad. Shape (7,).
            state: The newest state.

        Returns:
            The newest state, with the arm at rest at `q_goal`.

        Raises:
            LimitViolationError: The way breaks a limit.
            CommandRefusedError: The arm did not arrive.
            SkewmiError: Whatever else ends a motion.
        """
        last: OutOfStepError | None = None
        for _ in range(START_ATTEMPTS):
            motion = StartMotion(q, q_goal, self._limits, flange_speed=self._flange_speed)
            way, last = _Way(motion, q_goal, self._stream), None
            try:
                state = self._loop.run(way, q, state)
                if not way.late:
                    _check_arrived(state.q, q_goal, self._reached)
                    return state
                q, state = self._loop.coast(state)
            except OutOfStepError as error:
                last = error
                q, state = self._loop.recover(error)
        raise given_up("start motions", START_ATTEMPTS, last)


class _Way:
    """A `StartMotion` for the control loop.

    Args:
        motion: From where the arm rests.
        q_goal: Where to go, rad. Shape (7,).
        stream: Knows when the arm rests.
    """

    def __init__(self, motion: StartMotion, q_goal: Array, stream: ChunkStream) -> None:
        self._motion = motion
        self._q_goal = q_goal
        self._stream = stream
        self.late = False
        """Whether the attempt was given up because a chunk would have been late."""

    def begin(self, q: Array, state: ArmState) -> None:
        """See `Motion`: from its beginning."""
        del q, state
        self._cycle, self._rest_ns, self.late = 0, _NEVER_NS, False

    def is_over(self, state: ArmState) -> bool:
        """Whether the arm has followed the motion to its end, or had its time for that."""
        if self._cycle >= self._motion.cycles:
            self._rest_ns = min(self._rest_ns, self._stream.rest_ns)
        # What is sent to a soft arm within limits comes to rest later than the motion.
        arrived = _distance(state.q, self._q_goal) <= REACHED
        return state.stamp_ns >= self._rest_ns + (0 if arrived else SETTLING_NS)

    def next_chunk(self, state: ArmState, splice: int) -> JointTrajectory | None:
        """The next part of the motion."""
        del state
        if splice != CYCLE_TICKS and 0 < self._cycle < self._motion.cycles:
            # Braking has begun: this motion cannot be taken up again, another one can.
            self.late = True
            return None
        chunk = self._motion.chunk(self._cycle)
        self._cycle += 1
        return chunk

    def after_sending(self, state: ArmState) -> None:
        """Nothing waits."""


def _distance(q: Array, q_goal: Array) -> float:
    return float(np.abs(q - q_goal).max())


def _check_arrived(q: Array, q_goal: Array, reached: float) -> None:
    """Refuse to go on from somewhere else than the start of the episode.

    Args:
        q: Measured, rad. Shape (7,).
        q_goal: Where the arm was to go, rad. Shape (7,).
        reached: Largest error that is allowed, rad.

    Raises:
        CommandRefusedError: A joint is more than `reached` away.
    """
    error = _distance(q, q_goal)
    if error > reached:
        raise CommandRefusedError(
            f"the arm stands {error:.3f} rad from the start configuration; "
            f"at most {reached} rad are allowed: is something in its way, or were "
            "commands lost?"
        )
