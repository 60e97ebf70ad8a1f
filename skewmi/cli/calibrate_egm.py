"""`skewmi calibrate servo` for recordings made through EGM: the controller's law, and servos.

Which recordings those are is told by the robot server that made them.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from skewmi import __version__
from skewmi.calibration.calibration_file import (
    Calibration,
    Constant,
    EgmCalibration,
    SceneCalibration,
    write_calibration,
)
from skewmi.calibration.egm_identification import (
    EgmIdentification,
    EgmIdentifier,
    egm_position_rms,
)
from skewmi.calibration.egm_law import EgmLaw
from skewmi.calibration.egm_model import EgmArm
from skewmi.calibration.egm_section import egm_section, egm_warnings, law_is_known
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.cli.calibrate_figures import figures, print_checks
from skewmi.cli.calibrate_recordings import RecordedEgm, RecordedExcitation
from skewmi.errors import ConfigurationError
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import CONTACT_SERVO

if TYPE_CHECKING:
    from skewmi.cli.calibrate_servo import Servo

_NAMES = {"delay": "delay_ms", "lag": "lag_ms", "low_pass": "low_pass_hz"}
"""Of estimates, where files and documents have others."""


def egm_recordings(recorded: Sequence[RecordedExcitation]) -> list[RecordedEgm]:
    """Those made through EGM: all, or none.

    Raises:
        ConfigurationError: Some were and some were not, or with different announced laws.
    """
    found = [excitation.egm for excitation in recorded if excitation.egm is not None]
    if not found:
        return []
    if len(found) < len(recorded):
        others = [e.reference.file for e in recorded if e.egm is None]
        raise ConfigurationError(
            f"{', '.join(others)} was not made through EGM, the others were: they are not of one "
            "robot"
        )
    if any(one.announced != found[0].announced for one in found):
        laws = sorted({f"{o.announced.gain:g} /s, {o.announced.low_pass_hz:g} Hz" for o in found})
        raise ConfigurationError(
            f"the recordings are of controllers with different laws ({'; '.join(laws)}); give "
            "those of one"
        )
    return found


def run_egm(
    options: Servo,
    every: Sequence[RecordedExcitation],
    egm: Sequence[RecordedEgm],
    scene: SceneCalibration | None,
) -> int:
    """The same of a controller that is guided by EGM. Returns the exit code.

    Args:
        options: As given.
        every: Recordings that were read, the one that is held out last.
        egm: Their parts of EGM.
        scene: Of an earlier calibration, to keep.
    """
    if options.effort or options.free_armature:
        raise ConfigurationError(
            "the recordings were made through EGM, whose controllers tell no efforts and whose "
            "arms' inertia is taken as known: leave out --effort and --free-armature"
        )
    count = len(options.recordings)
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp, threads=options.threads)
    begun = time.perf_counter()
    with Console(stderr=True).status("identifying controller and servos (minutes)"):
        found = identified(model, egm[:count], options.inertia_uncertainty)
    seconds = time.perf_counter() - begun
    section = egm_section(found)
    calibration = Calibration(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        egm=section,
        scene=scene,
        recordings=tuple(excitation.reference for excitation in every[:count]),
        checks=checks_of(model, found, egm[:count], egm[count:]),
        warnings=egm_warnings(found),
    )
    write_calibration(options.out, calibration, overwrite=options.overwrite)
    if options.report is not None:
        from skewmi.cli.calibrate_report import write_report

        write_report(calibration, every, options.report, overwrite=options.overwrite)
    if options.json:
        shown = section_document(section, found)
        print(json.dumps(shown | figures(options.out, found, calibration, seconds)))
    else:
        console = Console()
        print_egm(section, console)
        print_checks(calibration, console)
    return 0 if law_is_known(found) else 1


def identified(
    servos: ServoModel, recorded: Sequence[RecordedEgm], inertia_uncertainty: float
) -> EgmIdentification:
    """Law, lag and servos of the arm."""
    recordings = [one.recording for one in recorded]
    announced = recorded[0].announced
    return EgmIdentifier(servos, recordings, CONTACT_SERVO, announced, inertia_uncertainty).run()


def nominal_arm(announced: EgmLaw) -> EgmArm:
    """What an arm is taken for that was not calibrated: the announced law, no lag."""
    return EgmArm(announced, DelayedServo(CONTACT_SERVO, 0.0))


def checks_of(
    servos: ServoModel,
    found: EgmIdentification,
    recorded: Sequence[RecordedEgm],
    held_out: Sequence[RecordedEgm],
) -> dict[str, float]:
    """Figures by which a calibration can be judged."""
    noise = [one.recording.motion.rest_noise for one in recorded]
    checks = {
        "joint_noise_rad": float(np.median(noise)),
        "residual_rms_rad": float(np.sqrt((found.residual_rms**2).mean())),
        "residual_autocorrelation": float(found.autocorrelation_time.max()),
        "nominal_rms_rad": found.nominal_rms,
        "seconds_of_motion": found.seconds_of_motion,
    }
    for one in held_out:
        for name, arm in (("nominal", nominal_arm(one.announced)), ("calibrated", found.arm)):
            rms = egm_position_rms(servos, arm, one.recording)
            checks[f"held_out_rms_{name}_rad"] = float(np.sqrt((rms**2).mean()))
    return checks


def section_document(section: EgmCalibration, found: EgmIdentification) -> dict[str, Any]:
    """The part of the JSON document that is EGM's own."""
    known = {
        _NAMES.get(name, name): list(map(bool, estimate.identified))
        for name, estimate in found.estimates.items()
    }
    return {"egm": {**section.as_mapping(), "identified": known}}


def print_egm(section: EgmCalibration, console: Console) -> None:
    """Law and lags as a table for people."""
    console.print("a controller guided by EGM, with 95 % intervals")
    for words, constant, unit in (
        ("gain of the law", section.gain, "1/s"),
        ("corner of its low-pass", section.low_pass_hz, "Hz"),
        ("lag of all joints", section.servo.delay_ms, "ms"),
    ):
        console.print(f"  {words:24s}{_cell(constant, 0)} {unit}")
    table = Table(title="joints of the right arm", title_justify="left")
    columns = {
        "lag at steady speed, ms": section.lag_ms,
        "stiffness N m/rad": section.servo.kp,
        "damping N m s/rad": section.servo.kd,
        "friction N m": section.servo.frictionloss,
    }
    for heading in ("joint", *columns):
        table.add_column(heading, justify="right")
    for index, joint in enumerate(yumi.joint_names("right")):
        table.add_row(joint, *(_cell(constant, index) for constant in columns.values()))
    console.print(table)


def _cell(constant: Constant, index: int) -> str:
    low, value, high = (part[index] for part in (constant.low, constant.value, constant.high))
    return f"{value:.4g} ({low:.4g} to {high:.4g})"
