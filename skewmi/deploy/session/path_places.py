"""Places of a path that are looked at before the arm is led along it."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.joint_path import JointPath
from skewmi.trajectory import Array

JOINT_STEP = 0.01
"""Between two configurations that are looked at, in the joint that turns most, rad."""
_PARTS = 32
"""Of a path, whose turns are added up: a joint may turn there and back."""


def places_along(path: JointPath) -> Array:
    """Configurations from a path's start to its end, at even distances on it.

    Args:
        path: Of the joints.

    Returns:
        rad. Shape (n, 7), n at least 2.
    """
    parts = path.at(np.linspace(0.0, path.length, _PARTS + 1))
    turned = float(np.abs(np.diff(parts, axis=0)).sum(axis=0).max())
    return path.at(np.linspace(0.0, path.length, 2 + int(np.ceil(turned / JOINT_STEP))))
