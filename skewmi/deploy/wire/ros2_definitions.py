"""The ROS 2 messages that travel, as their packages define them.

rosbags brings every message of a ROS 2 release, which takes a quarter of a second to load, in each
process; these are the ones that are used, of ROS 2 Jazzy. A test compares them with rosbags'.
"""

from __future__ import annotations

from skewmi.deploy.wire.topics import CONTROLLER_STATE

DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/msg/Duration": """
int32 sec
uint32 nanosec
""",
    "builtin_interfaces/msg/Time": """
int32 sec
uint32 nanosec
""",
    "diagnostic_msgs/msg/DiagnosticArray": """
std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
""",
    "diagnostic_msgs/msg/DiagnosticStatus": """
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
""",
    "diagnostic_msgs/msg/KeyValue": """
string key
string value
""",
    "geometry_msgs/msg/Quaternion": """
float64 x
float64 y
float64 z
float64 w
""",
    "geometry_msgs/msg/Transform": """
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
""",
    "geometry_msgs/msg/Twist": """
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
""",
    "geometry_msgs/msg/Vector3": """
float64 x
float64 y
float64 z
""",
    "sensor_msgs/msg/JointState": """
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
""",
    "std_msgs/msg/Header": """
builtin_interfaces/Time stamp
string frame_id
""",
    "trajectory_msgs/msg/JointTrajectory": """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint[] points
""",
    "trajectory_msgs/msg/JointTrajectoryPoint": """
float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start
""",
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint": """
geometry_msgs/Transform[] transforms
geometry_msgs/Twist[] velocities
geometry_msgs/Twist[] accelerations
builtin_interfaces/Duration time_from_start
""",
    # Of control_msgs 5.3 and later: ROS 2 Jazzy since November 2024, Kilted, Rolling.
    CONTROLLER_STATE: """
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
""",
}
"""Type -> its definition; types are named without `msg` inside."""
