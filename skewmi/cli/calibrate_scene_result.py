"""What `skewmi calibrate scene` makes of where the box was found: a calibration, and words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from skewmi import __version__
from skewmi.calibration.calibration_file import Calibration, SceneCalibration
from skewmi.calibration.scene_fit import SceneFit
from skewmi.deploy.touch_motion import TouchReport

SCENE_WARNINGS = ("the touches do not fit", "the servos were not calibrated")
"""How the warnings begin that `scene_warnings` makes: files have but one list of them."""


@dataclass(frozen=True)
class FoundScene:
    """Where the box stands, and from what.

    Attributes:
        fit: Of the box.
        faces: Name of each touch's face.
        report: Of the motion; None if nothing moved.
        lid: What the shut lid reads, with the standard deviation of that, rad; None if nothing
            tells.
    """

    fit: SceneFit
    faces: Sequence[str]
    report: TouchReport | None
    lid: tuple[float, float] | None


def merged(
    before: Calibration | None,
    section: SceneCalibration,
    found: FoundScene,
    warnings: tuple[str, ...],
    now: datetime,
) -> Calibration:
    """A calibration with this scene, and all else that was known.

    Args:
        before: That was known; what it says of an earlier scene is left out.
        section: Of this scene.
        found: That it is made of.
        warnings: Of it.
        now: Time of day that the file will tell.
    """
    checks = {"scene_chi_squared": found.fit.chi_squared}
    if len(found.fit.residuals):
        checks["scene_residual_rms_m"] = float(np.sqrt((found.fit.residuals**2).mean()))
    if found.report is not None:
        checks["scene_largest_force_n"] = found.report.largest_force
    created = now.isoformat(timespec="seconds")
    if before is None:
        return Calibration(created, __version__, scene=section, checks=checks, warnings=warnings)
    kept = {name: value for name, value in before.checks.items() if not name.startswith("scene_")}
    others = [text for text in before.warnings if not text.startswith(SCENE_WARNINGS)]
    return replace(
        before,
        created=created,
        version=__version__,
        scene=section,
        checks=kept | checks,
        warnings=(*others, *warnings),
    )


def scene_document(
    out: Path, section: SceneCalibration, found: FoundScene, seconds: float
) -> dict[str, Any]:
    """The JSON document.

    Args:
        out: File that was written.
        section: In it.
        found: That the section is made of.
        seconds: That all took.
    """
    numbers_of = section.as_mapping()
    pose: dict[str, Any] = {
        name: {key: numbers_of[name][key] for key in ("value", "low", "high")}  # type: ignore[index]
        for name in ("x", "y", "yaw_deg")
    }
    report = found.report
    forces = (
        [None] * len(found.faces) if report is None else [r.peak_force for r in report.readings]
    )
    return {
        "box_pose": {**pose, "covariance": numbers_of["covariance"]},
        "touches": [
            {
                "face": face,
                "point_m": point.tolist(),
                "residual_mm": 1e3 * float(residual),
                "peak_force_n": force,
            }
            for face, point, residual, force in zip(
                found.faces, found.fit.points, found.fit.residuals, forces, strict=True
            )
        ],
        "largest_force_n": None if report is None else report.largest_force,
        "lid_bias_deg": numbers_of["lid_bias_deg"],
        "seconds": seconds,
        "robot_seconds": None if report is None else report.seconds,
        "contact": {} if report is None else report.contact,
        "missed_cycles": None if report is None else report.missed_cycles,
        "usage": None if report is None else report.usage.as_dict(),
        "out": str(out),
    }


def print_scene(document: dict[str, Any], warnings: Sequence[str], console: Console) -> None:
    """The same document for people."""
    pose = document["box_pose"]
    console.print("the box stands off its nominal place by (95 % intervals)")
    for name, scale, unit in (("x", 1e3, "mm"), ("y", 1e3, "mm"), ("yaw_deg", 1.0, "degrees")):
        value, low, high = (scale * pose[name][key] for key in ("value", "low", "high"))
        console.print(f"  {name:8s}{value:+8.3f} ({low:+.3f} to {high:+.3f}) {unit}")
    lid = document["lid_bias_deg"]
    if lid["assumed"]:
        console.print(f"what the shut lid reads was not measured; {lid['value']:g} deg is assumed")
    else:
        console.print(
            f"the shut lid reads {lid['value']:.2f} ({lid['low']:.2f} to {lid['high']:.2f}) deg"
        )
    for touch in document["touches"]:
        force = touch["peak_force_n"]
        pressed = "" if force is None else f", pressed with {force:.1f} N"
        console.print(f"  {touch['face']:6s} {touch['residual_mm']:+.3f} mm off{pressed}")
    for warning in warnings:
        console.print(f"warning: {warning}", markup=False)
    console.print(f"wrote {document['out']}", markup=False)
