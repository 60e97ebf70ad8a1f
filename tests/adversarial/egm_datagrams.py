"""Datagrams that are no packets of a YuMi's controller, of every kind that a network can bring."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from egm_wire import Feedback, varint

from skewmi.deploy.robot.backends.egm.codec import MalformedPacketError, decode_feedback

LONGEST = 4_000
"""Bytes; what is longer than a frame comes in parts, and is put together by the system."""


def malformed(rng: np.random.Generator, good: Feedback) -> Iterator[bytes]:
    """Without end. Whether they are malformed is checked; every kind is far more often than not.

    Args:
        rng: For all choices.
        good: A packet that is none of them, to begin from.
    """
    kinds = (
        _noise,
        _cut,
        _bits,
        _appended,
        _too_long,
        _other_fields,
        _not_a_number,
        _forged,
    )
    while True:
        data = kinds[int(rng.integers(len(kinds)))](rng, good)
        try:
            decode_feedback(data)
        except MalformedPacketError:
            yield data


def _noise(rng: np.random.Generator, good: Feedback) -> bytes:
    del good
    return rng.bytes(int(rng.integers(0, 600)))


def _cut(rng: np.random.Generator, good: Feedback) -> bytes:
    data = good.encode()
    return data[: int(rng.integers(len(data)))]


def _bits(rng: np.random.Generator, good: Feedback) -> bytes:
    data = bytearray(good.encode())
    for _ in range(int(rng.integers(1, 9))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(data)


def _appended(rng: np.random.Generator, good: Feedback) -> bytes:
    return good.encode() + rng.bytes(int(rng.integers(1, 100)))


def _too_long(rng: np.random.Generator, good: Feedback) -> bytes:
    """A sound packet with unknown fields, until it is longer than a frame; or just bytes."""
    if rng.random() < 0.5:
        return rng.bytes(int(rng.integers(1_473, LONGEST)))
    filling = rng.bytes(int(rng.integers(1_473, LONGEST)))
    return good.encode() + varint(200 << 3 | 2) + varint(len(filling)) + filling


def _other_fields(rng: np.random.Generator, good: Feedback) -> bytes:
    """A packet of another robot, or of another kind."""
    changes: list[dict[str, object]] = [
        {"axes": (0.0,) * int(rng.choice([0, 1, 5, 7, 40]))},
        {"axis_7": ()},
        {"planned_axes": (0.0,) * 3},
        {"mtype": int(rng.choice([0, 1, 3, 4, 5]))},
        {"mtype": None},
        {"motors": None},
        {"mci": None},
    ]
    return replace(good, **changes[int(rng.integers(len(changes)))]).encode()  # type: ignore[arg-type]


def _not_a_number(rng: np.random.Generator, good: Feedback) -> bytes:
    value = (math.nan, math.inf, -math.inf)[int(rng.integers(3))]
    joint = int(rng.integers(8))
    if joint == 6:
        return replace(good, axis_7=(value,)).encode()
    if joint == 7:
        return replace(good, utilization=value).encode()
    axes = list(good.axes)
    axes[joint] = value
    return replace(good, axes=tuple(axes)).encode()


def _forged(rng: np.random.Generator, good: Feedback) -> bytes:
    """An answer as a bridge sends it, lengths that lie, and groups that never end."""
    data = good.encode()
    kind = int(rng.integers(3))
    if kind == 0:
        return data.replace(varint(3 << 3) + varint(2), varint(3 << 3) + varint(3), 1)
    if kind == 1:
        return bytes([data[0]]) + varint(int(rng.integers(2**31, 2**40))) + data[2:]
    return bytes([0x0B]) * int(rng.integers(1, 1_400))
