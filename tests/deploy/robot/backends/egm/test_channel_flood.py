"""An arm's channel under a flood of datagrams that are no packets."""

from __future__ import annotations

import math
import socket

import numpy as np
import pytest
from egm_channel import Controller, guided

from skewmi.deploy.robot.backends.egm.channel import ArmChannel


def flood(channel: ArmChannel, controller: Controller, count: int) -> None:
    """Malformed datagrams of every kind, from the controller's own address and from others."""
    rng = np.random.default_rng(11)
    good = controller.bytes_of()
    controller.sequence -= 1
    controller.cycles -= 1
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sent = 0
    while sent < count:
        for _ in range(32):
            kind = rng.integers(6)
            data = bytearray(good)
            if kind == 0:
                data = bytearray(rng.bytes(int(rng.integers(0, 64))))
            elif kind == 1:
                data = data[: int(rng.integers(len(data)))]
            elif kind == 2:
                data[8 + int(rng.integers(len(data) - 8))] ^= int(rng.integers(1, 256))
            elif kind == 3:
                data = bytearray(rng.bytes(2000))
            elif kind == 4:
                data = bytearray()
            else:
                data += rng.bytes(int(rng.integers(1, 40)))
            target = controller.socket if rng.random() < 0.5 else stranger
            target.sendto(bytes(data), channel.link.address)
            sent += 1
        taken = channel.take()
        controller.clock.wait(0.004)
        if taken is not None:
            assert np.isfinite(taken.packet.q).all()
            channel.hold()
    stranger.close()


@pytest.mark.parametrize("count", [5_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_malformed_datagrams_do_nothing_but_be_told(
    channel: ArmChannel, controller: Controller, count: int
) -> None:
    flood(channel, controller, count)
    while channel.take() is not None or channel.link.wait(1_000_000):
        pass
    assert channel.watch.unusable > 0.5 * count / 3
    # What did not look malformed was a packet with another value in it; none left the range.
    for answer in controller.collect():
        assert all(math.isfinite(value) for value in answer.chain())
        assert all(abs(value) <= 290.0 for value in answer.chain())
    controller.clock.wait(0.11)
    channel.take()
    assert channel.readiness() is not None
    controller.sequence, controller.cycles = 0, controller.cycles + 1000
    guided(channel, controller)
