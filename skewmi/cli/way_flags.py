"""What `skewmi home` and `skewmi jog` have in common: which robot, and what is told at the end."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from skewmi.cli.interrupt import stop_on_signal
from skewmi.cli.robot_flags import require_motion_options
from skewmi.deploy.motion_link import JointMotionOptions
from skewmi.deploy.way_motion import Plan, WayReport, run_way
from skewmi.deploy.wire.domain import ros_domain
from skewmi.deploy.wire.transport_config import DEFAULT_LOCATOR
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.frames import base_to_world
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.sim import tasks


@dataclass(frozen=True)
class RobotServerFlags:
    """Which robot server."""

    connect: str | None = None
    """Zenoh locator of the robot server; by default what --zenoh-config says, else
    tcp/127.0.0.1:7447."""
    zenoh_config: Path | None = None
    """Zenoh configuration file (JSON5 or YAML), such as `skewmi certificates` makes."""
    domain: int | None = None
    """ROS 2 domain, 0..232; by default ROS_DOMAIN_ID, else 0."""
    lock_step: bool = False
    """The robot server runs in lock-step; give it to both or to none."""
    limits: str = "lab"
    """Joint limit profile to plan with: lab or careful, not beyond the robot server's."""
    lead_ms: float = 100.0
    """How long before they are due commands are sent, ms, a multiple of 4 in 8..100."""
    dry_run: bool = False
    """Find the way and tell it; the arm does not move."""
    json: bool = False
    """Print one JSON document on the last line."""


def lead(plan: Plan, flags: RobotServerFlags, node: str, *, slow: bool) -> int:
    """Lead the arm along a way, and tell how that went. Returns the exit code."""
    joint_limits.profile(flags.limits)
    require_motion_options(flags.lead_ms, None, flags.connect, flags.zenoh_config)
    options = JointMotionOptions(
        task=tasks.default(),
        connect=flags.connect or (None if flags.zenoh_config else DEFAULT_LOCATOR),
        zenoh_config=flags.zenoh_config,
        domain=ros_domain(flags.domain),
        lock_step=flags.lock_step,
        limits=flags.limits,
        lead_ms=flags.lead_ms,
        dry_run=flags.dry_run,
        node=node,
    )
    with stop_on_signal() as stop:
        report = run_way(plan, options, slow=slow, stop=stop, on_event=_teller())
    _tell_end(report, flags)
    if report.interrupted:
        return 130
    return 1 if report.stops else 0


def _teller() -> Callable[[str], None]:
    console = Console(stderr=True)

    def tell(text: str) -> None:
        with suppress(OSError):  # The terminal may be gone; the arm comes first.
            console.print(text, highlight=False, markup=False)

    return tell


def _tell_end(report: WayReport, flags: RobotServerFlags) -> None:
    if flags.json:
        print(json.dumps(_document(report, flags)))
        return
    for text in report.stops:
        print(f"stopped: {text}")
    if flags.dry_run:
        for workspace, words in report.legs:
            print(f"{words}, in the {workspace} workspace")
        print("dry run: the arm did not move")
    elif report.measured is not None:
        x, y, z = 1e3 * _hand(report)
        moved = "the arm is there already" if not report.legs else "the arm rests"
        print(f"{moved}; the hand is at {x:.0f}, {y:.0f}, {z:.0f} mm (flange, world)")


def _document(report: WayReport, flags: RobotServerFlags) -> dict[str, Any]:
    usage = report.usage.as_dict()
    usage.pop("workspace")
    there = report.measured is not None
    return {
        "legs": [{"workspace": workspace, "what": words} for workspace, words in report.legs],
        "moved": bool(report.legs) and not flags.dry_run and there,
        "stops": report.stops,
        "joints_rad": None if report.measured is None else report.measured.tolist(),
        "hand_m": _hand(report).tolist() if there else None,
        "usage": usage,
        "missed_cycles": report.missed_cycles,
        "robot_seconds": report.seconds,
        "contact": report.contact,
    }


def _hand(report: WayReport) -> Any:
    assert report.measured is not None
    return base_to_world(ArmKinematics("right").forward(report.measured)[0])
