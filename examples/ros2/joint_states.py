"""A ROS 2 node that listens to the robot server: where the arm is, and what state it is in.

export RMW_IMPLEMENTATION=rmw_zenoh_cpp     # Jazzy or newer; connects to tcp/localhost:7447
skewmi robot --backend sim                  # elsewhere
python3 examples/ros2/joint_states.py       # needs nothing of skewmi
"""

import math

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState


class Listener(Node):
    """Tells joint angles once a second, and each change of the robot server's state."""

    def __init__(self) -> None:
        super().__init__("listener")
        self.told_s, self.state = 0, ""
        self.create_subscription(JointState, "/yumi/joint_states", self.joints, 10)
        self.create_subscription(DiagnosticArray, "/yumi/status", self.status, 10)

    def joints(self, message: JointState) -> None:
        if message.header.stamp.sec != self.told_s:  # the robot server's clock
            self.told_s = message.header.stamp.sec
            angles = [f"{math.degrees(q):.1f}" for q in message.position[:7]]
            self.get_logger().info(f"joints {', '.join(angles)} deg")

    def status(self, message: DiagnosticArray) -> None:
        values = {pair.key: pair.value for pair in message.status[0].values}
        if message.status[0].name == "skewmi_robot" and values["state"] != self.state:
            self.state = values["state"]
            self.get_logger().info(f"{self.state}: {values['reason']}")


rclpy.init()
rclpy.spin(Listener())
