"""CDR by others: rosbags with its own ROS 2 Jazzy definitions where it has them, mcap_ros2 with
those written here.

The two share no code. Nothing of skewmi is imported.
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\n"
        "float64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    "trajectory_msgs/msg/JointTrajectory": (
        "std_msgs/Header header\nstring[] joint_names\nJointTrajectoryPoint[] points"
    ),
    "trajectory_msgs/msg/JointTrajectoryPoint": (
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start"
    ),
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint": (
        "geometry_msgs/Transform[] transforms\ngeometry_msgs/Twist[] velocities\n"
        "geometry_msgs/Twist[] accelerations\nbuiltin_interfaces/Duration time_from_start"
    ),
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/msg/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
    ),
    "geometry_msgs/msg/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "control_msgs/msg/JointTrajectoryControllerState": (
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint reference\n"
        "trajectory_msgs/JointTrajectoryPoint feedback\n"
        "trajectory_msgs/JointTrajectoryPoint error\n"
        "trajectory_msgs/JointTrajectoryPoint output\n"
        "string[] multi_dof_joint_names\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output\n"
        "float64 speed_scaling_factor"
    ),
    "diagnostic_msgs/msg/DiagnosticArray": (
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status"
    ),
    "diagnostic_msgs/msg/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values"
    ),
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
}
"""Of ROS 2 Jazzy's interfaces, without their comments."""

TRIGGER = "std_srvs/srv/Trigger"
TRIGGER_REQUEST = "# no fields"  # the SDK takes an empty text for a missing one
TRIGGER_RESPONSE = "bool success\nstring message"
RESPONSE = f"{TRIGGER}_Response"


def plain(value: Any) -> Any:
    """A decoded message, whosever class it has, as dictionaries and lists of its fields."""
    if dataclasses.is_dataclass(value):
        names = [f.name for f in dataclasses.fields(value)]
        return {n: plain(getattr(value, n)) for n in names if n[0] != "_" and not n.isupper()}
    if isinstance(value, SimpleNamespace):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, list):
        return [plain(each) for each in value]
    return value.tolist() if hasattr(value, "tolist") else value


class Codecs:
    """Decodes and encodes with both."""

    def __init__(self) -> None:
        self._jazzy = get_typestore(Stores.ROS2_JAZZY)
        fields = [("success", "bool"), ("message", "string")]
        self._jazzy.register(
            {RESPONSE: ([], [(name, (Nodetype.BASE, (kind, 0))) for name, kind in fields])}
        )
        for type_name, text in DEFINITIONS.items():
            if type_name not in self._jazzy.types:
                self._jazzy.register(get_types_from_msg(text, type_name))
        texts = DEFINITIONS | {RESPONSE: TRIGGER_RESPONSE}
        self._decoders: dict[str, Any] = {}
        self._encoders: dict[str, Any] = {}
        for type_name, text in texts.items():
            parts = [text]
            for other, definition in texts.items():
                if other != type_name and "/msg/" in other:
                    parts += ["=" * 80, f"MSG: {other.replace('/msg/', '/')}", definition]
            schema = "\n".join(parts)
            self._decoders[type_name] = generate_dynamic(type_name, schema)[type_name]
            self._encoders[type_name] = serialize_dynamic(type_name, schema)[type_name]

    def judge(self, payload: bytes, type_name: str) -> dict[str, Any]:
        """The message, and whether both read the same and write the payload's bytes again."""
        by_rosbags = self._jazzy.deserialize_cdr(payload, type_name)
        by_mcap = self._decoders[type_name](payload)
        return {
            "message": plain(by_rosbags),
            "same_values": plain(by_rosbags) == plain(by_mcap),
            "same_bytes": bytes(self._jazzy.serialize_cdr(by_rosbags, type_name)) == payload
            and self._encoders[type_name](by_mcap) == payload,
        }
