"""What is looked at of what arrives: cheap things first, little in a cycle, whatever comes."""

from __future__ import annotations

import time
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from lone_motions import GRIPPER, OTHER, OURS, motion_from
from lone_robot import LoneRobot

from skewmi.deploy.robot import intake
from skewmi.deploy.robot.intake import (
    MOST_GRIPPER,
    MOST_TAKEN,
    CommandIntake,
    ServiceRounds,
)
from skewmi.deploy.safety.validation import MAX_GRIPPER_BYTES
from skewmi.deploy.wire import ros2_keys, topics
from skewmi.deploy.wire.channels import LatestReader
from skewmi.deploy.wire.messages import JointStates, encode_joint_states


class Bytes:
    """As Zenoh's: a length that costs nothing, and bytes that do."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self.copied = 0

    def __len__(self) -> int:
        return len(self._content)

    def to_bytes(self) -> bytes:
        self.copied += 1
        return self._content


class Channel:
    """What has arrived."""

    def __init__(self) -> None:
        self.waiting: deque[SimpleNamespace] = deque()

    def put(self, payload: bytes, gid: bytes | None, sequence: int = 1) -> Bytes:
        """A message; of nobody if `gid` is None."""
        attachment = None if gid is None else ros2_keys.encode_attachment(sequence, 0, gid)
        content = Bytes(payload)
        self.waiting.append(
            SimpleNamespace(
                payload=content, attachment=None if attachment is None else Bytes(attachment)
            )
        )
        return content

    def try_recv(self) -> SimpleNamespace | None:
        return self.waiting.popleft() if self.waiting else None


class Bench:
    """An intake of a lone robot, and what is decoded in it."""

    def __init__(self, robot: LoneRobot, monkeypatch: pytest.MonkeyPatch) -> None:
        self.robot = robot
        self.chunks, self.gripper = Channel(), Channel()
        self.intake = CommandIntake(
            robot.controller,
            robot.requests,
            LatestReader(self.chunks, topics.YUMI_TRAJECTORY, intake.QUEUE),
            LatestReader(self.gripper, topics.YUMI_GRIPPER, intake.QUEUE),
        )
        self.decoded: list[bytes] = []
        decode = intake.decode_joint_states

        def noting(payload: bytes) -> JointStates:
            self.decoded.append(payload)
            return decode(payload)

        monkeypatch.setattr(intake, "decode_joint_states", noting)

    def opening(self, value: float) -> bytes:
        nothing = np.zeros(0)
        finger = self.robot.backend.state_names[7:]
        states = JointStates(
            self.robot.controller.clock_ns, finger, np.array([value]), nothing, nothing
        )
        return encode_joint_states(states)

    def reasons(self) -> str:
        return " | ".join(refusal.reason for refusal in self.robot.refusals())


@pytest.fixture
def bench(robot: LoneRobot, monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(robot, monkeypatch)


def test_a_gripper_command_is_far_shorter_than_its_bound(bench: Bench) -> None:
    assert len(bench.opening(0.02)) < MAX_GRIPPER_BYTES / 5


@pytest.mark.parametrize(
    ("armed", "gid", "sequence", "size", "words"),
    [
        (False, GRIPPER, 5, 100, "arm it first"),
        (True, OTHER, 5, 100, "not the gripper's commander"),
        (True, GRIPPER, 4, 100, "repeated or overtaken"),
        (True, GRIPPER, 5, MAX_GRIPPER_BYTES + 1, "at most 1024 are read"),
        (True, GRIPPER, 5, 130_000, "at most 1024 are read"),
    ],
)
def test_what_may_not_command_the_gripper_is_neither_copied_nor_decoded(
    bench: Bench, armed: bool, gid: bytes, sequence: int, size: int, words: str
) -> None:
    if armed:
        bench.robot.requests.arm(OURS + GRIPPER, time.monotonic_ns())
        bench.robot.controller.lease.gripper_sequence = 4
    content = bench.gripper.put(bytes(size), gid, sequence)
    bench.intake.serve()
    assert bench.decoded == []
    assert content.copied == 0
    assert words in bench.reasons()
    # One byte less, from the commander, newer: it is read.
    if armed:
        bench.gripper.put(bytes(MAX_GRIPPER_BYTES), GRIPPER, 5)
        bench.intake.serve()
        assert len(bench.decoded) == 1


def test_the_newest_gripper_commands_win_and_the_others_are_counted(bench: Bench) -> None:
    bench.robot.requests.arm(OURS + GRIPPER, time.monotonic_ns())
    openings = [0.001 * k for k in range(1, 11)]
    for sequence, opening in enumerate(openings, 1):
        bench.gripper.put(bench.opening(opening), GRIPPER, sequence)
    bench.intake.serve()
    assert bench.decoded == [bench.opening(opening) for opening in openings[-MOST_GRIPPER:]]
    assert bench.intake.dropped == len(openings) - MOST_GRIPPER
    assert bench.robot.refusals() == []
    assert bench.robot.controller.lease.gripper_sequence == len(openings)


@pytest.mark.parametrize("gid", [None, OTHER, OURS])
@pytest.mark.parametrize("armed", [False, True])
def test_a_cycle_takes_a_bounded_number_of_messages_of_each_topic(
    bench: Bench, gid: bytes | None, armed: bool
) -> None:
    if armed:
        bench.robot.requests.arm(OURS, time.monotonic_ns())
    for channel in (bench.chunks, bench.gripper):
        for sequence in range(10 * MOST_TAKEN):
            channel.put(b"", gid, sequence + 1)
    for cycle in range(1, 4):
        bench.intake.serve()
        assert len(bench.gripper.waiting) == (10 - cycle) * MOST_TAKEN
        # A slow machine may not have judged all that it took.
        assert len(bench.chunks.waiting) >= (10 - cycle) * MOST_TAKEN
        assert len(bench.decoded) <= cycle * MOST_GRIPPER
    if gid is None:
        assert bench.intake.dropped == 2 * 3 * MOST_TAKEN
        assert bench.robot.controller.refusals.count == 0


def test_chunks_are_judged_in_order_and_none_is_left_out(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.robot.requests.arm(OURS, time.monotonic_ns())
    judged = []

    def slow(payload: bytes, gid: bytes, sequence: int, now_ns: int) -> bool:
        time.sleep(0.0008)
        judged.append(sequence)
        return True

    monkeypatch.setattr(bench.robot.controller, "receive", slow)
    for sequence in range(1, 31):
        bench.chunks.put(b"x", OURS, sequence)
    most = 0
    while len(judged) < 30:
        before = len(judged)
        bench.intake.serve()
        most = max(most, len(judged) - before)
    assert judged == list(range(1, 31))
    assert most <= 1 + intake.COMMANDS_NS / 800_000


def test_a_good_chunk_is_followed_behind_a_flood_of_strangers(bench: Bench) -> None:
    bench.robot.requests.arm(OURS + GRIPPER, time.monotonic_ns())
    for sequence in range(2 * MOST_TAKEN):
        bench.chunks.put(bytes(1000), OTHER, sequence + 1)
    motion = motion_from(bench.robot)
    bench.chunks.put(bench.robot.payload(motion, bench.robot.due + 20), OURS, 1)
    for _ in range(20):
        bench.intake.serve()
    assert bench.robot.controller.accepted == 1


class Slow:
    """A service whose answers take a while."""

    def __init__(self, name: str, log: list[str], takes_s: float) -> None:
        self._name, self._log, self._takes_s = name, log, takes_s

    def poll(self, until_ns: int) -> int:
        self._log.append(self._name)
        time.sleep(self._takes_s)
        return 1


def test_services_share_a_bounded_time_and_take_turns() -> None:
    log: list[str] = []
    takes_s = 1.2 * intake.SERVICES_NS / 1e9
    stop, *others = (
        Slow(name, log, takes)
        for name, takes in (("stop", 0.0), ("a", takes_s), ("b", takes_s), ("c", takes_s))
    )
    rounds = ServiceRounds([stop], others)
    for _ in range(6):
        rounds.serve()
    # Sleeping may take longer than asked for, never shorter: one of the others in each cycle.
    asked = [name for name in log if name != "stop"]
    assert log.count("stop") == 6
    assert log[::2] == 6 * ["stop"]
    assert asked == ["a", "b", "c", "a", "b", "c"]


def test_where_the_next_cycle_has_come_each_gets_one_turn(bench: Bench) -> None:
    """Work waits for the robot, and nobody waits for ever."""
    for sequence in range(5):
        bench.chunks.put(b"", OTHER, sequence + 1)
    judged = []
    for _ in range(5):
        bench.intake.serve(lambda: True)
        judged.append(bench.robot.controller.refusals.count)
    assert judged == [1, 2, 3, 4, 5]

    log: list[str] = []
    stop, *others = (Slow(name, log, 0.0) for name in ("stop", "a", "b"))
    rounds = ServiceRounds([stop], others)
    for _ in range(3):
        rounds.serve(lambda: True)
    assert log == ["stop", "a", "stop", "b", "stop", "a"]
