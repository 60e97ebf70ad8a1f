"""Robot server, robot model and transforms in ROS 2: `ros2 launch examples/ros2/yumi.launch.py`.

`robot_state_publisher` publishes `/robot_description` (std_msgs/String, transient local: whoever
comes later gets it, too) and, from the robot server's joint states, `/tf`. RViz shows the arm.
The shell has RMW_IMPLEMENTATION=rmw_zenoh_cpp, and `skewmi` on its PATH.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` starts; `backend:=hold` for an arm without a scene."""
    # The arm that moves; the other one's joints are in no message of a simulated robot.
    urdf = Command(["skewmi model --format urdf --left-arm absent"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("backend", default_value="sim"),
            ExecuteProcess(
                cmd=["skewmi", "robot", "--backend", LaunchConfiguration("backend")],
                output="screen",
            ),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[{"robot_description": ParameterValue(urdf, value_type=str)}],
                remappings=[("joint_states", "/yumi/joint_states")],
            ),
        ]
    )
