"""What a simulated robot adds to its status, so that a picture of a run can show it.

Where the scene really stands, which a variation changes and nobody is told otherwise, and the
contact forces of the last cycles, which no topic has. Policies and sessions do not read either.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import TransportError

SCENE_POSES = "scene_poses"
"""Key of the status: JSON list of `ScenePose`, for whatever stands elsewhere than described."""
CONTACT_FORCES = "contact_forces"
"""Key of the status: JSON object of `ContactForces`, each cycle told once."""

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScenePose:
    """Where some parts of a scene stand: p_there = R p_described + translation, in world."""

    parts: tuple[str, ...]
    """Names of `wire.scene_geometry.ScenePart`."""
    translation: tuple[float, ...]
    """m. Three numbers."""
    quaternion_wxyz: tuple[float, ...]
    """R. Four numbers."""


@dataclass(frozen=True)
class ContactForces:
    """Largest contact forces in each published cycle, by the robot server's clock."""

    stamps_ns: NDArray[np.int64]
    """End of each cycle. Shape (n,)."""
    hand_n: _Array
    """Net force on hand and wrist, N. Shape (n,)."""
    arm_n: _Array
    """Net force on the rest of the arm, N. Shape (n,)."""


def encode_poses(poses: Sequence[ScenePose]) -> str:
    """Inverse of `decode_poses`."""
    return json.dumps([asdict(pose) for pose in poses], separators=(",", ":"))


def decode_poses(values: Mapping[str, str]) -> tuple[ScenePose, ...] | None:
    """Poses in the values of a status; None if it does not tell any.

    Raises:
        TransportError: They cannot be read.
    """
    if SCENE_POSES not in values:
        return None
    try:
        return tuple(_pose(content) for content in json.loads(values[SCENE_POSES]))
    except (ValueError, KeyError, TypeError) as error:
        raise TransportError(f"the scene's poses cannot be read: {error}") from error


def _pose(content: Mapping[str, list[float]]) -> ScenePose:
    translation = tuple(float(value) for value in content["translation"])
    quaternion = tuple(float(value) for value in content["quaternion_wxyz"])
    if len(translation) != 3 or len(quaternion) != 4:
        raise ValueError(f"{len(translation)} and {len(quaternion)} numbers in place of 3 and 4")
    if not np.isfinite([*translation, *quaternion]).all():
        raise ValueError("a number is not finite")
    return ScenePose(tuple(str(name) for name in content["parts"]), translation, quaternion)


def encode_forces(forces: ContactForces) -> str:
    """Inverse of `decode_forces` but for rounding to 0.01 N and whole ms between the stamps."""
    first_ns = int(forces.stamps_ns[0]) if len(forces.stamps_ns) else 0
    after_ms = (forces.stamps_ns - first_ns) // 1_000_000
    content = {
        "first_ns": first_ns,
        "after_ms": after_ms.tolist(),
        "hand_n": np.round(forces.hand_n, 2).tolist(),
        "arm_n": np.round(forces.arm_n, 2).tolist(),
    }
    return json.dumps(content, separators=(",", ":"))


def decode_forces(values: Mapping[str, str]) -> ContactForces | None:
    """Forces in the values of a status; None if it does not tell any.

    Raises:
        TransportError: They cannot be read.
    """
    if CONTACT_FORCES not in values:
        return None
    try:
        content = json.loads(values[CONTACT_FORCES])
        after_ns = np.array(content["after_ms"], dtype=np.int64).reshape(-1) * 1_000_000
        hand, arm = (np.array(content[key], dtype=np.float64) for key in ("hand_n", "arm_n"))
        if not hand.shape == arm.shape == after_ns.shape:
            raise ValueError("lengths disagree")
        return ContactForces(int(content["first_ns"]) + after_ns, hand, arm)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise TransportError(f"contact forces cannot be read: {error}") from error
