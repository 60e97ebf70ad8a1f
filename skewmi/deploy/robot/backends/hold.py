"""A robot that holds what it is commanded, after a delay: no physics, no scene, no surprises.

The smallest backend there is, and an example of one. It serves to try a link, a client or a
recording without a simulation, and to test the server at any cycle time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from math import inf

import numpy as np

from skewmi.deploy.robot.backend import RobotBackend, RobotState, Scene
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.gripper.base import check_opening
from skewmi.deploy.robot.pace import Beat, Pace, make_pace
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.trajectory import GRID_NS, JointPoint

MAX_DELAY_S = 10.0


class HoldBackend:
    """An arm that is wherever it was commanded to be; satisfies `RobotBackend`.

    Args:
        q: Where it is at first, rad. Shape (7,).
        delay_s: From a command to the state that shows it, s.
        lock_step: Let time pass only when commands have arrived.
        period_ns: Of its cycle, ns.

    Raises:
        ConfigurationError: The delay is not in 0..10 s, or the period not positive.
    """

    name = "hold"
    admitted_speed = inf
    joint_speed = inf
    scene: Scene | None = None

    def __init__(
        self,
        q: Array,
        *,
        delay_s: float = 0.0,
        lock_step: bool = False,
        period_ns: int = GRID_NS,
    ) -> None:
        if not 0.0 <= delay_s <= MAX_DELAY_S:
            raise ConfigurationError(f"delay is {delay_s} s; it must be in 0..{MAX_DELAY_S:g} s")
        if period_ns <= 0:
            raise ConfigurationError(f"period is {period_ns} ns; it must be positive")
        self.joint_names = yumi.joint_names("right")
        self.state_names = (*self.joint_names, yumi.finger_names("right")[0])
        self.period_ns = period_ns
        self.lock_step = lock_step
        self._delay_ns = round(1e9 * delay_s)
        self._time_ns = -period_ns
        rest = np.zeros(len(self.joint_names))
        self._present = JointPoint(np.array(q, dtype=np.float64), rest, rest)
        self._underway: deque[tuple[int, JointPoint]] = deque()
        self._opening = 0.0
        self._pace: Pace | None = None

    @property
    def slips(self) -> int:
        """How often cycles were left out because the server came too late."""
        return 0 if self._pace is None else self._pace.slips

    def open(self, may_advance: Callable[[], bool]) -> None:
        """Begin."""
        self._pace = make_pace(self.period_ns, may_advance, lock_step=self.lock_step)

    def readiness(self) -> str | None:
        """Nothing is ever missing."""
        return None

    def read(self) -> RobotState | None:
        """Wait for the next cycle; the commands whose delay is over show in it."""
        assert self._pace is not None, "open it first"
        beat = self._pace.wait()
        if beat is Beat.NONE:
            return None
        if beat is Beat.NEXT:
            self._time_ns += self.period_ns
            while self._underway and self._underway[0][0] <= self._time_ns:
                self._present = self._underway.popleft()[1]
        return RobotState(
            self._time_ns,
            np.append(self._present.q, self._opening),
            np.append(self._present.v, 0.0),
            np.zeros(len(self.state_names)),
        )

    def due(self) -> bool:
        """Whether the next cycle has come."""
        return self._pace is not None and self._pace.due()

    def write(self, command: JointPoint) -> None:
        """Hold this once its delay is over, from the next cycle on at the earliest."""
        due_ns = self._time_ns + self._delay_ns
        if self._underway and self._underway[-1][0] == due_ns:
            # In lock-step a cycle comes again until something is to be done.
            self._underway.pop()
        self._underway.append((due_ns, command))

    def activate(self) -> None:
        """It is always active."""

    def deactivate(self) -> None:
        """It goes on holding."""

    def open_gripper(self, opening: float) -> None:
        """Show an opening of the fingers.

        Raises:
            CommandRefusedError: Not one.
        """
        check_opening(opening)
        self._opening = opening

    def told(self) -> Mapping[str, str]:
        """Nothing more."""
        return {}

    def close(self) -> None:
        """Nothing is left."""


def make(options: BackendOptions) -> RobotBackend:
    """See `backends.make_backend`."""
    if options.feed_forward is not None:
        raise ConfigurationError(
            "this robot is where it is commanded to be and has no servos to know; leave out "
            "--calibration"
        )
    if options.variation is not None:
        raise ConfigurationError("this robot has nothing that varies; leave out --variation")
    start = options.start_configuration or yumi.HOME["right"]
    delay_s = options.delay_s or 0.0
    return HoldBackend(np.array(start), delay_s=delay_s, lock_step=options.lock_step)
