"""The upright faces of a scene's box where it is believed to stand, and places to touch them.

Everything in the robot base frame, in which the box is believed to stand with its sides along the
axes. It is displaced by (x, y) and turned by yaw about the vertical through the middle of its
footprint; `scene_fit` finds these three.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models.yumi import Array

SHIFT, TURN = 0.006, radians(4.0)
"""How far the box may be from where it is believed to stand: m along each axis, and rad."""
_FLUSH = 0.0005
"""Distance from the outermost plane at which a part still belongs to a face, m."""

FACES: dict[str, tuple[int, float]] = {
    "near": (0, -1.0),
    "far": (0, 1.0),
    "right": (1, -1.0),
    "left": (1, 1.0),
}
"""Name of a face as the robot sees it -> axis and sign of its normal."""


@dataclass(frozen=True)
class Part:
    """A box of the scene that does not move, sides along the axes, m."""

    name: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True)
class Face:
    """One upright side of the box around all that stands still.

    Attributes:
        name: Of `FACES`.
        axis: 0 or 1: of its normal.
        sign: Of its normal along that axis.
        middle: Of the footprint, which the box turns about. x and y, m.
        distance: From the middle to the face, m.
        reach: Half of its width, m.
    """

    name: str
    axis: int
    sign: float
    middle: tuple[float, float]
    distance: float
    reach: float

    @property
    def normal(self) -> Array:
        """Outwards. Shape (3,)."""
        normal = np.zeros(3)
        normal[self.axis] = self.sign
        return normal

    @property
    def along(self) -> Array:
        """Horizontal, in the face. Shape (3,)."""
        along = np.zeros(3)
        along[1 - self.axis] = 1.0
        return along

    def place(self, offset: float, height: float) -> Array:
        """A point of it, `offset` m from the middle along it. Shape (3,)."""
        middle = np.array([*self.middle, height])
        point: Array = middle + self.distance * self.normal + offset * self.along
        return point

    def sure_reach(self, half_width: float) -> float:
        """How far from its middle a finger meets it wherever the box may stand, m.

        Args:
            half_width: Of the finger along the face, m.
        """
        lost = SHIFT + sin(TURN) * self.distance + self.reach * (1.0 - cos(TURN))
        return self.reach - lost - half_width


def faces_of(parts: Sequence[Part]) -> dict[str, Face]:
    """The four sides of the box around parts that stand still.

    Raises:
        ConfigurationError: There is none.
    """
    if not parts:
        raise ConfigurationError("the scene has no parts that stand still: nothing to touch")
    low = np.min([part.low for part in parts], axis=0)
    high = np.max([part.high for part in parts], axis=0)
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    return {
        name: Face(
            name,
            axis,
            sign,
            (float(middle[0]), float(middle[1])),
            float(half[axis]),
            float(half[1 - axis]),
        )
        for name, (axis, sign) in FACES.items()
    }


def top_of(face: Face, parts: Sequence[Part], offset: float, half_width: float) -> float:
    """Height up to which a face is there for the whole width of a finger, m.

    Args:
        face: One of `faces_of(parts)`.
        parts: That stand still.
        offset: Of the finger from the face's middle, m.
        half_width: Of the finger, m.

    Raises:
        ConfigurationError: The face has a gap there.
    """
    plane = face.place(offset, 0.0)[face.axis]
    along = 1 - face.axis
    flush = [
        part
        for part in parts
        if abs((part.high if face.sign > 0 else part.low)[face.axis] - plane) < _FLUSH
    ]
    places = face.middle[along] + offset + np.linspace(-half_width, half_width, 7)
    tops = [
        max((p.high[2] for p in flush if p.low[along] <= y <= p.high[along]), default=0.0)
        for y in places
    ]
    if min(tops) <= 0.0:
        raise ConfigurationError(
            f"the {face.name} face has a gap {1e3 * offset:.0f} mm from its middle; "
            "nothing can be touched there"
        )
    return float(min(tops))
