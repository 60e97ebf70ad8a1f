"""The extra bytes of a request to arm: who will command, and in which workspace."""

from __future__ import annotations

from dataclasses import dataclass

from skewmi.errors import CommandRefusedError

GID_BYTES = 16
_TAG = b"workspace:"


@dataclass(frozen=True)
class ArmRequest:
    """What is asked for when arming."""

    gid: bytes = b""
    """Global id of the publisher of chunks that becomes the commander; empty for the first that
    sends."""
    gripper: bytes = b""
    """The same of its gripper commands."""
    workspace: str = ""
    """Name of a workspace; empty for the task's, which needs no name."""

    def encode(self) -> bytes:
        """Ids, then the tag `workspace:` and the name if there is one."""
        name = _TAG + self.workspace.encode() if self.workspace else b""
        return self.gid + self.gripper + name

    @staticmethod
    def decode(extra: bytes) -> ArmRequest:
        """Inverse of `encode`.

        Raises:
            CommandRefusedError: Neither ids nor a name.
        """
        for count in (0, 1, 2):
            ids, rest = extra[: count * GID_BYTES], extra[count * GID_BYTES :]
            if len(ids) < count * GID_BYTES or not (rest.startswith(_TAG) or not rest):
                continue
            name = rest.removeprefix(_TAG).decode(errors="replace")
            if rest and not name:
                raise CommandRefusedError("arming asks for a workspace without a name")
            return ArmRequest(ids[:GID_BYTES], ids[GID_BYTES:], name)
        raise CommandRefusedError(
            f"arming names one or two publishers of {GID_BYTES} bytes each, or none, and may then "
            f"ask for a workspace ({_TAG.decode()}NAME); got {len(extra)} bytes"
        )
