"""The part of a recording that a policy commanded: neither the way to the start nor the braking."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from skewmi.deploy.recording.reader import Recording
from skewmi.deploy.wire import messages, session_status, topics
from skewmi.errors import TransportError
from skewmi.smoothness import LIMITS, name_of, smoothness
from skewmi.trajectory import GRID_NS, GRID_S, TrajectoryChunk

_FOR_EVER_NS = np.iinfo(np.int64).max


def policy_smoothness(recording: Recording) -> dict[str, float]:
    """Smoothness of the least smooth episode: the figure that `deploy` reports as the largest.

    As there it is of each episode by itself, from where the chunk that answers the first
    observation begins to where the last one begins, whose rest is the braking. What counts as
    smooth is meant for that alone: the way to the start, planned to the limits of acceleration,
    would hide what the policy does.

    Args:
        recording: Of believed senders.

    Returns:
        See `skewmi.smoothness.smoothness`; empty if no session tells that a policy moved the arm.
    """
    chunks = _chunks(recording)
    found = []
    for begin_ns, end_ns in _episodes(recording):
        sent = [chunk for sent_ns, chunk in chunks if begin_ns <= sent_ns < end_ns]
        parts = []
        for chunk, after in pairwise(sent):
            ticks = (after.stamp_ns - chunk.stamp_ns) // GRID_NS
            # If the one after begins later, the arm came to rest between them; so in `deploy`.
            if 0 < ticks < len(chunk.trajectory):
                parts.append(chunk.trajectory.a[:ticks])
        if parts:
            found.append(smoothness(np.concatenate(parts), GRID_S))
    found = [values for values in found if values]
    names = map(name_of, LIMITS) if found else ()
    return {name: max(values[name] for values in found) for name in names}


def _episodes(recording: Recording) -> list[tuple[int, int]]:
    """From when to when policies commanded the arm, by the wall clock of their sessions, ns.

    Messages of a session keep their order by that clock; by the robot server's, the last chunks on
    the way to the start begin after the policy's first observation.
    """
    found: list[tuple[int, int]] = []
    begin_ns: int | None = None
    for message in recording.messages.get(topics.YUMI_STATUS.name, ()):
        try:
            status = messages.decode_status(message.payload)
        except TransportError:
            continue  # counted as malformed where the run is understood
        if status.name != session_status.NAME:
            continue
        running = status.values.get(session_status.STATE) == session_status.RUNNING
        if running and begin_ns is None:
            begin_ns = message.publish_time_ns
        elif not running and begin_ns is not None:
            found.append((begin_ns, message.publish_time_ns))
            begin_ns = None
    # A recording whose recorder was killed ends in the middle.
    return found if begin_ns is None else [*found, (begin_ns, int(_FOR_EVER_NS))]


def _chunks(recording: Recording) -> list[tuple[int, TrajectoryChunk]]:
    """When each chunk for the arm was sent, and the chunk."""
    found = []
    for message in recording.messages.get(topics.YUMI_TRAJECTORY.name, ()):
        try:
            found.append((message.publish_time_ns, messages.decode_chunk(message.payload)))
        except TransportError:
            continue
    return found
