"""One commander at a time, in one workspace."""

from __future__ import annotations

from skewmi.deploy.safety.flange_space import TASK
from skewmi.errors import CommandRefusedError


class CommanderLease:
    """Who may command, and until when.

    Arming opens the lease for the next sender of a valid chunk; from then on only that sender
    (told apart by the gid of its publisher) is heard, until it is silent for `timeout_ns`, or
    the arm is stopped. Times are of one monotonic clock of the caller's choice.

    Args:
        timeout_ns: Silence after which the lease ends.
    """

    def __init__(self, timeout_ns: int) -> None:
        self.timeout_ns = timeout_ns
        self.holder: bytes | None = None
        self.sequence = 0
        """Sequence number of the last accepted message of the holder."""
        self.gripper_holder: bytes | None = None
        """The commander's publisher of gripper commands; None before it is known."""
        self.gripper_sequence = 0
        """Sequence number of its last accepted message."""
        self.workspace = TASK
        """Name of the workspace that was granted; the task's again once nobody commands."""
        self._renewed_ns: int | None = None

    def open(self, now_ns: int) -> None:
        """Let the next sender become the commander.

        Raises:
            CommandRefusedError: There is a commander and it is not silent.
        """
        self.check_free(now_ns)
        self.close()
        self._renewed_ns = now_ns

    def check_free(self, now_ns: int) -> None:
        """Whether somebody new may open it.

        Raises:
            CommandRefusedError: As in `open`.
        """
        if self.holder is not None and not self.expired(now_ns):
            raise CommandRefusedError(
                f"commander {self.holder.hex()[:8]} holds the arm; stop it first (skewmi stop)"
            )

    def close(self) -> None:
        """Nobody commands."""
        self.holder = None
        self.gripper_holder = None
        self.sequence = self.gripper_sequence = 0
        self.workspace = TASK
        self._renewed_ns = None

    def expired(self, now_ns: int) -> bool:
        """Whether an open lease has not been used for longer than its timeout."""
        return self._renewed_ns is not None and now_ns - self._renewed_ns > self.timeout_ns

    def check(self, gid: bytes, sequence: int) -> None:
        """Refuse other senders, and messages that are repeated or overtaken.

        Raises:
            CommandRefusedError: Names who commands, or both sequence numbers.
        """
        if self.holder is not None and gid != self.holder:
            raise CommandRefusedError(
                f"sender {gid.hex()[:8]} is not the commander {self.holder.hex()[:8]}"
            )
        if self.holder is not None and sequence <= self.sequence:
            raise CommandRefusedError(
                f"sequence {sequence} does not follow {self.sequence}: repeated or overtaken"
            )

    def check_gripper(self, gid: bytes, sequence: int | None = None) -> None:
        """As `check`, for gripper commands.

        Args:
            gid: Of the sender.
            sequence: Of the message; None is not looked at.

        Raises:
            CommandRefusedError: Names both.
        """
        if self.gripper_holder is not None and gid != self.gripper_holder:
            raise CommandRefusedError(
                f"sender {gid.hex()[:8]} is not the gripper's commander "
                f"{self.gripper_holder.hex()[:8]}"
            )
        # The first one opens the count: some ROS 2 nodes start at 0.
        if (
            sequence is not None
            and self.gripper_holder is not None
            and sequence <= self.gripper_sequence
        ):
            raise CommandRefusedError(
                f"gripper sequence {sequence} does not follow {self.gripper_sequence}: "
                "repeated or overtaken"
            )

    def renew_gripper(self, gid: bytes, sequence: int | None = None) -> None:
        """Note a gripper command that was followed after `check_gripper`: the first sender of one
        becomes the only one."""
        self.gripper_holder = gid
        if sequence is not None:
            self.gripper_sequence = sequence

    def extend(self, now_ns: int) -> None:
        """The commander has shown that it is there."""
        self._renewed_ns = now_ns

    def renew(self, gid: bytes, sequence: int, now_ns: int) -> None:
        """Note a chunk that was accepted after `check`."""
        self.holder = gid
        self.sequence = sequence
        self._renewed_ns = now_ns
