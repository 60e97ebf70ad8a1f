"""EGM packets written and read byte by byte, from ABB's field table alone.

A second implementation for tests, with nothing of the package's: no protobuf runtime, degrees and
ABB's order of axes as they are on the wire.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

MOTORS_ON, MOTORS_OFF = 1, 2
MCI_ERROR, MCI_STOPPED, MCI_RUNNING = 1, 2, 3
RAPID_UNDEFINED, RAPID_STOPPED, RAPID_RUNNING = 0, 1, 2
DATA, CORRECTION = 2, 3


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def integer(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value)


def double(number: int, value: float) -> bytes:
    return varint(number << 3 | 1) + struct.pack("<d", value)


def block(number: int, content: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(content)) + content


def doubles(number: int, values: Iterable[float]) -> bytes:
    return b"".join(double(number, value) for value in values)


@dataclass
class Feedback:
    """What a controller tells, as it stands on the wire: degrees, axes 1 to 6 and then 7.

    Fields that are None are left out.
    """

    sequence: int | None = 0
    tm: int | None = 0
    mtype: int | None = DATA
    axes: Sequence[float] = (0.0,) * 6
    axis_7: Sequence[float] = (0.0,)
    planned_axes: Sequence[float] | None = None
    planned_axis_7: Sequence[float] = ()
    clock: tuple[int, int] | None = (1_700_000_000, 0)
    motors: int | None = MOTORS_ON
    mci: int | None = MCI_RUNNING
    converged: bool | None = False
    rapid: int | None = RAPID_RUNNING
    utilization: float | None = None
    position_mm: Sequence[float] | None = None
    quaternion: Sequence[float] | None = None
    move_index: int | None = None
    extra: bytes = b""

    def encode(self) -> bytes:
        header = b""
        if self.sequence is not None:
            header += integer(1, self.sequence)
        if self.tm is not None:
            header += integer(2, self.tm)
        if self.mtype is not None:
            header += integer(3, self.mtype)
        out = block(1, header) + block(2, self._part(self.axes, self.axis_7))
        if self.planned_axes is not None:
            out += block(3, self._part(self.planned_axes, self.planned_axis_7))
        if self.motors is not None:
            out += block(4, integer(1, self.motors))
        if self.mci is not None:
            out += block(5, integer(1, self.mci))
        if self.converged is not None:
            out += integer(6, int(self.converged))
        if self.rapid is not None:
            out += block(8, integer(1, self.rapid))
        if self.utilization is not None:
            out += double(10, self.utilization)
        if self.move_index is not None:
            out += integer(11, self.move_index)
        return out + self.extra

    def _part(self, axes: Sequence[float], axis_7: Sequence[float]) -> bytes:
        part = block(1, doubles(1, axes))
        if self.position_mm is not None and self.quaternion is not None:
            pos = b"".join(double(i, v) for i, v in enumerate(self.position_mm, 1))
            orient = b"".join(double(i, v) for i, v in enumerate(self.quaternion, 1))
            part += block(2, block(1, pos) + block(2, orient))
        if axis_7:
            part += block(3, doubles(1, axis_7))
        if self.clock is not None:
            part += block(4, integer(1, self.clock[0]) + integer(2, self.clock[1]))
        return part


def fields(data: bytes) -> list[tuple[int, Any]]:
    """Field numbers and raw values of a message: int, float (64 bits) or bytes."""
    found: list[tuple[int, Any]] = []
    at = 0

    def read_varint() -> int:
        nonlocal at
        value, shift = 0, 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while at < len(data):
        key = read_varint()
        number, kind = key >> 3, key & 7
        if kind == 0:
            found.append((number, read_varint()))
        elif kind == 1:
            found.append((number, struct.unpack_from("<d", data, at)[0]))
            at += 8
        elif kind == 2:
            size = read_varint()
            found.append((number, data[at : at + size]))
            at += size
        else:
            raise AssertionError(f"wire type {kind}")
    assert at == len(data)
    return found


@dataclass
class Reference:
    """What a controller was answered with: degrees, degrees/s, axes 1 to 6 and then 7."""

    sequence: int = 0
    mtype: int = 0
    axes: list[float] = field(default_factory=list)
    axis_7: list[float] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    speed_7: list[float] = field(default_factory=list)

    @staticmethod
    def decode(data: bytes) -> Reference:
        top = dict(fields(data))
        header = dict(fields(top[1]))
        planned = dict(fields(top[2]))
        reference = Reference(header.get(1, 0), header.get(3, 0))
        reference.axes = [value for _, value in fields(planned[1])]
        reference.axis_7 = [value for _, value in fields(planned[3])]
        if 3 in top:
            speed = dict(fields(top[3]))
            reference.speeds = [value for _, value in fields(speed[1])]
            reference.speed_7 = [value for _, value in fields(speed[3])]
        return reference

    def chain(self) -> list[float]:
        """Degrees along the chain: axes 1, 2, 7, 3, 4, 5, 6."""
        return [*self.axes[:2], *self.axis_7, *self.axes[2:]]
