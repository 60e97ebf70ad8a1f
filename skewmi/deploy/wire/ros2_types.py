"""ROS 2 type definitions from rosbags: CDR, type hashes and schemas.

rosbags ships the messages of ROS 2 but no services, and none of ros2_control; these are added
here, so that their type hashes can be computed like the others.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from skewmi.deploy.wire.topics import CONTROLLER_STATE, TRIGGER

_TIME = (Nodetype.NAME, "builtin_interfaces/msg/Time")

_CONTROLLER_STATE = """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output
float64 speed_scaling_factor
"""
"""Of control_msgs 5.3 and later: ROS 2 Jazzy since November 2024, Kilted, Rolling."""


@cache
def store() -> Any:
    """The type store: ROS 2 Jazzy's definitions, the Trigger service and the controller state."""
    types = get_typestore(Stores.ROS2_JAZZY)
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
            types.fielddefs[info][0],
            [
                ("event_type", base("uint8")),
                ("stamp", _TIME),
                ("client_gid", (Nodetype.ARRAY, (base("uint8"), 16))),
                ("sequence_number", base("int64")),
            ],
        ),
    }
    types.fielddefs.update(definitions)
    types.register(get_types_from_msg(_CONTROLLER_STATE, CONTROLLER_STATE))
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
