"""The ROS 2 examples, without ROS 2: a node on a real robot server, a launch file's content."""

from __future__ import annotations

import runpy
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from secured_link import robot_process

from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import topics
from skewmi.robot_models import yumi

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "ros2"


@pytest.mark.slow
def test_the_node_tells_joints_and_state() -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    stand_in = ROOT / "tests" / "support" / "ros2_stand_in.py"
    with (
        robot_process("--backend", "hold", "--listen", locator),
        subprocess.Popen(
            [sys.executable, str(stand_in), str(EXAMPLES / "joint_states.py"), locator],
            stdout=subprocess.PIPE,
            text=True,
        ) as node,
    ):
        assert node.stdout is not None
        told: dict[str, str] = {}
        try:
            while len(told) < 2:
                line = node.stdout.readline()
                assert line, "it has ended"
                told["joints" if "joints" in line else "state"] = line
        finally:
            node.kill()
    home = ", ".join(f"{angle * 57.29577951308232:.1f}" for angle in yumi.HOME["right"])
    assert told["joints"] == f"[listener]: joints {home} deg\n"
    assert told["state"].startswith("[listener]: disarmed: ")


def recorded(kind: str) -> Callable[..., SimpleNamespace]:
    """In the place of a class: an object that knows what it was made of."""
    return lambda *given, **named: SimpleNamespace(kind=kind, given=given, **named)


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What the launch file would start."""
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "ExecuteProcess"],
        "launch.substitutions": ["Command", "LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
    }
    for name, classes in names.items():
        module = ModuleType(name)
        module.__dict__.update({each: recorded(each) for each in classes})
        monkeypatch.setitem(sys.modules, name, module)
    made = runpy.run_path(str(EXAMPLES / "yumi.launch.py"))["generate_launch_description"]()
    return list(made.given[0])


def test_the_launch_file_describes_the_robot_that_it_starts(launched: list[Any]) -> None:
    server, publisher = (e for e in launched if e.kind in ("ExecuteProcess", "Node"))
    assert server.cmd[:2] == ["skewmi", "robot"]
    assert publisher.package == publisher.executable == "robot_state_publisher"
    assert publisher.remappings == [("joint_states", topics.YUMI_JOINT_STATES.name)]
    (parameters,) = publisher.parameters
    ((command,),) = parameters["robot_description"].given[0].given
    program, *arguments = command.split()
    assert program == "skewmi"
    urdf = subprocess.run(
        [sys.executable, "-m", "skewmi.cli.main", *arguments],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    joints = {joint.get("name") for joint in ET.fromstring(urdf).iter("joint")}
    moving = (*yumi.joint_names("right"), yumi.finger_names("right")[0])
    # Every joint of a simulated robot's joint states, and none that no message tells.
    assert joints >= set(moving)
    movable = {j.get("name") for j in ET.fromstring(urdf).iter("joint") if j.get("type") != "fixed"}
    assert movable == {*moving, yumi.finger_names("right")[1]}
