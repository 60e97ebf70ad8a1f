"""What arrives for a robot server, and how much of it is looked at in one cycle.

A cycle must be on time whatever arrives, from whomever. So of every topic a bounded number of
messages is taken from the link in a cycle, what is cheap to know decides first (state, commander,
sequence, size), little is decoded, and services share a bounded time. What a link cannot hold any
more, it drops by itself, oldest first.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence

from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.refusals import Refusal
from skewmi.deploy.robot.requests import RobotRequests
from skewmi.deploy.wire.channels import LatestReader, Sample, Service
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.errors import CommandRefusedError, TransportError

COMMANDS_NS = 1_500_000
"""Time that chunks may take between two cycles; the rest waits for the next, oldest first."""

SERVICES_NS = 1_000_000
"""Time that answers may take; the last one that is begun in it is finished."""

MOST_TAKEN = 64
"""Messages of one topic that are taken from the link in a cycle: 16,000 a second."""

MOST_GRIPPER = 2
"""Gripper commands that are read in a cycle, the newest; older ones have had their day."""

QUEUE = 256
"""Messages of one topic that wait at the link; the commander sends one in five cycles."""

MAX_REQUEST_BYTES = 1024
"""Longest request of a service; publishers' ids take 37 bytes."""


def _never() -> bool:
    return False


class CommandIntake:
    """Takes chunks and gripper commands from the link, a bounded share in each cycle.

    Args:
        controller: Judges chunks.
        requests: Judges gripper commands.
        chunks: Of `topics.YUMI_TRAJECTORY`; keeps several.
        gripper: Of `topics.YUMI_GRIPPER`; keeps several.
    """

    def __init__(
        self,
        controller: RobotController,
        requests: RobotRequests,
        chunks: LatestReader,
        gripper: LatestReader,
    ) -> None:
        self._controller = controller
        self._requests = requests
        self._chunks = chunks
        self._gripper = gripper
        self._unread: deque[Sample] = deque()
        self._skipped = 0

    @property
    def dropped(self) -> int:
        """Messages that were taken and not judged: not the newest, or of nobody."""
        return self._skipped + self._chunks.strays + self._gripper.strays

    def serve(self, due: Callable[[], bool] = _never) -> None:
        """Judge what may be judged in this cycle.

        Args:
            due: Whether the robot's next cycle has come: then one chunk has to be enough.
        """
        self._judge_chunks(time.monotonic_ns() + COMMANDS_NS, due)
        self._judge_gripper()

    def _judge_chunks(self, until_ns: int, due: Callable[[], bool]) -> None:
        # In order: each continues the one before it, so that none may be left out.
        self._unread.extend(self._chunks.drain(MOST_TAKEN - len(self._unread)))
        while self._unread and (now_ns := time.monotonic_ns()) < until_ns:
            sample = self._unread.popleft()
            self._controller.receive(sample.payload, sample.gid, sample.sequence, now_ns)
            if due():
                break

    def _judge_gripper(self) -> None:
        allowed = [s for s in self._gripper.drain(MOST_TAKEN) if self._may_be_read(s)]
        self._skipped += max(0, len(allowed) - MOST_GRIPPER)
        for sample in allowed[-MOST_GRIPPER:]:
            try:
                command = decode_joint_states(sample.payload)
                self._requests.follow_gripper(command, sample.gid, sample.sequence)
            except (CommandRefusedError, TransportError) as error:
                self._refuse(sample, error)

    def _may_be_read(self, sample: Sample) -> bool:
        try:
            self._requests.check_gripper(sample.size, sample.gid, sample.sequence)
        except CommandRefusedError as error:
            self._refuse(sample, error)
            return False
        return True

    def _refuse(self, sample: Sample, error: Exception) -> None:
        ours = sample.gid == self._controller.lease.gripper_holder
        self._controller.refusals.note(Refusal(f"gripper: {error}", of_commander=ours))


class ServiceRounds:
    """Answers requests of several services, a bounded time in each cycle.

    Args:
        first: Come first in every cycle.
        others: Take turns in beginning.
    """

    def __init__(self, first: Sequence[Service], others: Sequence[Service]) -> None:
        self._first = first
        self._others = deque(others)

    def serve(self, due: Callable[[], bool] = _never) -> None:
        """Answer what may be answered in this cycle: of the others at least one service is asked,
        so that a flood of what comes first leaves them something.

        Args:
            due: Whether the robot's next cycle has come: then that one has to be enough.
        """
        until_ns = time.monotonic_ns() + SERVICES_NS
        for service in self._first:
            service.poll(until_ns)
        for service in self._others:
            service.poll(until_ns)
            if time.monotonic_ns() > until_ns or due():
                break
        self._others.rotate(-1)
