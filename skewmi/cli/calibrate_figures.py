"""What `skewmi calibrate servo` tells of any identification: figures, checks, warnings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console

from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.egm_identification import EgmIdentification
from skewmi.calibration.servo_identification import ServoIdentification


def figures(
    out: Path,
    found: ServoIdentification | EgmIdentification,
    calibration: Calibration,
    seconds: float,
) -> dict[str, Any]:
    """What the JSON document of an identification says besides the constants.

    Args:
        out: File that was written.
        found: By positions.
        calibration: That was written.
        seconds: Of computing.
    """
    checks = calibration.checks
    held_out = {
        f"rms_{name}_rad": checks[f"held_out_rms_{name}_rad"]
        for name in ("nominal", "calibrated")
        if f"held_out_rms_{name}_rad" in checks
    }
    return {
        "joint_noise_rad": checks["joint_noise_rad"],
        "residual_rms_rad": found.residual_rms.tolist(),
        "residual_autocorrelation": found.autocorrelation_time.tolist(),
        "held_out": held_out or None,
        "seconds_of_motion": found.seconds_of_motion,
        "seconds_of_computing": seconds,
        "warnings": list(calibration.warnings),
        "out": str(out),
    }


def print_checks(calibration: Calibration, console: Console) -> None:
    """Figures and warnings of a calibration for people."""
    for name, value in calibration.checks.items():
        console.print(f"{name}: {value:.4g}")
    for warning in calibration.warnings:
        console.print(f"warning: {warning}", markup=False)
