"""What can go wrong inside of the session: planner, policy, torque limits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from fault_chunks import breach

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.session import approach as approach_module
from skewmi.deploy.session import connect as connect_module
from skewmi.deploy.session.pace import planning_limits
from skewmi.robot_models.feed_forward import ServoConstants
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_TICKS, JointTrajectory

BREACHES = (
    "position",
    "velocity",
    "acceleration",
    "jerk",
    "tool speed",
    "workspace box",
    "torque",
    "self-collision",
)
OVERRUN_S = 0.06
STALL_S = 1.0
WEAK = 0.5


class Planted:
    """Nothing goes wrong.

    Args:
        trigger: Set when it shall happen, and cleared when it happens.
        began: To be called then.
    """

    torque_share = 1.0

    def __init__(self, trigger: threading.Event, began: Callable[[], None]) -> None:
        self._trigger = trigger
        self._began = began

    def _due(self) -> bool:
        """Whether it is to happen now; true once."""
        if not self._trigger.is_set():
            return False
        self._trigger.clear()
        self._began()
        return True

    def plan(self, chunk: JointTrajectory) -> JointTrajectory:
        """What becomes of a planned chunk before it is checked."""
        return chunk

    def act(self) -> None:
        """Called when the policy is asked."""

    def patches(self) -> list[tuple[Any, str, Any]]:
        """(where, name, replacement) so that the session plans through `plan`."""
        planted = self

        class FaultyPlanner(Planner):
            def step(self, splice: int = CYCLE_TICKS) -> JointTrajectory:
                return planted.plan(super().step(splice))

        class FaultyStart(StartMotion):
            def chunk(self, cycle: int) -> JointTrajectory:
                return planted.plan(super().chunk(cycle))

        def weak_limits(profile: str, speed: float, servos: ServoConstants | None) -> JointLimits:
            limits = planning_limits(profile, speed, servos)
            return replace(limits, torque=planted.torque_share * limits.torque)

        return [
            (connect_module, "Planner", FaultyPlanner),
            (connect_module, "planning_limits", weak_limits),
            (approach_module, "StartMotion", FaultyStart),
        ]


class Breach(Planted):
    """The planner breaks a limit: the session's own checks must see it."""

    def __init__(self, kind: str, trigger: threading.Event, began: Callable[[], None]) -> None:
        super().__init__(trigger, began)
        self._kind = kind
        if kind == "torque":
            # With half the torque, a burst within the acceleration limit needs too much.
            self.torque_share = WEAK

    def plan(self, chunk: JointTrajectory) -> JointTrajectory:
        return JointTrajectory(*breach(self._kind, chunk.point(0))) if self._due() else chunk


class Overrun(Planted):
    """One cycle's planning takes three cycles."""

    def plan(self, chunk: JointTrajectory) -> JointTrajectory:
        if self._due():
            time.sleep(OVERRUN_S)
        return chunk


class Stall(Planted):
    """The policy thinks for a second."""

    def act(self) -> None:
        if self._due():
            time.sleep(STALL_S)


PLANTS: dict[str, Callable[[threading.Event, Callable[[], None]], Planted]] = {
    "nothing": Planted,
    "overrun": Overrun,
    "stall": Stall,
    **{kind: partial(Breach, kind) for kind in BREACHES},
}
