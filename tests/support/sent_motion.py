"""The motion that a recording's messages say, and whether it kept the limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import (
    decode_chunk,
    decode_status,
)
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_NS, TrajectoryChunk

LAB = joint_limits.profile("lab")


def chunks_of(path: Path) -> list[TrajectoryChunk]:
    """Every chunk that was sent and that the robot server did not refuse."""
    recording = read_recording(path)
    messages = recording.messages[topics.YUMI_TRAJECTORY.name]
    assert [m.sequence for m in messages] == list(
        range(messages[0].sequence, messages[0].sequence + len(messages))
    ), "the recording is not complete"
    statuses = [decode_status(m.payload) for m in recording.messages[topics.YUMI_STATUS.name]]
    refused = {
        int(stamp) for s in statuses for stamp in s.values.get("refused_stamps_ns", "").split()
    }
    chunks = [decode_chunk(m.payload) for m in messages]
    return [chunk for chunk in chunks if chunk.stamp_ns not in refused]


def executed(chunks: list[TrajectoryChunk]) -> list[np.ndarray]:
    """Commanded positions on the 4 ms grid, as the messages alone say; one array per stretch.

    Each chunk replaces what older ones say from its stamp on; where nothing is said for a
    moment the arm rests at the end of the last chunk, and a new stretch begins.
    """
    stretches: list[dict[int, np.ndarray]] = []
    end = -1
    for chunk in chunks:
        if chunk.stamp_ns > end:
            stretches.append({})
        points = stretches[-1]
        for later in [t for t in points if t >= chunk.stamp_ns]:
            del points[later]
        points.update(
            zip(
                (chunk.stamp_ns + chunk.time_from_start_ns).tolist(),
                chunk.trajectory.q,
                strict=True,
            )
        )
        end = chunk.stamp_ns + int(chunk.time_from_start_ns[-1])
    for points in stretches:
        assert np.unique(np.diff(sorted(points))).tolist() == [GRID_NS]
    return [np.array([points[t] for t in sorted(points)]) for points in stretches]


def limit_fractions(q: np.ndarray) -> dict[str, float]:
    """Velocity, acceleration and jerk by differences on the grid, as fractions of their limits.

    The arm rests before and after, which counts, too.
    """
    h = GRID_NS / 1e9
    padded = np.concatenate([np.tile(q[0], (3, 1)), q, np.tile(q[-1], (3, 1))])
    bounds = {"velocity": LAB.velocity, "acceleration": LAB.acceleration, "jerk": LAB.jerk}
    return {
        name: float((np.abs(np.diff(padded, n=n, axis=0)) / h**n / bound).max())
        for n, (name, bound) in enumerate(bounds.items(), start=1)
    }


def assert_limits_kept(path: Path) -> dict[str, float]:
    chunks = chunks_of(path)
    checker = ChunkChecker(LAB, None, ArmKinematics("right").forward)
    for chunk in chunks:
        checker.check(
            chunk.trajectory.q,
            chunk.trajectory.v,
            chunk.trajectory.a,
            chunk.trajectory.point(0),
        )
    worst: dict[str, float] = {}
    for q in executed(chunks):
        assert (q >= LAB.position_lower).all()
        assert (q <= LAB.position_upper).all()
        for name, fraction in limit_fractions(q).items():
            worst[name] = max(worst.get(name, 0.0), fraction)
            assert fraction <= 1.0 + 1e-6, (name, fraction)
    return worst
