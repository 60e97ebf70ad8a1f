"""Messages to record, and files of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skewmi.deploy.recording.reader import METADATA_NAME, run_metadata
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates

NAMES = ("a", "b")


def states(number: int) -> bytes:
    values = np.full(2, float(number))
    return messages.encode_joint_states(JointStates(number, NAMES, values, values, values))


def write_file(path: Path, count: int = 400) -> None:
    with RecordingWriter(path) as writer:
        writer.add_metadata(METADATA_NAME, run_metadata(task="none"))
        for number in range(count):
            writer.write(topics.YUMI_JOINT_STATES, states(number), sequence=number)
