"""`skewmi calibrate report`: a calibration as one page to look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from skewmi.calibration.calibration_file import Calibration, read_calibration
from skewmi.calibration.report import report_html
from skewmi.calibration.report_parts import NamedRecording
from skewmi.calibration.servo_model import ServoModel
from skewmi.cli import numbers
from skewmi.cli.calibrate_recordings import RecordedExcitation, read_excitation
from skewmi.outputs import check_output, written_aside
from skewmi.robot_models.servo import CONTACT_SERVO


@dataclass(frozen=True)
class Report:
    """Draw a calibration: constants with intervals, residuals, correlations, warnings.

    Recordings that the calibration was not made from are shown as held out. Exit code 0 done, 2 bad
    input.
    """

    calibration: Annotated[Path, tyro.conf.Positional]
    """Calibration file (YAML)."""
    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Recordings of excitations (MCAP)."""
    out: Path = Path("calibration.html")
    """Page to write."""
    threads: int = 2
    """That simulate."""
    overwrite: bool = False
    """Replace an existing file."""


def run_report(options: Report) -> int:
    """Read, draw, write. Returns 0."""
    numbers.require("--threads", options.threads, 1, numbers.MAX_THREADS)
    check_output(
        options.out,
        overwrite=options.overwrite,
        inputs=[options.calibration, *options.recordings],
    )
    calibration = read_calibration(options.calibration)
    recorded = [read_excitation(path) for path in options.recordings]
    write_report(
        calibration, recorded, options.out, overwrite=options.overwrite, threads=options.threads
    )
    print(f"wrote {options.out}")
    return 0


def write_report(
    calibration: Calibration,
    recorded: Sequence[RecordedExcitation],
    out: Path,
    *,
    overwrite: bool,
    threads: int = 2,
) -> None:
    """Write the page; it appears when it is whole.

    Raises:
        OutputError: It cannot be written.
    """
    used = {reference.sha256 for reference in calibration.recordings}
    page = report_html(
        calibration,
        [
            NamedRecording(
                e.reference.file,
                e.recording,
                e.reference.sha256 not in used,
                None if e.egm is None else e.egm.recording,
            )
            for e in recorded
        ],
        ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp, threads=threads),
        CONTACT_SERVO,
    )
    target = check_output(out, overwrite=overwrite)
    with written_aside(target) as draft:
        draft.write_text(page, encoding="utf-8")
