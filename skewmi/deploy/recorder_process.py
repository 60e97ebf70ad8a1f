"""The process behind `recorder.Recorder`: packets from standard input to an MCAP file.

python -m skewmi.deploy.recorder_process FILE    (standard input: packets)
"""

from __future__ import annotations

import json
import signal
import sys
from typing import BinaryIO

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import Writer

from skewmi.deploy.recorder import CHANNEL, MESSAGE, METADATA, PACKET

CHUNK_BYTES = 32 * 1024
"""Small, since an unfinished chunk is what a kill of this process loses: at most 60 ms of a
running arm, 0.7 s of a resting one."""

_FLUSH_EVERY = 32


def write(packets: BinaryIO, file: BinaryIO) -> None:
    """Write packets until the other end closes, then finish the file."""
    writer = Writer(file, chunk_size=CHUNK_BYTES)
    writer.start(profile=Profile.ROS2, library="skewmi")
    channels: dict[int, int] = {}
    schemas: dict[str, int] = {}
    unflushed = 0
    while len(header := packets.read(PACKET.size)) == PACKET.size:
        length, kind, channel, sequence, log_time_ns, publish_time_ns = PACKET.unpack(header)
        body = packets.read(length)
        if len(body) != length:
            break  # the daemon was killed in the middle of a packet
        if kind == MESSAGE:
            writer.add_message(channels[channel], log_time_ns, body, publish_time_ns, sequence)
        elif kind == CHANNEL:
            channels[channel] = _add_channel(writer, schemas, json.loads(body))
        elif kind == METADATA:
            writer.add_metadata(*json.loads(body))
        unflushed += 1
        if unflushed >= _FLUSH_EVERY or kind != MESSAGE:
            file.flush()
            unflushed = 0
    writer.finish()
    file.flush()


def _add_channel(writer: Writer, schemas: dict[str, int], topic: dict[str, str]) -> int:
    type_name = topic["type"]
    if type_name not in schemas:
        schemas[type_name] = writer.register_schema(
            type_name, SchemaEncoding.ROS2, topic["schema"].encode()
        )
    return int(
        writer.register_channel(
            topic["topic"],
            MessageEncoding.CDR,
            schemas[type_name],
            {"offered_qos_profiles": "", "topic_type_hash": topic["hash"]},
        )
    )


def main(path: str) -> int:
    """Record to `path`. Returns the exit code; the reason of a failure goes to stderr."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with open(path, "wb") as file:
            write(sys.stdin.buffer, file)
    except OSError as error:
        sys.stderr.write(f"{error.strerror or error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
