"""A control loop between a robot and states that are written down."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from types import SimpleNamespace

import numpy as np

from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import CycleTimes
from skewmi.robot_models import yumi
from skewmi.trajectory import CYCLE_NS, Array

Q = np.array(yumi.HOME["right"])


def arm_state(cycle: int, q: Array = Q) -> ArmState:
    """What is measured at the beginning of a cycle."""
    return ArmState(cycle * CYCLE_NS, 0, q, np.zeros(7), 0.01)


class Robot:
    """Says nothing, or what a test lets it say in some of its checks.

    Args:
        log: Told what is asked of it.
        says: Errors by the number of the check in which they are raised, from 1.
    """

    def __init__(self, log: list[str], says: dict[int, Exception]) -> None:
        self._log, self._says, self._checks = log, says, 0

    def check(self, *, late_is_final: bool) -> None:
        self._checks += 1
        self._log.append("check, late is final" if late_is_final else "check")
        if self._checks in self._says:
            raise self._says[self._checks]

    def check_held(self, q: Array) -> None:
        self._log.append("held")

    def wait_for_hold(self) -> Array:
        self._log.append("hold")
        return Q + 0.001


class Observer:
    """Tells states that are written down; None is a repeated one."""

    def __init__(self, log: list[str], states: Iterator[ArmState | None]) -> None:
        self._log, self._states = log, states

    def next_state(self) -> ArmState | None:
        self._log.append("read")
        return next(self._states)

    def fresh_state(self) -> ArmState:
        return arm_state(1000)

    def state_from_now(self) -> ArmState:
        self._log.append("now")
        return arm_state(0)

    def check_scene(self) -> None:
        self._log.append("scene")


class Bench:
    """A loop, and a log of what it does.

    Args:
        states: What the robot tells after the first state; by default one state a cycle.
        says: See `Robot`.
        lock_step: See `ControlLoop`.
    """

    def __init__(
        self,
        states: Iterable[ArmState | None] | None = None,
        says: dict[int, Exception] | None = None,
        *,
        lock_step: bool = True,
    ) -> None:
        self.log: list[str] = []
        self.stop = threading.Event()
        self.status = SimpleNamespace(clock_ns=0)
        self.checks: list[tuple[str, object]] = []
        times = CycleTimes()
        self.stream = ChunkStream(
            lambda payload: self.log.append("write"),
            yumi.joint_names("right"),
            self.checks,
            times,
            lock_step=True,
            lead_ns=24_000_000,
        )
        told = map(arm_state, range(1, 1000)) if states is None else states
        self.loop = ControlLoop(
            Robot(self.log, says or {}),
            Observer(self.log, iter(told)),
            self.stream,
            times,
            self.status,
            self.stop,
            lock_step=lock_step,
        )
