"""The stream of chunks: when each is due, what is sent, what was commanded."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.wire.messages import decode_chunk
from skewmi.errors import (
    LimitViolationError,
)
from skewmi.robot_models import yumi
from skewmi.trajectory import JointTrajectory

NAMES = yumi.joint_names("right")


def resting(value: float) -> JointTrajectory:
    """Seven resting joints."""
    return JointTrajectory.resting(np.full(7, value), 8)


def make_stream(sent: list[bytes], *, lock_step: bool = True, checks: Any = ()) -> ChunkStream:
    return ChunkStream(
        sent.append, NAMES, checks, CycleTimes(), lock_step=lock_step, lead_ns=24_000_000
    )


def test_stream_sends_one_chunk_per_state_and_two_after_a_lost_one() -> None:
    sent: list[bytes] = []
    stream = make_stream(sent)
    stream.begin(np.zeros(7), 0)
    counts = []
    for stamp in (0, 20, 40, 80, 100):
        splices = []
        for splice in stream.due(stamp * 1_000_000, 0):
            splices.append(splice)
            stream.send(resting(0.0))
        counts.append(splices)
    assert counts == [[5], [5], [5], [5, 5], [5]]
    assert stream.missed_cycles == 0


def test_stream_keeps_its_cycle_with_a_robot_whose_own_is_another() -> None:
    """States come with the first cycle of 4.032 ms in each 20 ms: up to 4 ms late."""
    sent: list[bytes] = []
    stream = make_stream(sent)
    stamps = [-(-k * 20_000_000 // 4_032_000) * 4_032_000 for k in range(3, 700)]
    stream.begin(np.zeros(7), stamps[0])
    for stamp_ns in stamps:
        splices = []
        for splice in stream.due(stamp_ns, 0):
            splices.append(splice)
            stream.send(resting(0.0))
        assert splices == [5], stamp_ns
    due_ns = [decode_chunk(payload).stamp_ns for payload in sent]
    assert due_ns == [k * 20_000_000 + 24_000_000 for k in range(3, 700)]


def test_late_stream_splices_further_along_the_braking_tail() -> None:
    sent: list[bytes] = []
    stream = make_stream(sent, lock_step=False)
    stream.begin(np.zeros(7), 0)
    late_by_ns = 50_000_000
    received = time.monotonic_ns() - late_by_ns
    splice = next(iter(stream.due(0, received)))
    # 24 ms ahead, 50 ms late and 6 ms to spare: two cycles more are needed.
    assert splice == 5 + 2 * 5
    assert stream.missed_cycles == 2


def test_chunk_that_a_check_refuses_is_not_sent() -> None:
    def refuse(*args: object) -> None:
        raise LimitViolationError("test", 2.0, 1.0)

    sent: list[bytes] = []
    stream = make_stream(sent, checks=(("check", refuse),))
    stream.begin(np.zeros(7), 0)
    next(stream.due(0, 0))
    with pytest.raises(LimitViolationError):
        stream.send(resting(0.0))
    assert sent == []


def test_stream_remembers_what_was_commanded_when() -> None:
    stream = make_stream([])
    stream.begin(np.zeros(7), 0)
    for number, stamp in enumerate((0, 20, 40), start=1):
        for _ in stream.due(stamp * 1_000_000, 0):
            stream.send(resting(float(number)))
    values = [stream.commanded(t * 1_000_000)[0] for t in (0, 23, 24, 43, 44, 64, 500)]
    assert values == [0.0, 0.0, 1.0, 1.0, 2.0, 3.0, 3.0]
