"""Where the box stands, from points that touched its faces: weighted least squares with intervals.

A face with outward normal n, d from the middle m of the footprint, is displaced by t = (x, y) and
turned by yaw about m. A finger that touches it has, of all its points p_v, one in the plane:

    g(x, y, yaw) = min_v (R n) . (p_v - m - t) - d = 0

The minimum is over the corners of the finger (`finger_contact`); a probe with a point has one.
What all touches have in common does not average out: wrong zeros of the joints shift every touch
by n . J delta. So the covariance of the gaps is

    C = s^2 I + A diag(sigma) A^T,   A_i = -n_i . J_i

and the fit weighs with its inverse. If the residuals are larger than C says, it is multiplied by
chi^2 / (n - 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, sin

import numpy as np

from skewmi.calibration.scene_faces import SHIFT, TURN, Face
from skewmi.errors import ConfigurationError
from skewmi.robot_models.yumi import Array

TOUCH_SIGMA = 0.05e-3
"""Of one touch by itself: what noise and the softness of the contact come to, m."""
ZERO_SIGMA = 1e-4
"""Of the joints' zeros, rad: 0.1 mm at the finger tips, a well calibrated arm. Assumed."""
ROOM = 3.0
"""How many times farther than the box may be a result may be before it is refused."""
_STEPS = 50


@dataclass(frozen=True, eq=False)
class Touch:
    """One touch of a face.

    Attributes:
        face: That was touched, where it is believed to be.
        points: Of which one touched it, base frame, m. Shape (v, 3).
        common: Derivative of the gap by what all touches have in common, per unit of its standard
            deviation, m. Shape (c,); as many for all touches.
        sigma: Standard deviation of what it has by itself, m.
    """

    face: Face
    points: Array
    common: Array = field(default_factory=lambda: np.zeros(0))
    sigma: float = TOUCH_SIGMA


@dataclass(frozen=True, eq=False)
class SceneFit:
    """Displacement of the box.

    Attributes:
        pose: x (m), y (m), yaw (rad). Shape (3,).
        covariance: Of the pose. Shape (3, 3).
        residuals: Distance of each touch from its face, m, positive outside. Shape (n,).
        points: That touched. Shape (n, 3).
        chi_squared: Per degree of freedom; 0 without one.
    """

    pose: Array
    covariance: Array
    residuals: Array
    points: Array
    chi_squared: float


def fit_scene(touches: Sequence[Touch]) -> SceneFit:
    """The displacement that touches tell.

    Raises:
        ConfigurationError: They do not tell all three numbers, or tell a displacement that is
            beyond belief.
    """
    if len(touches) < 3:
        raise ConfigurationError(
            f"{len(touches)} touches; x, y and yaw need three at least, on two faces that meet"
        )
    covariance = _covariance(touches)
    weight = np.linalg.inv(covariance)
    pose, cost = np.zeros(3), np.inf
    trial = pose.copy()
    for _ in range(_STEPS):
        gaps, slopes, _ = _gaps(touches, trial)
        found = float(gaps @ weight @ gaps)
        if found >= cost * (1.0 - 1e-12):
            # Where two corners touch at once a whole step may lead back and forth.
            trial = (pose + trial) / 2.0
            if np.abs(trial - pose).max() < 1e-9:
                break
            continue
        pose, cost = trial, found
        information = slopes.T @ weight @ slopes
        _require_told(information)
        trial = pose - np.linalg.solve(information, slopes.T @ weight @ gaps)
        if np.abs(trial - pose).max() < 1e-10:
            break
    require_credible(pose)
    gaps, slopes, points = _gaps(touches, pose)
    inverse = np.linalg.inv(slopes.T @ weight @ slopes)
    freedom = len(touches) - 3
    chi_squared = float(gaps @ weight @ gaps) / freedom if freedom else 0.0
    widened: Array = np.asarray(inverse * max(1.0, chi_squared), dtype=np.float64)
    return SceneFit(pose, widened, gaps, points, chi_squared)


def _gaps(touches: Sequence[Touch], pose: Array) -> tuple[Array, Array, Array]:
    """Distances, shape (n,), their derivatives, (n, 3), and the points that are nearest, (n, 3)."""
    x, y, yaw = pose
    turn = np.array([[cos(yaw), -sin(yaw)], [sin(yaw), cos(yaw)]])
    slope = np.array([[-sin(yaw), -cos(yaw)], [cos(yaw), -sin(yaw)]])
    gaps, slopes, points = [], [], []
    for touch in touches:
        normal = touch.face.normal[:2]
        from_middle = touch.points[:, :2] - np.array(touch.face.middle) - (x, y)
        distance = from_middle @ (turn @ normal)
        nearest = int(np.argmin(distance))
        gaps.append(distance[nearest] - touch.face.distance)
        slopes.append([*(-turn @ normal), from_middle[nearest] @ (slope @ normal)])
        points.append(touch.points[nearest])
    return np.array(gaps), np.array(slopes), np.array(points)


def _covariance(touches: Sequence[Touch]) -> Array:
    common = np.array([touch.common for touch in touches])
    covariance: Array = np.diag([touch.sigma**2 for touch in touches]) + common @ common.T
    return covariance


def _require_told(information: Array) -> None:
    # In units of what may be: m along the sides, rad.
    scale = np.array([SHIFT, SHIFT, TURN])
    values = np.linalg.eigvalsh(information * np.outer(scale, scale))
    if values[0] < 1.0:
        raise ConfigurationError(
            "the touches do not tell x, y and yaw: touch two faces that meet at a corner, one of "
            "them at two places far apart"
        )


def require_credible(pose: Array) -> None:
    """Raises ConfigurationError if a box cannot be there: x, y (m), yaw (rad)."""
    x, y, yaw = pose
    if max(abs(x), abs(y)) > ROOM * SHIFT or abs(yaw) > ROOM * TURN:
        raise ConfigurationError(
            f"the touches tell a box {1e3 * x:.1f} and {1e3 * y:.1f} mm and "
            f"{np.degrees(yaw):.1f} degrees from where it is believed to stand; at most "
            f"{1e3 * ROOM * SHIFT:.0f} mm and {np.degrees(ROOM * TURN):.0f} degrees are credible: "
            "is it the right face at each place?"
        )
