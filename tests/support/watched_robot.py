"""A robot server in lock-step in this process, watched from inside: what it executed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from lone_motions import LAB, assert_within_limits
from robot_servers import robot_in_a_thread

from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.deploy.session.stream import ChunkStream
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_NS, GRID_S, Array, JointPoint, TrajectoryChunk

ARM = ArmKinematics("right")


class Seen:
    """What one robot server was told to do and was sent."""

    def __init__(self) -> None:
        self.commands: list[JointPoint] = []
        self.chunks: list[TrajectoryChunk] = []

    @property
    def q(self) -> Array:
        return np.array([command.q for command in self.commands])


@contextmanager
def robot_at(q: Array, patch: pytest.MonkeyPatch) -> Iterator[tuple[str, Seen]]:
    """A robot server in lock-step whose arm rests there."""
    seen = Seen()
    step, send = MujocoBackend._step, ChunkStream.send

    def stepped(self: MujocoBackend) -> None:
        seen.commands.append(JointPoint(*(part.copy() for part in self.simulation.command)))
        step(self)

    def sent(self: ChunkStream, samples: object) -> None:
        send(self, samples)  # type: ignore[arg-type]
        assert self.sent is not None
        seen.chunks.append(self.sent)

    with patch.context() as patched:
        patched.setattr(MujocoBackend, "_step", stepped)
        patched.setattr(ChunkStream, "send", sent)
        with robot_in_a_thread(lock_step=True, start_configuration=tuple(q)) as locator:
            yield locator, seen


def assert_kept(seen: Seen) -> None:
    """Limits by differences of what was executed, speed of the hand, and rest at the end."""
    q = seen.q
    assert_within_limits(q)
    position, _ = ARM.forward(q)
    assert np.linalg.norm(np.diff(position, axis=0), axis=1).max() / GRID_S <= 0.2501
    assert not seen.commands[-1].v.any()
    np.testing.assert_array_equal(q[-1], q[-2])


def assert_rests_whoever_is_killed(seen: Seen) -> None:
    """After any chunk nothing more may come: what was sent until then ends at rest, in limits."""
    checker = ChunkChecker(LAB, None, ARM.forward)
    before: dict[int, Array] = {}
    for chunk in seen.chunks:
        q, v, a = chunk.trajectory.q, chunk.trajectory.v, chunk.trajectory.a
        times = (chunk.stamp_ns + chunk.time_from_start_ns).tolist()
        earlier = [before.get(chunk.stamp_ns - k * GRID_NS) for k in (3, 2, 1)]
        known = None if any(row is None for row in earlier) else np.array(earlier)
        checker.check(q, v, a, chunk.trajectory.point(0), earlier=known)
        assert not v[-1].any()
        assert not a[-1].any()
        before |= dict(zip(times, q, strict=True))
