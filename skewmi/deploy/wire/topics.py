"""Names, types and delivery of everything that travels between session and robot server.

This is the only place where a topic is named. How a name becomes a key on the wire is in
`ros2_keys`, what the bytes mean in `messages`; docs/wire.md shows both on one page.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Topic:
    """A ROS 2 topic."""

    name: str
    """ROS name with its leading slash."""
    type_name: str
    """ROS type, package/msg/Type."""
    command: bool = False
    """Whether its messages move the robot: sent at real-time priority, ahead of everything."""


@dataclass(frozen=True)
class Service:
    """A ROS 2 service of type std_srvs/srv/Trigger."""

    name: str
    type_name: str = "std_srvs/srv/Trigger"


JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
JOINT_STATE = "sensor_msgs/msg/JointState"
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
TRIGGER = "std_srvs/srv/Trigger"

YUMI_TRAJECTORY = Topic("/yumi/right/joint_trajectory", JOINT_TRAJECTORY, command=True)
"""Commands: chunks on the 4 ms grid that end at rest; positions, velocities, accelerations."""
YUMI_GRIPPER = Topic("/yumi/right/gripper", JOINT_STATE, command=True)
"""Commanded finger opening: one position, metres of travel per finger from closed."""
YUMI_JOINT_STATES = Topic("/yumi/joint_states", JOINT_STATE)
"""Measured arm joints (rad, rad/s, N m) and finger (m)."""
YUMI_CONTROLLER_STATE = Topic("/yumi/right/controller_state", CONTROLLER_STATE)
"""What was written to the arm in each cycle of its own, and what it measured. Recorded only."""
YUMI_SCENE_STATES = Topic("/yumi/scene_states", JOINT_STATE)
"""Measured joints of the scene: hinges (rad) and slides (m), as the task names them."""
YUMI_STATUS = Topic("/yumi/status", DIAGNOSTIC_ARRAY)
"""State machines of robot server and session: each transition with its reason."""

POLICY_OBSERVATION = Topic("/skewmi/policy_observation", JOINT_STATE)
"""What the policy saw: names are the layout's fields, positions their values. Recorded only."""
POLICY_ACTION = Topic("/skewmi/policy_action", JOINT_STATE)
"""What the policy answered, in [-1, 1]. Recorded only."""

YUMI_ARM = Service("/yumi/arm")
"""Become the one commander; refused with a reason."""
YUMI_DISARM = Service("/yumi/disarm")
"""Give the arm back: smooth stop, for the commander alone. Acknowledges no fault."""
YUMI_STOP = Service("/yumi/stop")
"""Smooth stop; anybody may call it. Acknowledges a fault once the arm rests."""
YUMI_DESCRIBE = Service("/yumi/describe")
"""The robot server describes itself: JSON in the reply's message."""
YUMI_SCENE_RESET = Service("/yumi/scene/reset")
"""Put the scene and the arm back to the start of an episode. Simulated robots only."""

TOPICS = (
    YUMI_TRAJECTORY,
    YUMI_GRIPPER,
    YUMI_JOINT_STATES,
    YUMI_CONTROLLER_STATE,
    YUMI_SCENE_STATES,
    YUMI_STATUS,
    POLICY_OBSERVATION,
    POLICY_ACTION,
)
SERVICES = (YUMI_ARM, YUMI_DISARM, YUMI_STOP, YUMI_DESCRIBE, YUMI_SCENE_RESET)
