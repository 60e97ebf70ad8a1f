"""ROS 2 types by rosbags: CDR, type hashes and schemas.

Messages are made of their definitions (`ros2_definitions`). rosbags knows no services; the one
that is used is put together here, so that its type hash can be computed like the others.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from skewmi.deploy.wire.ros2_definitions import DEFINITIONS
from skewmi.deploy.wire.topics import TRIGGER

_TIME = (Nodetype.NAME, "builtin_interfaces/msg/Time")


@cache
def store() -> Any:
    """The type store: our messages and the Trigger service."""
    types = get_typestore(Stores.EMPTY)
    messages: dict[str, Any] = {}
    for name, text in DEFINITIONS.items():
        messages |= get_types_from_msg(text, name)
    types.register(messages)
    request, response, event = f"{TRIGGER}_Request", f"{TRIGGER}_Response", f"{TRIGGER}_Event"
    info = "service_msgs/msg/ServiceEventInfo"

    def base(name: str) -> tuple[Any, Any]:
        return Nodetype.BASE, (name, 0)

    def at_most_one(name: str) -> tuple[Any, Any]:
        return Nodetype.SEQUENCE, ((Nodetype.NAME, name), 1)

    definitions: dict[str, Any] = {
        request: ([], []),
        response: ([], [("success", base("bool")), ("message", base("string"))]),
        event: (
            [],
            [
                ("info", (Nodetype.NAME, info)),
                ("request", at_most_one(request)),
                ("response", at_most_one(response)),
            ],
        ),
        TRIGGER: (
            [],
            [
                ("request_message", (Nodetype.NAME, request)),
                ("response_message", (Nodetype.NAME, response)),
                ("event_message", (Nodetype.NAME, event)),
            ],
        ),
        # ROS 2 hashes the gid's `char` as uint8; rosbags does not.
        info: (
            [],
            [
                ("event_type", base("uint8")),
                ("stamp", _TIME),
                ("client_gid", (Nodetype.ARRAY, (base("uint8"), 16))),
                ("sequence_number", base("int64")),
            ],
        ),
    }
    types.fielddefs.update(definitions)
    return types


def message_class(type_name: str) -> Any:
    """rosbags' dataclass of a message type."""
    return store().types[type_name]


@cache
def type_hash(type_name: str) -> str:
    """RIHS01 hash (REP 2016) of a message or service type."""
    return str(store().hash_rihs01(type_name))


@cache
def schema(type_name: str) -> str:
    """Message definition text with those it refers to, as an MCAP `ros2msg` schema holds it."""
    return str(store().generate_msgdef(type_name, ros_version=2)[0])


def encode(message: Any, type_name: str) -> bytes:
    """Little-endian CDR of a rosbags message."""
    return bytes(store().serialize_cdr(message, type_name))


def decode(payload: bytes, type_name: str) -> Any:
    """rosbags message of CDR bytes; raises what `messages.MALFORMED` lists."""
    return store().deserialize_cdr(payload, type_name)
