"""States of the arm are taken once each; whoever was busy can have one from now on."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np

from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.observer import Observer
from skewmi.trajectory import CYCLE_NS


class Reader:
    """Gives what a test has put in; the next one comes by itself when nothing is left.

    Args:
        arriving: States that come, one with each look that finds nothing unread.
    """

    def __init__(self, *arriving: ArmState) -> None:
        self.unread: list[ArmState] = []
        self._arriving = list(arriving)

    def drain(self) -> list[ArmState]:
        unread, self.unread = self.unread, []
        if not unread and self._arriving:
            self.unread.append(self._arriving.pop(0))
        return unread

    def others(self) -> str:
        return ""


def state(cycle: int, received_ns: int) -> ArmState:
    return ArmState(cycle * CYCLE_NS, received_ns, np.zeros(7), np.zeros(7), 0.0)


def observer(reader: Reader) -> Observer:
    parts: Any = SimpleNamespace(take=lambda stamp_ns: None, decode=lambda sample: sample)
    joints: Any = reader
    return Observer(
        joints, parts, parts, None, lock_step=False, state_period_s=0.02, max_age_s=10.0
    )


def test_what_came_while_somebody_was_busy_is_not_a_state_from_now() -> None:
    now_ns = time.monotonic_ns()
    reader = Reader(state(9, now_ns))
    watching = observer(reader)
    reader.unread = [state(1, now_ns)]
    first = watching.next_state()
    assert first is not None
    assert first.stamp_ns == CYCLE_NS
    reader.unread = [state(2, now_ns), state(3, now_ns)]
    newest = watching.next_state()
    assert newest is not None
    assert newest.stamp_ns == 3 * CYCLE_NS, "the newest of those unread"
    reader.unread = [state(4, now_ns), state(5, now_ns)]
    assert watching.state_from_now().stamp_ns == 9 * CYCLE_NS


def test_who_was_busy_for_long_may_wait_as_long_as_anybody() -> None:
    """The age counts from now, and not from the state before the work."""
    long_ago_ns = time.monotonic_ns() - 3_600_000_000_000
    reader = Reader(state(9, time.monotonic_ns()))
    watching = observer(reader)
    reader.unread = [state(1, long_ago_ns)]
    watching.next_state()
    assert watching.state_from_now().stamp_ns == 9 * CYCLE_NS
