"""Recordings as arrays: every cycle once, in order, of the robot server alone; gaps filled in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.recording.joint_series import (
    MOST_MISSING_NS,
    executed_reference,
    measured_states,
)
from skewmi.deploy.recording.reader import BELIEVED, RecordedMessage, Recording
from skewmi.deploy.wire.controller_state import ControllerState, encode_controller_state
from skewmi.deploy.wire.messages import JointStates, encode_joint_states
from skewmi.deploy.wire.topics import YUMI_CONTROLLER_STATE, YUMI_JOINT_STATES
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.trajectory import GRID_NS, JointPoint

NAMES = tuple("abcdefg")
ROBOT, OTHER = "0a" * 16, "0b" * 16
START_NS = 12_345_000_000_000


def motion(times_s: Array) -> tuple[Array, Array, Array]:
    """A smooth one of seven joints, and its derivatives. Each of shape (n, 7)."""
    w = 2.0 * np.pi * np.linspace(0.3, 6.0, 7)
    angle = times_s[:, None] * w
    return 0.1 * np.sin(angle), 0.1 * w * np.cos(angle), -0.1 * w * w * np.sin(angle)


def recording(topic: str, *payloads: tuple[bytes, str], believed: bool = True) -> Recording:
    messages = [RecordedMessage(p, n, 0, 0, who) for n, (p, who) in enumerate(payloads)]
    metadata = {BELIEVED: json.dumps({topic: [ROBOT]})} if believed else {}
    return Recording(Path("run.mcap"), {topic: messages}, {}, metadata, True)


def executed(stamps_ns: Array, q: Array, v: Array, a: Array) -> Recording:
    payloads = [
        encode_controller_state(
            ControllerState(
                int(stamp), NAMES, JointPoint(q[k], v[k], a[k]), q[k] + 1.0, v[k] + 1.0, a[k] + 1.0
            )
        )
        for k, stamp in enumerate(stamps_ns)
    ]
    return recording(YUMI_CONTROLLER_STATE.name, *((p, ROBOT) for p in payloads))


def test_every_cycle_is_read_as_it_was_sent() -> None:
    stamps = START_NS + np.arange(50) * GRID_NS
    q, v, a = motion(np.arange(50) * 0.004)
    order = [*range(25), 24, *range(25, 50)]  # time may stand still, and a cycle be told again
    read = executed_reference(executed(stamps[order], q[order], v[order], a[order]))
    assert read.names == NAMES
    assert np.array_equal(read.stamps_ns, stamps)
    for part, whole in zip(
        (read.reference.q, read.reference.v, read.reference.a), (q, v, a), strict=True
    ):
        assert np.array_equal(part, whole)
    for part, whole in zip((read.position, read.velocity, read.effort), (q, v, a), strict=True):
        assert np.array_equal(part, whole + 1.0)
    assert read.longest_gap_ns == GRID_NS
    first, samples = read.on_grid()
    assert first == START_NS
    assert np.array_equal(samples.q, q)


@settings(deadline=None, max_examples=50)
@given(
    period_ns=st.integers(3_900_000, 4_100_000),
    offset_ns=st.integers(0, GRID_NS),
    kept=st.lists(st.booleans(), min_size=60, max_size=120),
)
def test_what_is_missing_or_off_the_grid_is_filled_in(
    period_ns: int, offset_ns: int, kept: list[bool]
) -> None:
    rows = np.flatnonzero([True, *kept, True])
    stamps = START_NS + offset_ns + rows * period_ns
    stamps = stamps[np.concatenate(([True], np.diff(stamps) > 0))]
    if np.diff(stamps).max() > 5 * GRID_NS:
        return
    read = executed_reference(executed(stamps, *motion((stamps - START_NS) / 1e9)))
    first, samples = read.on_grid()
    assert first % GRID_NS == 0
    times = (first - START_NS) / 1e9 + np.arange(len(samples)) * 0.004
    q, v, a = motion(times)
    # Of 6 Hz, over 20 ms: the remainder of a polynomial of fifth order.
    assert np.abs(samples.q - q).max() < 1e-6
    assert np.abs(samples.v - v).max() < 1e-3
    assert np.abs(samples.a - a).max() < 0.5
    assert stamps[0] <= first
    assert first + (len(samples) - 1) * GRID_NS <= stamps[-1]


def test_long_gaps_are_not_filled_in() -> None:
    stamps = np.array([START_NS, START_NS + MOST_MISSING_NS + GRID_NS])
    read = executed_reference(executed(stamps, *motion(np.array([0.0, 0.104]))))
    with pytest.raises(ConfigurationError, match="no executed reference for 104 ms"):
        read.on_grid()


def test_strangers_and_other_robots_are_left_out() -> None:
    point = np.zeros(7)
    state = ControllerState(START_NS, NAMES, JointPoint(point, point, point), point, point, point)
    false = ControllerState(
        START_NS + GRID_NS, NAMES, JointPoint(point, point, point), point, point, point
    )
    both = (encode_controller_state(state), ROBOT), (encode_controller_state(false), OTHER)
    read = executed_reference(recording(YUMI_CONTROLLER_STATE.name, *both))
    assert read.stamps_ns.tolist() == [START_NS]
    for payloads, words in (
        ((), "has no messages"),
        (((b"nonsense", ROBOT),), "malformed"),
        (((encode_controller_state(false), OTHER),), "has no messages"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            executed_reference(recording(YUMI_CONTROLLER_STATE.name, *payloads))


def test_measured_states_are_those_that_every_message_has() -> None:
    def told(stamp: int, names: str, velocity: bool) -> tuple[bytes, str]:
        values = np.array([float(ord(name)) for name in names])
        nothing = values[:0]
        states = JointStates(stamp, tuple(names), values, values if velocity else nothing, nothing)
        return encode_joint_states(states), ROBOT

    messages = told(20, "abcx", True), told(40, "cab", False), told(20, "abcx", True)
    read = measured_states(recording(YUMI_JOINT_STATES.name, *messages))
    assert read.names == ("a", "b", "c")
    assert read.stamps_ns.tolist() == [20, 40]
    assert read.position.tolist() == [[97.0, 98.0, 99.0]] * 2
    assert read.velocity[0].tolist() == [97.0, 98.0, 99.0]
    assert np.isnan(read.velocity[1]).all()
    assert np.isnan(read.effort).all()
