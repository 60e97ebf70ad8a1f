"""Boxes and joints of a scene as plain data, so that a recording can be drawn without it.

A robot server that knows its scene describes it; the recorder keeps the description; replay draws
the boxes and moves them by the recorded scene joints.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from skewmi.errors import ConfigurationError

Vector = tuple[float, ...]


@dataclass(frozen=True)
class ScenePart:
    """One box, where it is while all scene joints are zero."""

    name: str
    joint: str
    """Scene joint that moves it; empty if it never moves."""
    half_size: Vector
    """m. Three numbers."""
    position: Vector
    """Centre in world, m. Three numbers."""
    quaternion_wxyz: Vector
    """Orientation in world. Four numbers."""
    colour: Vector
    """Red, green, blue, alpha, each 0..1."""


@dataclass(frozen=True)
class SceneJoint:
    """A hinge or slide of the scene."""

    name: str
    kind: str
    """"hinge" (rad) or "slide" (m)."""
    anchor: Vector
    """A point of the axis in world, m."""
    axis: Vector
    """Unit vector in world."""
    field: str = ""
    """Observation field that the joint's position is; empty if the task does not observe it."""


@dataclass(frozen=True)
class SceneGeometry:
    """What replay draws beside the robot."""

    parts: tuple[ScenePart, ...]
    joints: tuple[SceneJoint, ...]

    def to_json(self) -> str:
        """Inverse of `from_json`."""
        return json.dumps(asdict(self), separators=(",", ":"))

    @staticmethod
    def from_json(text: str) -> SceneGeometry:
        """Read a description.

        Raises:
            ConfigurationError: It is not one.
        """
        try:
            content = json.loads(text)
            return SceneGeometry(
                tuple(ScenePart(**_tuples(part)) for part in content["parts"]),
                tuple(SceneJoint(**_tuples(joint)) for joint in content["joints"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ConfigurationError(f"not a scene description: {error}") from error


def _tuples(content: dict[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in content.items()}
