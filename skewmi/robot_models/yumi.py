"""The one table of the ABB YuMi (IRB 14000-0.5/0.5): kinematics, limits, masses, gripper.

The MJCF (`mjcf`), the URDF (`urdf`) and the batched kinematics (`kinematics`) are all built from
the numbers below, and from nothing else. Units are m, rad, kg, s, N and N m. Joints are in chain
order, which in ABB's numbering is 1, 2, 7, 3, 4, 5, 6; links are numbered 1..7 along the chain.

Confidence of a number, as marked beside it:
    [A] two or more independent sources agree, or checked numerically.
    [B] one good source.
    [C] second-hand, estimated or derived.

Sources:
    BACKUP   parameter backups of three real controllers (RobotWare 6.04), published with
             github.com/kth-ros-pkg/yumi.
    HOME     home pose of the virtual YuMi in ABB RobotStudio, found in several repositories.
    DH       lengths: github.com/rparak/RoLE; Asgari, Bonev and Gosselin, Mech. Mach. Theory 205
             (2025) 105884; github.com/rpiRobotics/yumi-ik (with ten RobotStudio poses).
    OREBRO   github.com/OrebroUniversity/yumi: link frames, position and speed limits, finger
             frames. Its *lengths* are up to 3 mm off ABB's nominal model and are not used.
    SG       ABB's StateMachine Add-In RAPID module for the SmartGripper.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from math import pi, radians
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import NotFoundError

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
Side = Literal["right", "left"]

ARMS: tuple[Side, ...] = ("right", "left")
SUFFIX: dict[Side, str] = {"right": "r", "left": "l"}
ABB_AXES = (1, 2, 7, 3, 4, 5, 6)
"""ABB's number of each joint, along the chain."""

BODY_NAME = "yumi_body"


@dataclass(frozen=True)
class DhRow:
    """One row of the standard Denavit-Hartenberg table: Rz(q + offset) Tz(d) Tx(a) Rx(alpha)."""

    offset: float
    d: float
    a: float
    alpha: float


@dataclass(frozen=True)
class FrameOrigin:
    """Pose of a frame in its parent: p_parent = position + Rz(yaw) Ry(pitch) Rx(roll) p."""

    position: Vector
    rpy: Vector


@dataclass(frozen=True)
class Inertial:
    """Mass, centre of mass in the link frame, and inertia about it (xx, yy, zz, xy, xz, yz)."""

    mass: float
    centre: Vector
    inertia: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class JointRange:
    """Position bounds (rad) and the data sheet's speed (rad/s) of one joint."""

    lower: float
    upper: float
    velocity: float


@dataclass(frozen=True)
class Gripper:
    """ABB SmartGripper, servo module without camera and vacuum, frames relative to the flange."""

    base: Inertial
    base_length: float
    """Flange to the end of the servo module along z, m."""
    finger_origin_z: float
    """Flange to the finger frames along z, m."""
    finger_size: Vector
    """Straight finger: width along the slide axis x, depth y, length z, m."""
    finger_mass: float
    hook_length: float
    """How far the hook of the hooked finger reaches towards the other finger, m."""
    hook_height: float
    travel: float
    """Largest travel of each finger from closed, m."""
    speed: float
    """Largest speed of each finger, m/s."""
    force: float
    """Largest grip force, N."""


# Arm base in the robot base frame (BACKUP for the angles, HOME for the translation) [A].
# p_base = position + Rx(a) Ry(b) Rz(c) p_arm_base; the upper sign of ABB's angles is the left arm.
ARM_BASE_POSITION: dict[Side, Vector] = {
    "right": (0.0, -0.050, 0.384),
    "left": (0.0, 0.050, 0.384),
}
ARM_BASE_XYZ_ANGLES: dict[Side, Vector] = {
    "right": (0.629233, 0.950657, 0.184266),
    "left": (-0.629233, 0.950657, -0.184266),
}

# DH rows from the arm base to the flange (DH) [A]; both arms are the same arm.
DH_ROWS: tuple[DhRow, ...] = (
    DhRow(0.0, 0.166, -0.030, -pi / 2),
    DhRow(0.0, 0.0, 0.030, pi / 2),
    DhRow(0.0, 0.2515, 0.0405, -pi / 2),
    DhRow(-pi / 2, 0.0, 0.0405, -pi / 2),
    DhRow(pi, 0.265, 0.027, -pi / 2),
    DhRow(0.0, 0.0, -0.027, pi / 2),
    DhRow(0.0, 0.036, 0.0, 0.0),
)

# Arm base to the frame of link 1: DH's z = 0 plane moved up the axis and turned so that link 1's
# frame has OREBRO's orientation. Only the sums along an axis are physical (0.17283 + 0.07867,
# 0.16461 + 0.10039, 0.029 + 0.007); where they are split follows OREBRO's link frames [A].
LINK_1_HEIGHT = 0.066
LINK_ORIGINS: tuple[FrameOrigin, ...] = (
    FrameOrigin((0.0, 0.0, LINK_1_HEIGHT), (0.0, 0.0, pi)),
    FrameOrigin((0.030, 0.0, 0.100), (pi / 2, 0.0, 0.0)),
    FrameOrigin((-0.030, 0.17283, 0.0), (-pi / 2, 0.0, 0.0)),
    FrameOrigin((-0.0405, 0.0, 0.07867), (pi / 2, -pi / 2, 0.0)),
    FrameOrigin((0.0405, 0.16461, 0.0), (-pi / 2, 0.0, 0.0)),
    FrameOrigin((-0.027, 0.0, 0.10039), (pi / 2, 0.0, 0.0)),
    FrameOrigin((0.027, 0.029, 0.0), (-pi / 2, 0.0, 0.0)),
)
"""Frame of link i in link i - 1 (the first: in the arm base). Every joint turns about its +z."""

FLANGE_ORIGIN = FrameOrigin((0.0, 0.0, 0.007), (0.0, 0.0, pi))
"""tool0 in link 7: z out of the flange [A]."""

# OREBRO, BACKUP, RoLE and ABB's data sheet agree [A].
JOINT_RANGES: tuple[JointRange, ...] = (
    JointRange(radians(-168.5), radians(168.5), radians(180.0)),
    JointRange(radians(-143.5), radians(43.5), radians(180.0)),
    JointRange(radians(-168.5), radians(168.5), radians(180.0)),
    JointRange(radians(-123.5), radians(80.0), radians(180.0)),
    JointRange(radians(-290.0), radians(290.0), radians(400.0)),
    JointRange(radians(-88.0), radians(138.0), radians(400.0)),
    JointRange(radians(-229.0), radians(229.0), radians(400.0)),
)

# ABB publishes no joint torques. RoLE's URDF gives these without a source; they exceed the largest
# gravity torques of the estimate below (15.5, 16.0, 6.1, 4.8, 0.54, 0.26, 0.03 N m) [C].
JOINT_TORQUES = (36.0, 36.0, 12.0, 12.0, 6.0, 6.0, 6.0)

TCP_SPEED = 1.5
"""Largest speed of the tool, m/s; also the cap of collaborative operation (BACKUP) [A]."""

# Base mass and its centre (BACKUP) [B]; the inertia is a uniform box of the body's size [C].
BODY_INERTIAL = Inertial(24.18, (-0.061, 0.0, 0.063), (0.978, 1.152, 0.820, 0.0, 0.0, 0.0))

# Uniform density over closed coarse shapes, scaled to (38 - 24.18) / 2 = 6.91 kg an arm; expect
# 30 to 50 % error per link [C]. In the link frames above.
LINK_INERTIALS: tuple[Inertial, ...] = (
    Inertial(
        1.216, (0.0131, -0.0264, 0.0644), (3.19e-3, 3.27e-3, 2.12e-3, 0.31e-3, -0.63e-3, 0.84e-3)
    ),
    Inertial(
        1.970, (-0.0186, 0.0675, -0.0157), (9.87e-3, 3.22e-3, 9.76e-3, 1.49e-3, 0.37e-3, -1.81e-3)
    ),
    Inertial(
        0.921, (-0.0240, -0.0285, 0.0571), (1.63e-3, 1.90e-3, 1.45e-3, -0.26e-3, 0.45e-3, 0.41e-3)
    ),
    Inertial(
        1.621, (0.0234, 0.0588, -0.0157), (6.95e-3, 2.51e-3, 7.14e-3, -1.52e-3, -0.42e-3, -1.31e-3)
    ),
    Inertial(
        0.481, (-0.0094, -0.0304, 0.0532), (0.97e-3, 0.91e-3, 0.51e-3, -0.07e-3, 0.18e-3, 0.30e-3)
    ),
    Inertial(
        0.643, (0.0126, -0.0111, -0.0118), (0.66e-3, 0.66e-3, 0.72e-3, -0.01e-3, -0.04e-3, 0.03e-3)
    ),
    Inertial(0.059, (0.0, -0.0007, -0.0004), (0.01e-3, 0.01e-3, 0.02e-3, 0.0, 0.0, 0.0)),
)

GRIPPER = Gripper(
    base=Inertial(0.215, (0.0087, 0.0123, 0.0492), (1.7e-4, 2.0e-4, 0.8e-4, 0.0, 0.0, 0.0)),  # [A]
    base_length=0.084,  # SG [A]
    finger_origin_z=0.0837,  # OREBRO [A]
    # Our own straight fingers, as long as ABB's default ones (mesh of OREBRO: 52 mm) [C].
    finger_size=(0.010, 0.014, 0.052),
    # ABB gives 15 g for a pair of default fingers (SG) [A]; ours have the volume for it in plastic.
    finger_mass=0.0075,
    # The hook of the paper's model (github.com/pcchenxi/skew-explore), on the finger at +x.
    hook_length=0.010,
    hook_height=0.010,
    travel=0.025,  # [A]
    speed=0.025,  # [A]
    force=20.0,  # [A]
)

HOME: dict[Side, tuple[float, ...]] = {
    "right": tuple(radians(x) for x in (0.0, -130.0, -135.0, 30.0, 0.0, 40.0, 0.0)),
    "left": tuple(radians(x) for x in (0.0, -130.0, 135.0, 30.0, 0.0, 40.0, 0.0)),
}
"""ABB's calibration and home pose, chain order, rad [A]."""

TABLE_CONFIGURATION: tuple[float, ...] = (
    1.08840787256,
    -1.092232981278,
    -1.161771473331,
    0.810646601243,
    -2.045498898542,
    1.302377094009,
    2.703636228566,
)
"""Right arm ready for work on the table: hand at (-0.009, -0.1345, 0.270) in the task world,
straight down, rad, chain order. Found by `start_search`, which says how it was chosen."""

MIRROR_SIGNS = (-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
"""The other arm at `q * MIRROR_SIGNS` is this arm mirrored in the robot's x-z plane."""

POSITION_LOWER: Array = np.array([joint.lower for joint in JOINT_RANGES])
POSITION_UPPER: Array = np.array([joint.upper for joint in JOINT_RANGES])
VELOCITY: Array = np.array([joint.velocity for joint in JOINT_RANGES])
TORQUE: Array = np.array(JOINT_TORQUES)
for _array in (POSITION_LOWER, POSITION_UPPER, VELOCITY, TORQUE):
    _array.flags.writeable = False


def suffix(side: Side) -> str:
    """`r` or `l`.

    Raises:
        NotFoundError: `side` is not an arm.
    """
    try:
        return SUFFIX[side]
    except (KeyError, TypeError):
        raise NotFoundError(f"no arm {side!r}; arms are {', '.join(ARMS)}") from None


def joint_names(side: Side) -> tuple[str, ...]:
    """Names of the seven joints of an arm, chain order."""
    return tuple(f"yumi_joint_{axis}_{suffix(side)}" for axis in ABB_AXES)


def link_names(side: Side) -> tuple[str, ...]:
    """Names of the seven links of an arm, numbered along the chain."""
    return tuple(f"yumi_link_{number}_{suffix(side)}" for number in range(1, 8))


def finger_names(side: Side) -> tuple[str, str]:
    """Names of the two finger joints; the second mimics the first. Positive opens."""
    return f"gripper_{suffix(side)}_joint", f"gripper_{suffix(side)}_joint_m"


def tool_name(side: Side) -> str:
    """Name of the flange frame (MJCF site, URDF link)."""
    return f"tool0_{suffix(side)}"


def _model_hash() -> str:
    table = {
        "arm_base": [ARM_BASE_POSITION, ARM_BASE_XYZ_ANGLES],
        "dh": [asdict(row) for row in DH_ROWS],
        "links": [asdict(origin) for origin in (*LINK_ORIGINS, FLANGE_ORIGIN)],
        "ranges": [asdict(joint) for joint in JOINT_RANGES],
        "torques": JOINT_TORQUES,
        "inertials": [asdict(inertial) for inertial in (BODY_INERTIAL, *LINK_INERTIALS)],
        "gripper": asdict(GRIPPER),
        "names": [[joint_names(side), finger_names(side)] for side in ARMS],
    }
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


MODEL_HASH: str = _model_hash()
"""sha256 of the table, hexadecimal; travels with policies and recordings."""
