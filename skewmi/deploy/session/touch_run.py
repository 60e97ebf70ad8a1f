"""Touches things: over each of them in the calibration workspace, then slowly in that for touching.

One touch: a way in joint space high over the scene, down to just above it, down beside a face, and
creeping towards it until the finger meets it; and back the same way. Everything is looked at before
the arm is moved, every chunk once more before it is sent, and every chunk ends at rest.

A watch notices nothing on the first part of a guarded motion, which it learns from. That part is
known to be free from the start of the path alone: so a guarded motion that was late is not taken
up where it stopped and the finger may press already, but goes back and begins at the start again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import numpy as np

from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.safety.checks import SpaceChecks
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.carried_out import carried_out
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.guarded_motion import SETTLING_NS, GuardedMotion, HoldStill, Watch
from skewmi.deploy.session.interrupt import check_interrupt
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.path_follower import ATTEMPTS, PathFollower
from skewmi.deploy.session.path_places import places_along
from skewmi.deploy.session.readiness import wait_until_ready
from skewmi.deploy.session.refused import OutOfStepError, given_up
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.touch_plan import (
    PlannedTouch,
    SwitchedChecks,
    TouchReading,
    TouchSettings,
)
from skewmi.errors import CommandRefusedError
from skewmi.policy_io import Array

CLOSING_NS = 1_500_000_000
"""How long closing the fingers may take, ns."""
AT_START = 1e-6
"""Largest joint distance from the start of a path at which a guarded motion begins, rad."""


class TouchRun:
    """Some touches, from preflight to rest; the parts are as `JointRun`'s.

    Args:
        robot, observer, stream, loop: Of the session.
        checks: What every chunk has to pass.
        settings: How to touch.
        watch: Says when something is met.
        status: Told what happens.
        stop: Set from outside to end the run.
        lock_step: Whether the robot waits.
        tell: Told in words what happens.

    Attributes:
        readings: Of the touches that were made.
        largest_force: That was told anywhere, given-up attempts included, N.
    """

    def __init__(
        self,
        robot: RobotClient,
        observer: Observer,
        stream: ChunkStream,
        loop: ControlLoop,
        checks: SwitchedChecks,
        settings: TouchSettings,
        watch: Watch,
        status: SessionStatus,
        stop: threading.Event,
        *,
        lock_step: bool,
        tell: Callable[[str], None],
    ) -> None:
        self._robot, self._observer, self._stream, self._loop = robot, observer, stream, loop
        self._checks, self._settings, self._watch = checks, settings, watch
        self._status, self._stop, self._tell = status, stop, tell
        self._lock_step = lock_step
        self._way = PathFollower(
            robot, observer, stream, loop, checks, settings.limits, settings.tool_z, status
        )
        self.readings: list[TouchReading] = []
        self.largest_force = self._peak_force = 0.0

    def run(self, touches: Sequence[PlannedTouch]) -> list[str]:
        """Make them; the arm goes back to where it was.

        Returns:
            Why it was stopped, if it was. Whatever ends it, nothing has been sent since.
        """
        return carried_out(
            lambda: self._carry_out(touches),
            self._robot,
            self._status,
            over="everything is touched",
            after="after touching",
            lock_step=self._lock_step,
        )

    def _carry_out(self, touches: Sequence[PlannedTouch]) -> None:
        """Raises SkewmiError for whatever ends it early."""
        check_interrupt(self._stop)
        self._robot.meet()
        wait_until_ready(self._robot, self._stop, dry_run=False)
        before = self._way.take_place()
        self._look_at(touches, before)
        state = self._way.enter(self._settings.above)
        now = self._way.take_place()
        if (now != before).any():
            # Not for nothing: who holds an arm must not be silent for as long as that takes.
            self._look_at(touches[:1], now)
        self._status.fire(SessionEvent.READY, "every way is free")
        self._robot.open_gripper(self._settings.opening, state.stamp_ns)
        state = self._loop.run(HoldStill(self._stream, CLOSING_NS), self._way.q, state)
        for number, touch in enumerate(touches, 1):
            way = JointPath.line(self._way.q, touch.lower.at(0.0))
            state = self._way.move(way, 0.0, way.length, state)
            if number == 1:
                self._status.fire(SessionEvent.AT_START, "over the first touch")
            self._tell(f"touch {number} of {len(touches)}: face {touch.face}")
            state = self._touch(touch, state)
        way = JointPath.line(self._way.q, before)
        self._tell("moving back")
        self._way.move(way, 0.0, way.length, state)

    def _touch(self, touch: PlannedTouch, state: ArmState) -> ArmState:
        state = self._way.move(touch.lower, 0.0, touch.lower.length, state)
        state = self._way.enter(self._settings.beside, state)
        state, met = self._guarded(touch.down, np.array([0.0, 0.0, -1.0]), None, state)
        if met.touched:
            raise CommandRefusedError(
                f"the hand met something on its way down beside the {touch.face} face: does the "
                "box stand where it is believed to, within 6 mm and 4 degrees?"
            )
        speed = self._settings.creep_speed
        state, met = self._guarded(touch.creep, -touch.normal, speed, state)
        if not met.touched:
            raise CommandRefusedError(
                f"nothing was met at the {touch.face} face, {1e3 * touch.creep.length:.0f} mm far: "
                "does the box stand where it is believed to, within 6 mm and 4 degrees?"
            )
        q = np.array([held.q for held in met.held])
        opening = float(np.mean([held.gripper for held in met.held]))
        self.readings.append(
            TouchReading(touch, q.mean(axis=0), q.std(axis=0), opening, met.peak_force)
        )
        self._tell(f"touched the {touch.face} face with {met.peak_force:.1f} N")
        state = self._way.move(touch.creep, touch.creep.nearest(self._way.q), 0.0, state)
        state = self._way.move(touch.down, touch.down.length, 0.0, state)
        state = self._way.enter(self._settings.above, state)
        return self._way.move(touch.lower, touch.lower.length, 0.0, state)

    def _guarded(
        self, path: JointPath, direction: Array, speed: float | None, state: ArmState
    ) -> tuple[ArmState, GuardedMotion]:
        """Follow a path from its start until something is met.

        Args:
            path: At whose start the arm rests; `FREE_WAY` from there nothing is in its way.
            direction: Of the finger, unit vector in the base frame. Shape (3,).
            speed: See `PathFollower.motion`.
            state: The newest one.

        Returns:
            The newest state, and the attempt that was not late; its peak force is that of all.

        Raises:
            LimitViolationError: The arm presses too hard.
            CommandRefusedError: It came too late `ATTEMPTS` times.
            SkewmiError: Whatever else ends a motion; nothing has been sent since.
        """
        self._peak_force = 0.0
        last: OutOfStepError | None = None
        for _ in range(ATTEMPTS):
            last = None
            try:
                state = self._back_to_start(path, state)
                state, guarded = self._attempt(path, direction, speed, state)
                if guarded.touched or not guarded.late:
                    return state, guarded
            except OutOfStepError as error:
                last, state = error, self._way.recover(error)
        raise given_up("motions", ATTEMPTS, last)

    def _attempt(
        self, path: JointPath, direction: Array, speed: float | None, state: ArmState
    ) -> tuple[ArmState, GuardedMotion]:
        """Follow a path once, from its start until something is met or a chunk is late."""
        motion = self._way.motion(path, 0.0, path.length, speed)
        limit = self._settings.force_limit
        guarded = GuardedMotion(
            motion, direction, self._watch, self._stream, limit, self._peak_force
        )
        try:
            state = self._loop.run(guarded, self._way.q, state)
        finally:
            self._peak_force = guarded.peak_force
            self.largest_force = max(self.largest_force, self._peak_force)
        assert self._stream.sent is not None
        self._way.q = self._stream.sent.trajectory.q[-1]
        return state, guarded

    def _back_to_start(self, path: JointPath, state: ArmState) -> ArmState:
        """Lead the arm back along a path after an attempt, and let it come to rest."""
        if np.abs(self._way.q - path.at(0.0)).max() <= AT_START:
            return state
        self._tell("a command came too late: back, and towards it once more")
        state = self._way.move(path, path.nearest(self._way.q), 0.0, state)
        # The watch is told where the arm rests: it must have come there.
        return self._loop.run(HoldStill(self._stream, SETTLING_NS), self._way.q, state)

    def _look_at(self, touches: Sequence[PlannedTouch], before: Array) -> None:
        """Look at every path before any of it is followed.

        Raises:
            LimitViolationError: One leads through something, or out of its workspace.
        """
        q = before
        for touch in touches:
            way = JointPath.line(q, touch.lower.at(0.0))
            above, beside = (way, touch.lower), (touch.down, touch.creep)
            for name, paths in (
                (self._settings.above, above),
                (self._settings.beside, beside),
            ):
                for path in paths:
                    check_interrupt(self._stop)
                    self._look_along(self._checks.spaces[name], path)
            q = touch.lower.at(0.0)
        self._look_along(self._checks.spaces[self._settings.above], JointPath.line(q, before))

    @staticmethod
    def _look_along(space: SpaceChecks, path: JointPath) -> None:
        """As a whole: a workspace holds from inside, so that it says nothing of single places."""
        places = places_along(path)
        space.check_way(places)
        rest = np.zeros((1, 7))
        for q in places:
            # Of its samples the guard looks at the torque of a few alone.
            space.guard.check(q[None], rest, rest)
