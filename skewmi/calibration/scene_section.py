"""From touches and the fit to them to what a calibration file says of the scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skewmi.calibration.calibration_file import Constant, SceneCalibration
from skewmi.calibration.contact_watch import tip_jacobian
from skewmi.calibration.finger_contact import touching_points
from skewmi.calibration.scene_faces import Face
from skewmi.calibration.scene_fit import ZERO_SIGMA, SceneFit, Touch
from skewmi.calibration.uncertainty import TWO_SIDED_95
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.yumi import Array

LID_SIGMA_DEG = 0.05
"""What a lid's rest may be off its stop, degrees: it stands on the box's rim, not on a number."""


def touch_of(face: Face, top: float, q: Array, opening: float) -> Touch:
    """A touch from the joints as they were measured in contact.

    Args:
        face: That was touched, where it is believed to be.
        top: Height up to which it is there, base frame, m.
        q: Measured, rad. Shape (7,).
        opening: Measured travel of each finger, m.
    """
    arm = ArmKinematics("right")
    position, rotation = arm.forward(q)
    common = ZERO_SIGMA * (face.normal @ tip_jacobian(arm, q))
    return Touch(face, touching_points(position, rotation, opening, top), common)


def scene_section(fit: SceneFit, lid_bias: float | None, lid_sigma: float) -> SceneCalibration:
    """Every constant with its interval.

    Args:
        fit: Of the box.
        lid_bias: Mean reading of the shut lid, rad; None if there is none: then it is assumed to
            be 0.
        lid_sigma: Standard deviation of that mean, rad.
    """
    scale = np.array([1.0, 1.0, 180.0 / np.pi])
    covariance = fit.covariance * np.outer(scale, scale)
    covariance = (covariance + covariance.T) / 2.0
    values = fit.pose * scale
    x, y, yaw = (
        _constant(value, sigma)
        for value, sigma in zip(values, np.sqrt(np.diag(covariance)), strict=True)
    )
    lid = Constant.known(0.0)
    if lid_bias is not None:
        lid = _constant(np.degrees(lid_bias), float(np.hypot(np.degrees(lid_sigma), LID_SIGMA_DEG)))
    rows = tuple(tuple(row) for row in covariance.tolist())
    return SceneCalibration(x, y, yaw, lid, rows)


def scene_warnings(fit: SceneFit, faces: Sequence[str], known_servo: bool) -> tuple[str, ...]:
    """What whoever uses the section should know, a sentence each.

    Args:
        fit: Of the box.
        faces: Name of each touch's face.
        known_servo: Whether the servos were calibrated.
    """
    warnings = []
    if fit.chi_squared > 3.0:
        worst = int(np.argmax(np.abs(fit.residuals)))
        warnings.append(
            f"the touches do not fit one box as well as they should: the worst is "
            f"{1e3 * abs(fit.residuals[worst]):.2f} mm off ({faces[worst]}); "
            "intervals are widened for it"
        )
    if not known_servo:
        warnings.append(
            "the servos were not calibrated: touches were found, and their forces estimated, with "
            "the nominal ones"
        )
    return tuple(warnings)


def _constant(value: float, sigma: float) -> Constant:
    half = TWO_SIDED_95 * float(sigma)
    return Constant((float(value),), (float(value) - half,), (float(value) + half,), (False,))
