"""A ROS 2 node without ROS 2 and without skewmi, in a process of its own.

Keys, tokens, attachments and type hashes are those of zenoh-ros2-sdk; two other CDR codecs read
and write every payload once more. Of skewmi it knows nothing.

One request a line on standard input, `{"do": NAME, ...}`; one answer a line on standard output:
what the method of that name returns, or `{"error": ...}`. The SDK fetches message definitions by
git unless it finds them in a folder: here they are written to one.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

os.environ["GIT_PYTHON_REFRESH"] = "quiet"  # no git is needed where no definition is missing

import numpy as np
import zenoh
import zenoh_ros2_sdk as sdk
from ros2_codecs import (
    DEFINITIONS,
    RESPONSE,
    TRIGGER,
    TRIGGER_REQUEST,
    TRIGGER_RESPONSE,
    Codecs,
    plain,
)
from rosbags.interfaces import Nodetype
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.qos import QosProfile


class Subscriber(sdk.ROS2Subscriber):
    """The SDK's subscriber that keeps each sample beside what the SDK made of it."""

    def __init__(self, topic: str, type_name: str) -> None:
        self._decoded: list[Any] = []
        self._pairs: list[tuple[Any, Any]] = []
        super().__init__(topic, type_name, self._decoded.append)

    def _listener(self, sample: Any) -> None:
        super()._listener(sample)  # where it fails it logs, and calls nobody
        self._pairs.append((self._decoded.pop() if self._decoded else None, sample))

    def take(self) -> list[tuple[Any, Any]]:
        """Pairs (message or None if the SDK could not decode it, sample) since the last call."""
        pairs = self._pairs[: len(self._pairs)]
        del self._pairs[: len(pairs)]
        return pairs


class Peer:
    """The requests."""

    def __init__(self, port: int) -> None:
        self._folder = tempfile.TemporaryDirectory()
        for type_name, text in DEFINITIONS.items():
            file = Path(self._folder.name, f"{type_name}.msg")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        sdk.get_registry(self._folder.name)
        self._manager = sdk.ZenohSession.get_instance("127.0.0.1", port)
        self._codecs = Codecs()
        self._subscribers: dict[str, Subscriber] = {}
        self._publishers: dict[tuple[str, str], Any] = {}
        self._clients: dict[str, Any] = {}
        self._servers: dict[str, Any] = {}

    def about(self) -> dict[str, Any]:
        """Whose code runs here."""
        packages = ("zenoh-ros2-sdk", "rosbags", "mcap-ros2-support", "eclipse-zenoh")
        return {name: version(name) for name in packages} | {
            "skewmi": [name for name in sys.modules if name.partition(".")[0] == "skewmi"],
            "session": self._manager.session_id,
        }

    def graph(self) -> dict[str, Any]:
        """Topics and services as `ros2 topic info --verbose` shows them, and all tokens."""
        topics = {}
        for name, types in sdk.get_topic_names_and_types(domain_id=0):
            info = sdk.get_topic_info(name, domain_id=0, verbose=True)
            if info is None:
                continue  # gone in the meantime
            topics[name] = {
                "types": types,
                "publishers": [self._entity(each, each.topic_type) for each in info.publishers],
                "subscribers": [self._entity(each, each.topic_type) for each in info.subscribers],
            }
        services = {}
        for name, types in sdk.get_service_names_and_types(domain_id=0):
            info = sdk.get_service_info(name, domain_id=0, verbose=True)
            if info is None:
                continue
            servers = [self._entity(each, each.service_type) for each in info.servers]
            services[name] = {"types": types, "servers": servers}
        replies = self._manager.liveliness.get("@ros2_lv/0/**", timeout=2.0)
        tokens = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
        return {"topics": topics, "services": services, "tokens": tokens}

    def subscribe(self, topic: str, type_name: str) -> dict[str, Any]:
        """Start listening; the type hash as the SDK computes it from the text above."""
        self._subscribers[topic] = Subscriber(topic, type_name)
        return {"hash": self._subscribers[topic].type_hash}

    def take(self, topic: str) -> list[dict[str, Any]]:
        """Everything that came on a topic since the last call."""
        subscriber = self._subscribers[topic]
        taken = []
        for message, sample in subscriber.take():
            judged = self._codecs.judge(sample.payload.to_bytes(), subscriber.msg_type)
            judged["same_values"] &= plain(message) == judged["message"]
            taken.append(judged | {"attachment": self._attachment(sample)})
        return taken

    def publisher(self, topic: str, type_name: str, name: str = "") -> dict[str, Any]:
        """Declare a publisher, and wait until somebody listens."""
        publisher = sdk.ROS2Publisher(topic, type_name, node_name=name or None)
        self._publishers[topic, name] = publisher
        deadline = time.monotonic() + 5.0
        while not publisher.pub.matching_status.matching and time.monotonic() < deadline:
            time.sleep(0.01)
        return {
            "gid": publisher.publisher_gid.hex(),
            "matching": bool(publisher.pub.matching_status.matching),
        }

    def publish(self, topic: str, message: dict[str, Any], name: str = "") -> dict[str, Any]:
        """Send a message; its number as the SDK counts."""
        publisher = self._publishers[topic, name]
        sequence = publisher.sequence_number
        publisher.publish(**self._fields(publisher.msg_type, message))
        return {"sequence": sequence}

    def call(self, service: str) -> dict[str, Any] | None:
        """Call a Trigger service through the SDK."""
        reply = self._client(service).call()
        return None if reply is None else plain(reply)

    def call_raw(self, service: str) -> list[dict[str, Any]]:
        """Call it once more as rmw_zenoh does; all replies as they came."""
        client = self._client(service)
        request = Attachment(77, time.time_ns(), client.client_gid)
        replies = self._manager.session.get(
            client.keyexpr,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=5.0,
            payload=b"\x00\x01\x00\x00\x00",
            attachment=request.to_bytes(),
        )
        answers = []
        for reply in replies:
            judged = self._codecs.judge(reply.ok.payload.to_bytes(), RESPONSE)
            attachment = self._attachment(reply.ok)
            answers.append(judged | {"attachment": attachment, "client": client.client_gid.hex()})
        return answers

    def serve(self, service: str, message: str) -> dict[str, Any]:
        """Serve a Trigger service that succeeds with a message."""
        response = self._manager.register_message_type(TRIGGER_RESPONSE, f"{TRIGGER}_Response")
        self._servers[service] = sdk.ROS2ServiceServer(
            service,
            TRIGGER,
            lambda request: response(success=True, message=message),
            request_definition=TRIGGER_REQUEST,
            response_definition=TRIGGER_RESPONSE,
        )
        return {}

    def _client(self, service: str) -> Any:
        if service not in self._clients:
            self._clients[service] = sdk.ROS2ServiceClient(
                service,
                TRIGGER,
                request_definition=TRIGGER_REQUEST,
                response_definition=TRIGGER_RESPONSE,
            )
        return self._clients[service]

    def _fields(self, type_name: str, content: dict[str, Any]) -> dict[str, Any]:
        """Keyword arguments of a message class, nested messages made from dictionaries."""
        store = self._manager.store
        made = {}
        for name, (kind, detail) in store.fielddefs[type_name][1]:
            value = content[name]
            if kind is Nodetype.NAME:
                value = store.types[detail](**self._fields(detail, value))
            elif kind is Nodetype.SEQUENCE and detail[0][0] is Nodetype.NAME:
                nested = detail[0][1]
                value = [store.types[nested](**self._fields(nested, each)) for each in value]
            elif kind is Nodetype.SEQUENCE and detail[0][1][0] == "float64":
                value = np.array(value, dtype=np.float64)
            made[name] = value
        return made

    @staticmethod
    def _entity(info: Any, type_name: str) -> dict[str, Any]:
        qos = QosProfile.decode(info.qos)
        return {
            "node": info.node_name,
            "type": type_name,
            "hash": info.type_hash,
            "reliability": qos.reliability.name,
            "durability": qos.durability.name,
            "depth": qos.history_depth,
        }

    @staticmethod
    def _attachment(sample: Any) -> dict[str, Any]:
        content = sample.attachment.to_bytes()
        attachment = Attachment.from_bytes(content)
        return {
            "bytes": len(content),
            "sequence": attachment.sequence_id,
            "age_s": (time.time_ns() - attachment.timestamp_ns) / 1e9,
            "gid": attachment.gid.hex(),
        }


def main() -> None:
    peer = Peer(int(sys.argv[1]))
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = getattr(peer, request.pop("do"))(**request)
        except Exception as error:
            answer = {"error": repr(error)}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()
    # Zenoh's threads keep the interpreter; the session's tokens end with its connection.
    os._exit(0)


if __name__ == "__main__":
    main()
