"""Whose messages of a recording are to be shown: those whom its recorder was told to believe."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

from skewmi.deploy.recording.reader import BELIEVED, STRANGERS, RecordedMessage, Recording
from skewmi.deploy.wire.senders import SHORT, Stranger
from skewmi.deploy.wire.topics import YUMI_STATUS


@dataclass(frozen=True)
class Believed:
    """What is left of a recording, and words on the rest."""

    recording: Recording
    notes: tuple[str, ...]


def believed_part(recording: Recording) -> Believed:
    """A recording without the messages of senders that were not believed.

    A file that does not tell senders, or whom to believe, is shown as it is; the notes say so.
    """
    believed = _json(recording, BELIEVED)
    notes = [
        f"not recorded, as not believed: {stranger} ({stranger.messages} messages)"
        for stranger in _strangers(recording)
    ]
    messages = {}
    for topic, recorded in recording.messages.items():
        senders = Counter(message.sender for message in recorded)
        known = _known(believed, topic)
        if known is None:
            messages[topic] = list(recorded)
            notes += _unknown_senders(topic, senders)
            continue
        messages[topic] = [m for m in recorded if _is_known(m, known)]
        left_out = {gid: n for gid, n in senders.items() if gid not in known}
        notes += [
            f"left out, as not believed: {n} messages of {gid[:SHORT] or 'an unknown sender'} on "
            f"{topic}"
            for gid, n in left_out.items()
        ]
    return Believed(replace(recording, messages=messages), tuple(notes))


def _is_known(message: RecordedMessage, known: list[str]) -> bool:
    return message.sender in known


def _known(believed: Any, topic: str) -> list[str] | None:
    """Ids that are believed on a topic; None if that is not told."""
    if not isinstance(believed, dict):
        return None
    known = believed.get(topic, [])
    return [str(gid) for gid in known] if isinstance(known, list) else []


def _unknown_senders(topic: str, senders: Counter[str]) -> list[str]:
    # Session and robot server share the topic of their states, and tell who they are.
    expected = 2 if topic == YUMI_STATUS.name else 1
    if len(senders) <= expected:
        return []
    return [
        f"{len(senders)} senders on {topic}, and the file does not tell which of them to believe: "
        "all are shown"
    ]


def _strangers(recording: Recording) -> list[Stranger]:
    content = _json(recording, STRANGERS)
    try:
        return [Stranger(**stranger) for stranger in content or ()]
    except TypeError:
        return []


def _json(recording: Recording, key: str) -> Any:
    try:
        return json.loads(recording.metadata.get(key, "null"))
    except ValueError:
        return None
