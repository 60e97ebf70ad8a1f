"""`skewmi calibrate servo`: stiffness, damping, friction and delay from recorded excitations.

Of recordings made through EGM, the controller's law with its lag as well: `calibrate_egm`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from skewmi import __version__
from skewmi.calibration.calibration_file import Calibration, read_calibration, write_calibration
from skewmi.calibration.servo_effort import fit_efforts, with_efforts
from skewmi.calibration.servo_identification import (
    ServoIdentification,
    identify_servos,
    position_rms,
)
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_section import servo_section, servo_start, servo_warnings
from skewmi.cli import numbers
from skewmi.cli.calibrate_egm import egm_recordings, run_egm
from skewmi.cli.calibrate_figures import figures, print_checks
from skewmi.cli.calibrate_recordings import read_excitation
from skewmi.errors import ConfigurationError
from skewmi.outputs import check_output
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.robot_models.yumi import Array

KNOWN_MASSES = (
    "masses and rotor inertias are taken as the model's: where those are wrong by a part, kp, kd "
    "and frictionloss are wrong by the same part, their ratios are not (--inertia-uncertainty)"
)

OTHER_INERTIA = 0.05
"""Difference of a joint's stiffness by efforts and by positions that is told, as a part of it."""


@dataclass(frozen=True)
class Servo:
    """Identify the servos from recordings of `skewmi calibrate excite`.

    Positions at 50 Hz and the executed commands are enough. Of a controller that was guided by EGM,
    which its robot server tells, law and lag are identified, too. Exit code 0 done, 1 something
    was not identified, 2 bad input.
    """

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Recordings of one robot (MCAP)."""
    out: Path
    """Calibration file to write (YAML); what it has of a scene is kept with --start-from."""
    held_out: Path | None = None
    """A recording that is not used, to judge by."""
    effort: bool = False
    """Use the measured efforts, N m: they tell stiffness and damping where the model's masses are
    wrong. For robots that tell the efforts of their servos."""
    free_armature: bool = False
    """Identify the rotor inertia, too: of a wrist then only ratios are known."""
    inertia_uncertainty: float = 0.0
    """Standard deviation of the inertia that a joint moves, as a part of it, 0..1."""
    start_from: Path | None = None
    """Calibration to begin the search from."""
    report: Path | None = None
    """Report to write (HTML)."""
    threads: int = 2
    """That simulate candidates."""
    overwrite: bool = False
    """Replace existing files."""
    json: bool = False
    """Print one JSON document on the last line."""


def run_servo(options: Servo) -> int:
    """Read, identify, write, tell. Returns the exit code."""
    _check_outputs(options)
    start, scene = None, None
    if options.start_from is not None:
        before = read_calibration(options.start_from)
        scene = before.scene
        start = None if before.servo is None else servo_start(before.servo, CONTACT_SERVO)
    recorded = [read_excitation(path) for path in options.recordings]
    held_out = None if options.held_out is None else read_excitation(options.held_out)
    every = [*recorded, *([] if held_out is None else [held_out])]
    egm = egm_recordings(every)
    if egm:
        return run_egm(options, every, egm, scene)
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp, threads=options.threads)
    console = Console(stderr=True)
    begun = time.perf_counter()
    with console.status("identifying the servos (minutes)"):
        found = identify_servos(
            model,
            [excitation.recording for excitation in recorded],
            CONTACT_SERVO,
            free_armature=options.free_armature,
            inertia_uncertainty=options.inertia_uncertainty,
            start=start,
        )
        if options.effort:
            by_positions = found.estimates["kp"].value
            fit = fit_efforts(model, found.servo, [e.recording for e in recorded])
            found = with_efforts(found, fit)
    seconds = time.perf_counter() - begun
    judged = [] if held_out is None else [held_out.recording]
    checks = _checks(model, found, [e.recording for e in recorded], judged)
    warnings = servo_warnings(found)
    if options.effort:
        warnings += _of_inertia(fit.kp / by_positions)
    elif not options.inertia_uncertainty and not options.free_armature:
        warnings += (KNOWN_MASSES,)
    calibration = Calibration(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        servo=servo_section(found),
        scene=scene,
        recordings=tuple(excitation.reference for excitation in recorded),
        checks=checks,
        warnings=warnings,
    )
    write_calibration(options.out, calibration, overwrite=options.overwrite)
    if options.report is not None:
        from skewmi.cli.calibrate_report import write_report

        write_report(calibration, every, options.report, overwrite=options.overwrite)
    document = _document(options, found, calibration, seconds)
    if options.json:
        print(json.dumps(document))
    else:
        print_servo(calibration, Console())
    every_known = all(all(flags) for flags in document["servo"]["identified"].values())
    return 0 if every_known else 1


def _of_inertia(scale: Array) -> tuple[str, ...]:
    """What efforts say of the model's masses, if it is worth a word. Shape (7,)."""
    return tuple(
        f"by its efforts {joint} is {value:.2f} times as stiff as by positions and the model's "
        "masses: a simulation of these constants needs other masses"
        for joint, value in zip(yumi.joint_names("right"), scale, strict=True)
        if abs(value - 1.0) > OTHER_INERTIA
    )


def _check_outputs(options: Servo) -> None:
    if not options.recordings:
        raise ConfigurationError("give one recording at least")
    numbers.require("--threads", options.threads, 1, numbers.MAX_THREADS)
    numbers.require("--inertia-uncertainty", options.inertia_uncertainty, 0.0, 1.0)
    inputs: list[Path | None] = [*options.recordings, options.held_out]
    check_output(options.out, overwrite=options.overwrite, inputs=inputs)
    if options.report is not None:
        needed = [*inputs, options.out, options.start_from]
        check_output(options.report, overwrite=options.overwrite, inputs=needed)


def _checks(
    model: ServoModel,
    found: ServoIdentification,
    recordings: Sequence[ServoRecording],
    held_out: Sequence[ServoRecording],
) -> dict[str, float]:
    """Figures by which a calibration can be judged."""
    checks = {
        "joint_noise_rad": float(np.median([recording.rest_noise for recording in recordings])),
        "residual_rms_rad": float(np.sqrt((found.residual_rms**2).mean())),
        "residual_autocorrelation": float(found.autocorrelation_time.max()),
        "seconds_of_motion": found.seconds_of_motion,
    }
    for recording in held_out:
        for name, servo in (
            ("nominal", DelayedServo(CONTACT_SERVO, 0.0)),
            ("calibrated", found.servo),
        ):
            rms = position_rms(model, servo, recording)
            checks[f"held_out_rms_{name}_rad"] = float(np.sqrt((rms**2).mean()))
    return checks


def _document(
    options: Servo, found: ServoIdentification, calibration: Calibration, seconds: float
) -> dict[str, Any]:
    assert calibration.servo is not None
    section = calibration.servo.as_mapping()
    estimates = {
        "delay_ms" if name == "delay" else name: list(map(bool, estimate.identified))
        for name, estimate in found.estimates.items()
    }
    shown = {"servo": {**section, "identified": estimates}}
    return shown | figures(options.out, found, calibration, seconds)


def print_servo(calibration: Calibration, console: Console) -> None:
    """The servos of a calibration as a table for people."""
    servo = calibration.servo
    if servo is None:
        return
    table = Table(title="servos of the right arm, with 95 % intervals", title_justify="left")
    columns = {
        "kp": "stiffness N m/rad",
        "kd": "damping N m s/rad",
        "frictionloss": "friction N m",
    }
    for heading in ("joint", *columns.values()):
        table.add_column(heading, justify="right")
    for index, joint in enumerate(yumi.joint_names("right")):
        cells = []
        for name in columns:
            constant = getattr(servo, name)
            low, value, high = (
                part[index] for part in (constant.low, constant.value, constant.high)
            )
            cells.append(f"{value:.4g} ({low:.4g} to {high:.4g})")
        table.add_row(joint, *cells)
    console.print(table)
    delay = servo.delay_ms
    console.print(f"delay {delay.value[0]:.2f} ms ({delay.low[0]:.2f} to {delay.high[0]:.2f})")
    print_checks(calibration, console)
