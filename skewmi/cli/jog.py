"""Move the right arm by one small step: the hand along x, y, z, or one joint.

At most 50 mm or 10 degrees a step, flange and finger tips at 10 mm/s, and nowhere nearer to the
scene's boxes, the table or the robot itself than 5 mm; where the arm is nearer already, it may
leave but comes no nearer. A step that would is refused before anything moves. Exit code 0 done,
1 stopped, 2 refused, 130 after Ctrl-C, which ends at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from typing import Literal

import numpy as np

from skewmi.cli import numbers
from skewmi.cli.calibrate_excite import CHAIN
from skewmi.cli.way_flags import RobotServerFlags, lead
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.session.way_plan import Leg, WayPlanner
from skewmi.errors import ConfigurationError

LARGEST_MM = 50.0
LEAST_MM = 0.1
LARGEST_DEGREES = 10.0
LEAST_DEGREES = 0.05


@dataclass(frozen=True)
class JogCommand(RobotServerFlags):
    """Options of `skewmi jog`."""

    x: float = 0.0
    """Step of the hand away from the robot (towards it if negative), mm."""
    y: float = 0.0
    """Step of the hand to the robot's left (right if negative), mm."""
    z: float = 0.0
    """Step of the hand up (down if negative), mm."""
    joint: int | None = None
    """Turn this joint instead, by ABB's number: 1, 2, 7, 3, 4, 5, 6 from the body to the hand."""
    degrees: float | None = None
    """By how much, degrees."""
    workspace: Literal["touch", "task"] = "touch"
    """In which workspace of the robot server: touch, around the scene, which must be shut; or the
    task's box, which the hand cannot leave once it is in it."""


def run_jog(options: JogCommand) -> int:
    """Make the step. Returns the exit code."""
    for name, value in (("--x", options.x), ("--y", options.y), ("--z", options.z)):
        numbers.require(name, value, -LARGEST_MM, LARGEST_MM)
    numbers.require("--degrees", options.degrees, -LARGEST_DEGREES, LARGEST_DEGREES)
    step = np.array([options.x, options.y, options.z])
    if options.joint is None:
        _require_step(options, step)
    else:
        _require_turn(options, step)

    def plan(described: RobotDescription, planner: WayPlanner) -> Sequence[Leg]:
        del described
        if options.joint is None:
            return [planner.line(step / 1e3, options.workspace)]
        assert options.degrees is not None
        index = CHAIN.index(options.joint)
        return [planner.turn(index, radians(options.degrees), options.workspace)]

    return lead(plan, options, "skewmi_jog", slow=True)


def _require_step(options: JogCommand, step: np.typing.NDArray[np.float64]) -> None:
    if options.degrees is not None:
        raise ConfigurationError("--degrees is of a joint: give --joint, too")
    length = float(np.linalg.norm(step))
    if not length:
        raise ConfigurationError("nothing to do: give --x, --y or --z in mm, or --joint")
    if not LEAST_MM <= length <= LARGEST_MM:
        raise ConfigurationError(
            f"the step is {length:g} mm long; it must be in {LEAST_MM:g}..{LARGEST_MM:g}: take "
            "several"
        )


def _require_turn(options: JogCommand, step: np.typing.NDArray[np.float64]) -> None:
    if step.any():
        raise ConfigurationError("--joint and --x, --y, --z are two steps: give one of them")
    if options.joint not in CHAIN:
        raise ConfigurationError(f"--joint is {options.joint}; it must be in 1..7, ABB's numbers")
    if options.degrees is None:
        raise ConfigurationError("--joint needs --degrees")
    size = abs(options.degrees)
    numbers.require("--degrees", size, LEAST_DEGREES, LARGEST_DEGREES)
