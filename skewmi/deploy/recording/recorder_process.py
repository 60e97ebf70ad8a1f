"""The process behind `recorder.Recorder`: subscribes to every topic and writes an MCAP file.

    python -m skewmi.deploy.recording.recorder_process

Standard input and output as in `listener`: the task is {"path", "config", "believed"}, then any
{"metadata": [name, values]} and {"believed": ids}; the counts come last.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from skewmi.child import tell_parent
from skewmi.deploy.recording.listener import Counts, Input, listen
from skewmi.deploy.recording.reader import BELIEVED, METADATA_NAME, STRANGERS
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.wire.channels import Sample
from skewmi.deploy.wire.topics import Topic
from skewmi.deploy.wire.transport import Link
from skewmi.errors import SkewmiError

_PERIOD_S = 0.005


def _record(source: Input) -> Counts:
    path = Path(source.task["path"])
    with Link.open(source.transport(), "skewmi_recorder") as link, RecordingWriter(path) as writer:

        def write(topic: Topic, sample: Sample) -> None:
            writer.write(
                topic,
                sample.payload,
                sequence=sample.sequence,
                publish_time_ns=sample.source_time_ns,
                sender=sample.gid,
            )

        believed: dict[str, list[str]] = {}

        def note_believed(publishers: dict[str, list[str]]) -> None:
            # All that were ever believed: what they sent is in the file.
            for topic, gids in publishers.items():
                believed[topic] = list(dict.fromkeys([*believed.get(topic, ()), *gids]))
            writer.add_metadata(METADATA_NAME, {BELIEVED: json.dumps(believed)})

        counts = listen(
            link,
            source,
            _PERIOD_S,
            on_sample=write,
            on_round=writer.flush,
            on_line=lambda content: writer.add_metadata(*content["metadata"]),
            on_believed=note_believed,
        )
        strangers = counts.as_dict()["strangers"]
        if strangers:
            writer.add_metadata(METADATA_NAME, {STRANGERS: json.dumps(strangers)})
        return counts


def main() -> int:
    """Record until standard input ends. Returns the exit code; failures go to stderr."""
    source = Input.open()
    try:
        counts = _record(source)
    except (SkewmiError, OSError) as error:
        sys.stderr.write(f"{' '.join(str(error).split())}\n")
        return 1
    tell_parent(**counts.as_dict())
    return 0


if __name__ == "__main__":
    sys.exit(main())
