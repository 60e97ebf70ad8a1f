"""How ROS 2 names appear on Zenoh: keys, liveliness tokens, QoS strings and attachments.

The format is that of ros2/rmw_zenoh, so that ROS 2 nodes using it see every topic and service
of ours as their own. Nothing here opens a connection.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import StrEnum

import xxhash

from skewmi.deploy.wire import ros2_types
from skewmi.deploy.wire.topics import Service, Topic
from skewmi.errors import TransportError

ADMIN_SPACE = "@ros2_lv"
QOS_RELIABLE_10 = "::,10:,:,:,,"
"""Reliable, volatile, keep the last 10; ROS 2's default for topics and services."""
QOS_BEST_EFFORT_1 = "2::,1:,:,:,,"
"""Best effort, volatile, keep the last one."""

_ATTACHMENT = struct.Struct("<qqB16s")
ATTACHMENT_BYTES = _ATTACHMENT.size
_NAME_CHARACTERS = 64
_GID_BYTES = 16
ATTACHMENT_BYTES = _ATTACHMENT.size
"""Length of what goes with every sample, request and reply."""


class EntityKind(StrEnum):
    """What a liveliness token announces."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class Node:
    """A ROS 2 node: one per Zenoh session here."""

    domain: int
    session: str
    """Zenoh id of the session, hexadecimal."""
    name: str
    id: int = 0


def dds_type(type_name: str) -> str:
    """`sensor_msgs/msg/JointState` as rmw spells it: `sensor_msgs::msg::dds_::JointState_`."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def data_key(domain: int, topic: Topic | Service) -> str:
    """Key under which a topic's samples, or a service's requests, travel."""
    name = topic.name.strip("/")
    return f"{domain}/{name}/{dds_type(topic.type_name)}/{ros2_types.type_hash(topic.type_name)}"


def node_token(node: Node) -> str:
    """Liveliness token of a node."""
    return f"{_entity(node, node.id, EntityKind.NODE)}"


def endpoint_token(
    node: Node, entity: int, kind: EntityKind, topic: Topic | Service, qos: str
) -> str:
    """Liveliness token of a publisher, subscription, service or client of a node."""
    type_name, type_hash = dds_type(topic.type_name), ros2_types.type_hash(topic.type_name)
    return f"{_entity(node, entity, kind)}/{mangle(topic.name)}/{type_name}/{type_hash}/{qos}"


def mangle(name: str) -> str:
    """A name as one chunk of a key: its slashes become `%`."""
    return name.replace("/", "%")


def _entity(node: Node, entity: int, kind: EntityKind) -> str:
    # The two lone % are the empty security enclave and the empty namespace.
    return (
        f"{ADMIN_SPACE}/{node.domain}/{node.session}/{node.id}/{entity}/{kind}/%/%/"
        f"{mangle(node.name)}"
    )


def session_of_token(token: str) -> str:
    """Zenoh id of the session that declared a token.

    Raises:
        TransportError: Not a token.
    """
    chunks = token.split("/")
    if len(chunks) < 3 or chunks[0] != ADMIN_SPACE:
        raise TransportError(f"not a ROS 2 liveliness token: {token!r}")
    return chunks[2]


def node_of_token(token: str) -> str:
    """Name of the node that a token belongs to, without outer slashes; empty if it tells none.

    It is shown to people, and whoever declared it may have written anything: what cannot be printed
    becomes a question mark, and the first 64 characters have to do.
    """
    chunks = token.split("/")
    name = chunks[8].replace("%", "/").strip("/")[:_NAME_CHARACTERS] if len(chunks) > 8 else ""
    return "".join(c if c.isprintable() else "?" for c in name)


def is_token_of(token: str, kind: EntityKind, topic: Topic | Service) -> bool:
    """Whether a token announces an entity of a kind on a topic or service."""
    chunks = token.split("/")
    return len(chunks) > 9 and chunks[5] == kind and chunks[9] == mangle(topic.name)


def gid(token: str) -> bytes:
    """Global id of an entity: XXH3-128 of its token, low half first. 16 bytes."""
    digest = xxhash.xxh3_128_intdigest(token.encode())
    return digest.to_bytes(_GID_BYTES, "little")


def encode_attachment(sequence: int, source_time_ns: int, entity_gid: bytes) -> bytes:
    """The 33 bytes that go with every sample, request and reply.

    Args:
        sequence: Counts from 1 for each publisher or client.
        source_time_ns: Sender's wall clock, ns since 1970.
        entity_gid: `gid` of the sender. 16 bytes.
    """
    return _ATTACHMENT.pack(sequence, source_time_ns, _GID_BYTES, entity_gid)


def decode_attachment(attachment: bytes) -> tuple[int, int, bytes]:
    """Inverse of `encode_attachment`.

    Raises:
        TransportError: Not 33 bytes, or not of this format.
    """
    if len(attachment) != _ATTACHMENT.size or attachment[16] != _GID_BYTES:
        raise TransportError(
            f"attachment of {len(attachment)} bytes; rmw_zenoh sends {_ATTACHMENT.size}"
        )
    sequence, source_time_ns, _, entity_gid = _ATTACHMENT.unpack(attachment)
    return sequence, source_time_ns, entity_gid
