"""Lead the right arm to where its task starts, or to ABB's home pose, from wherever it rests.

The direct way is taken where it is clear of the scene's boxes; else the hand goes straight up
first (at 10 mm/s where it stands too near something, as after a touch that was cut off), then
across, then down. Every motion is within the limits of joint speed, acceleration and jerk and at
most 250 mm/s; whatever ends the command, kill -9 included, the arm comes to rest. The scene must
be shut. Exit code 0 there, 1 stopped, 2 refused before anything moved, 130 after Ctrl-C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skewmi.box_frame import placed
from skewmi.cli.way_flags import RobotServerFlags, lead
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.safety.flange_space import CALIBRATION, TASK
from skewmi.deploy.session.deployable import require_workspace
from skewmi.deploy.session.preflight import draw_start
from skewmi.deploy.session.way_plan import Leg, WayPlanner
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.sim import tasks


@dataclass(frozen=True)
class HomeCommand(RobotServerFlags):
    """Options of `skewmi home`."""

    to: Literal["start", "home"] = "start"
    """Where to: the start of the robot server's task, or ABB's home pose (0, -130, 30, 0, 40, 0
    degrees, axis 7 at -135)."""


def run_home(options: HomeCommand) -> int:
    """Lead the arm there. Returns the exit code."""

    def plan(described: RobotDescription, planner: WayPlanner) -> Sequence[Leg]:
        start = start_of(described)
        if options.to == "home":
            # That pose is outside of the calibration workspace, which nobody may leave.
            return planner.way_by(start, np.array(yumi.HOME["right"]), TASK)
        return planner.way_to(start, CALIBRATION)

    return lead(plan, options, "skewmi_home", slow=False)


def start_of(described: RobotDescription) -> Array:
    """Where episodes of a robot server's task start, rad. Shape (7,)."""
    workspace = placed(require_workspace(tasks.find(described.task).layout()), described.box)
    return draw_start(workspace, 0, 0.0, np.array(workspace.start_configuration))
