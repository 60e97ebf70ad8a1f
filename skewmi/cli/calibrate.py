"""Identify one robot and its scene, and say how well they are known.

`excite` moves the joints and records them, `servo` identifies the servos from that, `scene`
finds where the box stands, `report` draws
what a calibration rests on, `ranges` turns its intervals into a variation to train with. A
calibration is what is known of a robot (--calibration of evaluate, train, robot, deploy); what a
simulated robot is says --variation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from skewmi.cli.calibrate_excite import Excite, run_excite
from skewmi.cli.calibrate_ranges import Ranges, run_ranges
from skewmi.cli.calibrate_report import Report, run_report
from skewmi.cli.calibrate_scene import Scene, run_scene
from skewmi.cli.calibrate_servo import Servo, run_servo

Step = (
    Annotated[Excite, tyro.conf.subcommand(name="excite", prefix_name=False)]
    | Annotated[Servo, tyro.conf.subcommand(name="servo", prefix_name=False)]
    | Annotated[Scene, tyro.conf.subcommand(name="scene", prefix_name=False)]
    | Annotated[Report, tyro.conf.subcommand(name="report", prefix_name=False)]
    | Annotated[Ranges, tyro.conf.subcommand(name="ranges", prefix_name=False)]
)


@dataclass(frozen=True)
class CalibrateCommand:
    """Options of `skewmi calibrate`."""

    step: tyro.conf.OmitArgPrefixes[Step]
    """What to do."""


def run_calibrate(options: CalibrateCommand) -> int:
    """Do one step of a calibration. Returns the exit code."""
    step = options.step
    if isinstance(step, Excite):
        return run_excite(step)
    if isinstance(step, Servo):
        return run_servo(step)
    if isinstance(step, Scene):
        return run_scene(step)
    if isinstance(step, Report):
        return run_report(step)
    return run_ranges(step)
