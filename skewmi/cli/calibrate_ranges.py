"""`skewmi calibrate ranges`: the intervals of a calibration as a variation to train with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from ruamel.yaml import YAML

from skewmi.calibration.calibration_file import read_calibration
from skewmi.calibration.ranges import range_warnings, variation_ranges
from skewmi.cli import numbers
from skewmi.outputs import check_output, written_aside
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.sim import tasks


@dataclass(frozen=True)
class Ranges:
    """Turn a calibration's intervals into a variation file: robots that it may be of.

    Each interval is widened about its value, and to a floor at least: what no calibration tells
    (temperature, wear) is not less than that. What a variation cannot have is told in a warning.
    Exit code 0 done, 2 bad input.
    """

    calibration: Annotated[Path, tyro.conf.Positional]
    """Calibration file (YAML)."""
    out: Path
    """Variation file to write (YAML)."""
    widen: float = 2.0
    """Factor on the half-widths, 1..10."""
    overwrite: bool = False
    """Replace an existing file."""


def run_ranges(options: Ranges) -> int:
    """Read, widen, write. Returns 0."""
    numbers.require("--widen", options.widen, 1.0, 10.0)
    target = check_output(options.out, overwrite=options.overwrite, inputs=[options.calibration])
    calibration = read_calibration(options.calibration)
    variations = tasks.find(tasks.default()).variations
    keys = {key.name: (key.low, key.high) for key in variations.keys}
    content = variation_ranges(calibration, CONTACT_SERVO, options.widen, keys)
    yaml = YAML(typ="safe", pure=True)
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 100
    with written_aside(target) as draft, draft.open("w", encoding="utf-8") as file:
        yaml.dump(content, file)
    for warning in range_warnings(calibration, CONTACT_SERVO, keys):
        print(f"warning: {warning}")
    print(f"wrote {options.out}")
    return 0
