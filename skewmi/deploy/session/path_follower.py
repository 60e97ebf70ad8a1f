"""Follows paths of the joints from rest to rest, in whichever workspace holds."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.motion.path_motion import PathMotion
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.guarded_motion import HoldStill
from skewmi.deploy.session.joint_run import KnownMotion
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.refused import OutOfStepError, given_up
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.touch_plan import SwitchedChecks
from skewmi.errors import CommandRefusedError
from skewmi.policy_io import Array
from skewmi.robot_models.limits import JointLimits

ATTEMPTS = 20
"""How often a motion is taken up again where it stopped because a chunk came too late."""
RESTED_NS = 60_000_000
"""After what the robot server knows that the arm rests, ns: several equal samples."""
OFF_PATH = 1e-3
"""Largest joint distance from a path to where the arm rests when a motion along it begins, rad."""
SPEED_SHARE = 0.95
"""Part of a workspace's speed that is used."""
_AT_ONCE, _EVERY = 40, 4
"""Samples that the guard looks at together beforehand, and each how manieth it looks at."""


class PathFollower:
    """Moves an armed robot along paths; a motion that is late goes on from where it stopped.

    Args:
        robot, observer, stream, loop: Of the session.
        checks: What every chunk has to pass; told which workspace holds.
        limits: Of the joints.
        tool_z: Of the finger tips on the flange's axis, m: they keep the workspace's speed, too.
        status: Keeps the robot server's time.

    Attributes:
        q: Where the arm rests, rad. Shape (7,). Set by `take_place` and by every motion.
    """

    def __init__(
        self,
        robot: RobotClient,
        observer: Observer,
        stream: ChunkStream,
        loop: ControlLoop,
        checks: SwitchedChecks,
        limits: JointLimits,
        tool_z: float,
        status: SessionStatus,
    ) -> None:
        self._robot, self._observer, self._stream, self._loop = robot, observer, stream, loop
        self._checks, self._limits, self._tool_z = checks, limits, tool_z
        self._status = status
        self.q: Array = np.zeros(7)

    def take_place(self) -> Array:
        """Ask the robot server where it holds the arm, rad; sets and returns `q`."""
        description = self._robot.describe()
        self._status.clock_ns = description.clock_ns
        self.q = np.array(description.commanded_position)
        return self.q

    def enter(self, workspace: str, state: ArmState | None = None) -> ArmState:
        """Arm in a workspace or, armed already, change it.

        Args:
            workspace: Its name.
            state: The newest one, if the arm may have moved just now: then it rests a little first.

        Raises:
            CommandRefusedError: The robot server does not grant it.
        """
        if state is None:
            self._robot.arm(workspace=workspace)
        else:
            self._loop.run(HoldStill(self._stream, RESTED_NS), self.q, state)
            self._change(workspace)
        self._checks.now = workspace
        return self._observer.fresh_state()

    def _change(self, workspace: str) -> None:
        """Once the robot server has come to the end of what was sent, which a long lead delays."""
        try:
            self._robot.arm(workspace=workspace)
        except CommandRefusedError:
            self._robot.wait_for_hold()
            self._robot.arm(workspace=workspace)

    def move(self, path: JointPath, s: float, s_end: float, state: ArmState) -> ArmState:
        """Follow a path from rest to rest.

        Args:
            path: Near whose place `s` the arm rests.
            s, s_end: From where to where on it.
            state: The newest one.

        Raises:
            CommandRefusedError: It came too late `ATTEMPTS` times.
            SkewmiError: Whatever else ends a motion; nothing has been sent since.
        """
        last: OutOfStepError | None = None
        for attempt in range(ATTEMPTS):
            s = s if not attempt else path.nearest(self.q)
            motion = self.motion(path, s, s_end, None)
            way, last = KnownMotion(motion, self._stream), None
            try:
                state = self._loop.run(way, self.q, state)
                if not way.late:
                    self.q = motion.trajectory.q[-1]
                    return state
                state = self.coast(state)
            except OutOfStepError as error:
                last, state = error, self.recover(error)
        raise given_up("motions", ATTEMPTS, last)

    def coast(self, state: ArmState) -> ArmState:
        """Let the arm follow what was sent to its end; see `ControlLoop.coast`."""
        self.q, state = self._loop.coast(state)
        return state

    def recover(self, error: OutOfStepError) -> ArmState:
        """Wait until the arm rests after a motion out of step; see `ControlLoop.recover`."""
        self.q, state = self._loop.recover(error)
        return state

    def look_at(self, path: JointPath, workspace: str) -> None:
        """Work out the motion along a whole path, and look at it, while the arm still rests.

        Raises:
            LimitViolationError: It leads through something, asks for too much torque, or cannot be
                stopped within the limits somewhere.
        """
        now, before = self._checks.now, self.q
        self._checks.now, self.q = workspace, path.at(0.0)
        try:
            motion = self.motion(path, 0.0, path.length, None).trajectory
        finally:
            self._checks.now, self.q = now, before
        guard = self._checks.spaces[workspace].guard
        for first in range(0, len(motion), _AT_ONCE):
            rows = motion.part(slice(first, first + _AT_ONCE + 1, _EVERY))
            guard.check(rows.q, rows.v, rows.a)

    def motion(self, path: JointPath, s: float, s_end: float, speed: float | None) -> PathMotion:
        """The motion along a path from where the arm rests, as fast as the workspace admits.

        Args:
            path, s, s_end: See `move`.
            speed: Of flange and finger tips, m/s, if it is to be less.

        Raises:
            CommandRefusedError: The arm rests beside the path, which alone was looked at.
        """
        off = float(np.abs(path.at(s) - self.q).max())
        if off > OFF_PATH:
            raise CommandRefusedError(
                f"the arm rests {off:.3f} rad from the way that was planned; at most {OFF_PATH} "
                "rad are allowed: somebody has moved it; start again"
            )
        fastest = SPEED_SHARE * self._checks.speeds[self._checks.now]
        chosen = fastest if speed is None else min(speed, fastest)
        trajectory = path.motion(s, s_end, self._limits, chosen, self._tool_z, self.q)
        return PathMotion(trajectory, self._limits)
