"""What a robot server says about itself on `/yumi/describe`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import inf
from typing import Any

from skewmi.errors import ConfigurationError, TransportError
from skewmi.robot_models.base_frame import BaseFrame, BoxPose, base_of
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_NS

FLANGE_SPEED = "flange_speed"
"""Key of `RobotDescription.limits`."""
JOINT_SPEED = "joint_speed"
"""Likewise."""

EGM = "egm"
"""Key of a recording's metadata: `RobotDescription.egm`, a JSON object."""
ROBOT_CALIBRATION = "robot_calibration"
"""Key of a recording's metadata: `RobotDescription.calibration`."""

BOX_POSE = "box_pose"
"""Likewise: `RobotDescription.box_pose`, a JSON object; missing without one."""

SCENE_REQUEST = b"scene"
"""Extra bytes of a describe request that ask for the scene's shapes, too."""


@dataclass(frozen=True)
class RobotDescription:
    """What a robot server says about itself; the session compares it with what the policy needs."""

    backend: str
    task: str
    layout_hashes: tuple[str, ...]
    robot_model_hash: str
    limit_profile: str
    lock_step: bool
    simulated: bool
    """Whether robot and scene are simulated."""
    grid_ns: int
    state_period_ns: int
    state: str
    reason: str
    clock_ns: int
    """The robot server's clock: when the next sample is due."""
    joint_names: tuple[str, ...]
    commanded_position: tuple[float, ...]
    """Where the plan ends, rad: the point a new commander's first chunk starts from."""
    stops: int
    """How often somebody has asked to stop since the robot server started."""
    limits: Mapping[str, tuple[float, ...]]
    """The bounds of the limit profile per joint, so that both sides can compare them; and, of
    a robot that admits less, the flange's speed, m/s, and that of any joint, rad/s."""
    stop_paths: tuple[str, ...] = ()
    """Where the arm can be stopped by datagrams, such as udp/127.0.0.1:7447; see `stop_path`."""
    contact: Mapping[str, float] = field(default_factory=dict)
    """Largest of `skewmi.contact.QUANTITIES` since the scene's last reset; empty if unknown."""
    resettable: bool = False
    """Whether the scene can be reset by a message."""
    cycle_ns: int = GRID_NS
    """Nominal time between two cycles of the robot's own, in which it measures."""
    ready: bool = True
    """Whether the arm can be commanded once somebody has armed."""
    not_ready: str = ""
    """What is missing, if it cannot."""
    scene: str = ""
    """Shapes of the scene, as `SceneGeometry.to_json`; only in answers to requests for it."""
    calibration: str = ""
    """Fingerprint of the calibration that its servos get feed-forward from; empty without one."""
    egm: Mapping[str, float] = field(default_factory=dict)
    """Of a controller behind EGM, as the robot server was told: `gain` (1/s) and `low_pass_hz` of
    its law, and `speed_share`, the part of the plan's speed that it is sent. Empty for others."""
    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Global ids of those whose states and status are to be believed, by topic, hexadecimal: the
    robot server's own, and whoever publishes the scene's states for it."""

    workspaces: Mapping[str, Mapping[str, tuple[float, ...]]] = field(default_factory=dict)
    """Boxes of the flange by name, m, robot base frame: `low` and `high` of the task's, and of
    those that can be asked for at arming as `safety.flange_space.FlangeSpace.numbers`."""
    workspace: str = "task"
    """The one that holds now."""
    box_pose: Mapping[str, float] = field(default_factory=dict)
    """Where the task's box is known to stand, as `BoxPose.as_mapping`: the task's workspace and the
    scene are in its frame. Empty if nobody looked for it: it is where the task has it."""

    @property
    def box(self) -> BoxPose | None:
        """`box_pose`, read.

        Raises:
            TransportError: It is none, or one that nobody can work with.
        """
        try:
            return BoxPose.of_mapping(self.box_pose)
        except ConfigurationError as error:
            raise TransportError(f"the robot server tells of a box: {error}") from error

    @property
    def base_frame(self) -> BaseFrame:
        """The robot base in the task's frame, which `scene` is told in."""
        return base_of(self.box)

    @property
    def scene_fields(self) -> dict[str, str]:
        """Observation field of each joint that the scene states tell; only with the scene.

        Raises:
            TransportError: The scene is not a description of one.
        """
        try:
            joints = json.loads(self.scene)["joints"] if self.scene else []
            return {joint["name"]: joint["field"] for joint in joints if joint.get("field")}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise TransportError(f"the robot server's scene cannot be read ({error})") from error

    def to_json(self) -> str:
        """One JSON object; floats at full precision."""
        # Not `asdict`: its deep copies are four fifths of the time of an answer that the robot's
        # loop gives between two cycles.
        content = {field.name: getattr(self, field.name) for field in fields(self)}
        return json.dumps(content, sort_keys=True, default=dict)

    @staticmethod
    def from_json(text: str) -> RobotDescription:
        """Inverse of `to_json`; what later versions may add is passed over.

        Raises:
            TransportError: The text is not a description, or one of another version.
        """
        try:
            content: dict[str, Any] = json.loads(text)
            for name in ("joint_names", "layout_hashes", "stop_paths"):
                content[name] = tuple(content.get(name, ()))
            content["commanded_position"] = tuple(map(float, content["commanded_position"]))
            content["stops"] = int(content["stops"])
            content["contact"] = {k: float(v) for k, v in content["contact"].items()}
            content["limits"] = {k: tuple(v) for k, v in content["limits"].items()}
            content["egm"] = {k: float(v) for k, v in content.get("egm", {}).items()}
            content["box_pose"] = {k: float(v) for k, v in content.get("box_pose", {}).items()}
            publishers = content.get("publishers", {})
            content["publishers"] = {k: tuple(map(str, v)) for k, v in publishers.items()}
            workspaces = content.get("workspaces", {})
            content["workspaces"] = {
                name: {k: tuple(map(float, v)) for k, v in numbers.items()}
                for name, numbers in workspaces.items()
            }
            known = {field.name for field in fields(RobotDescription)}
            return RobotDescription(**{k: v for k, v in content.items() if k in known})
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise TransportError(
                f"the robot server's description cannot be read ({error}); "
                "is it of another version of skewmi?"
            ) from error


def recorded_facts(description: RobotDescription) -> dict[str, str]:
    """What recordings keep of a robot server, so that it is known what their commands met."""
    facts = {"backend": description.backend, ROBOT_CALIBRATION: description.calibration}
    if description.egm:
        facts[EGM] = json.dumps(dict(description.egm))
    if description.box_pose:
        facts[BOX_POSE] = json.dumps(dict(description.box_pose))
    return facts


def admitted(limits: JointLimits, description: RobotDescription) -> JointLimits:
    """A profile's limits as far as a robot follows them."""
    return limits.no_faster(min(description.limits.get(JOINT_SPEED, (inf,))))


def limit_values(limits: JointLimits) -> dict[str, tuple[float, ...]]:
    """The bounds that session and robot server compare, per joint, rad and s."""
    names = ("position_lower", "position_upper", "velocity", "acceleration", "jerk")
    return {name: tuple(map(float, getattr(limits, name))) for name in names}
