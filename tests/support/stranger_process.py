"""A stranger on the link, in a process of its own: `python stranger_process.py JSON`.

The JSON object: "locator"; "topic", by name; "payload", hexadecimal, and "more_bytes" behind it;
"also", payloads of more topics by name;
"rate", messages a second, 0 as fast as it goes; "node", its ROS 2 name, empty for a program that
announces nothing; "copy": use the id of whoever publishes there, "before" with the next number,
"ahead" with numbers far ahead; "serve": answer `/yumi/describe`, too, with this text. Ends with its
standard input.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import zenoh

from skewmi.deploy.wire import messages, ros2_keys, topics
from skewmi.deploy.wire.messages import TriggerReply
from skewmi.deploy.wire.transport import Link, TransportConfig

TOPICS = {topic.name: topic for topic in topics.TOPICS}
AHEAD = 1_000_000
GID = bytes(range(200, 216))


def main() -> None:
    order = json.loads(sys.argv[1])
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    config = TransportConfig.for_client(order["locator"])
    topic = TOPICS[order["topic"]]
    payload = bytes.fromhex(order["payload"]) + bytes(order["more_bytes"])
    if order["node"]:
        with Link.open(config, order["node"]) as link:
            if order["serve"]:
                answer = TriggerReply(True, order["serve"])
                link.service(topics.YUMI_DESCRIBE, lambda request: answer)
            says = [(link.publisher(topic), payload)]
            for name, more in order["also"].items():
                says.append((link.publisher(TOPICS[name]), bytes.fromhex(more)))
            ready(*(publisher.gid for publisher, _ in says))
            pace(order["rate"], ended, lambda: [p.put(said) for p, said in says])
        return
    with zenoh.open(config.zenoh()) as session:
        send = copier(session, topic, order["copy"]) if order["copy"] else plain(session, topic)
        ready(GID)
        pace(order["rate"], ended, lambda: send(payload))


def plain(session: Any, topic: topics.Topic) -> Any:
    """Sends without having announced anything."""
    count = 0

    def send(payload: bytes) -> None:
        nonlocal count
        count += 1
        attachment = ros2_keys.encode_attachment(count, time.time_ns(), GID)
        session.put(ros2_keys.data_key(0, topic), payload, attachment=attachment)

    return send


def copier(session: Any, topic: topics.Topic, how: str) -> Any:
    """Sends with the id of whoever has published last."""
    key = ros2_keys.data_key(0, topic)
    heard = session.declare_subscriber(
        key, zenoh.handlers.RingChannel(100), allowed_origin=zenoh.Locality.REMOTE
    )
    ahead = AHEAD

    def send(payload: bytes) -> None:
        nonlocal ahead
        sample = None
        while (newer := heard.handler.try_recv()) is not None:
            sample = newer
        if sample is None or sample.attachment is None:
            return
        sequence, stamp, gid = ros2_keys.decode_attachment(sample.attachment.to_bytes())
        ahead += 1
        number = sequence + 1 if how == "before" else ahead
        session.put(key, payload, attachment=ros2_keys.encode_attachment(number, stamp, gid))

    return send


def ready(*gids: bytes) -> None:
    """Tell the ids, in the order of the topics."""
    sys.stdout.write(" ".join(gid.hex() for gid in gids) + "\n")
    sys.stdout.flush()


def pace(rate: float, ended: threading.Event, send: Any) -> None:
    """Send until the end."""
    while not ended.is_set():
        try:
            send()
        except (zenoh.ZError, messages.TransportError):
            return  # the robot server is gone
        if rate:
            time.sleep(1.0 / rate)


if __name__ == "__main__":
    main()
