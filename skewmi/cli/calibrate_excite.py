"""`skewmi calibrate excite`: moves the joints such that their servos show, and records it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import ChosenExcitation, choose_excitation
from skewmi.calibration.servo_model import ServoModel
from skewmi.cli import numbers
from skewmi.cli.calibrate_space import clear_space
from skewmi.cli.interrupt import stop_on_signal
from skewmi.cli.robot_flags import require_motion_options
from skewmi.cli.task_flags import variation_option
from skewmi.deploy.joint_motion import JointMotionReport, run_joint_motion
from skewmi.deploy.motion_link import JointMotionOptions
from skewmi.deploy.robot.description import FLANGE_SPEED, RobotDescription, admitted
from skewmi.deploy.wire.domain import ros_domain
from skewmi.errors import ConfigurationError
from skewmi.outputs import check_output
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.sim import tasks
from skewmi.trajectory import JointTrajectory

CHAIN = (1, 2, 7, 3, 4, 5, 6)
"""ABB's numbers of the joints, in the order of the chain."""
LEAST_SECONDS = {"lab": 10.0, "careful": 20.0}
"""Shortest motions that tell anything in a limit profile, s."""


@dataclass(frozen=True)
class Excite:
    """Move all joints at once, by many sines, and record commands and positions.

    The simulated robot is started if none is named. The arm moves above the scene's box, in the
    robot server's calibration workspace, and returns. Exit code 0 done, 1 stopped, 2 bad input.
    """

    connect: str | None = None
    """Zenoh locator of a running `skewmi robot`, such as tcp/127.0.0.1:7447."""
    zenoh_config: Path | None = None
    """Zenoh configuration file that tells how to reach a running `skewmi robot`."""
    domain: int | None = None
    """ROS 2 domain, 0..232; by default ROS_DOMAIN_ID, else 0."""
    variation: str | None = None
    """What the simulated robot that is started is: a variation file or a bundled name."""
    lock_step: bool = False
    """Robot server and session wait for each other: as fast as possible and repeatable."""
    limits: str = "lab"
    """Joint limit profile: lab (30 s tell enough) or careful (60 s or more)."""
    lead_ms: float = 100.0
    """How long before they are due commands are sent, ms, a multiple of 4 in 8..100: what a busy
    computer may need; here nothing has to be answered fast."""
    seconds: float = 60.0
    """Length of the motion, s, 10..600."""
    seed: int = 0
    """First of the seeds of which the best is taken."""
    joints: str = "1,2,7,3,4,5,6"
    """Which joints move, by ABB's numbers."""
    out: Path = Path("excitation.mcap")
    """Recording to write."""
    overwrite: bool = False
    """Replace an existing recording."""
    dry_run: bool = False
    """Plan and predict; the arm does not move, and nothing is written."""
    json: bool = False
    """Print one JSON document on the last line."""


def run_excite(options: Excite) -> int:
    """Plan, move, record, tell. Returns the exit code."""
    asked = _checked(options)
    console = Console(stderr=True)

    def tell(text: str) -> None:
        console.print(text, highlight=False, markup=False)

    chosen: list[ChosenExcitation] = []

    def plan(described: RobotDescription) -> JointTrajectory:
        chosen.append(planned(options, asked, described, tell))
        return chosen[0].motion

    task = tasks.default()
    motion_options = JointMotionOptions(
        task=task,
        connect=options.connect,
        zenoh_config=options.zenoh_config,
        variation=variation_option(task, options.variation).get("variation"),
        domain=ros_domain(options.domain),
        lock_step=options.lock_step,
        limits=options.limits,
        lead_ms=options.lead_ms,
        record=None if options.dry_run else options.out,
        overwrite=options.overwrite,
        dry_run=options.dry_run,
        metadata={
            "calibration": "excite",
            "excitation": json.dumps(asdict(asked)),
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    )
    with stop_on_signal() as stop:
        report = run_joint_motion(plan, motion_options, stop=stop, on_event=tell)
    document = _document(options, chosen[0], report)
    if options.json:
        print(json.dumps(document))
    else:
        _print(document, report, Console())
    if report.interrupted:
        return 130
    return 1 if report.stops or (report.file is None and not options.dry_run) else 0


def planned(
    options: Excite,
    asked: Excitation,
    described: RobotDescription,
    tell: Callable[[str], None],
) -> ChosenExcitation:
    """The motion, in the space that the robot server describes."""
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp, threads=2)
    limits = admitted(joint_limits.profile(options.limits), described)
    space = clear_space(described, limits)
    # A bridge to a controller admits less than robots do otherwise: what runs on is bounded by it.
    flange_speed = described.limits.get(FLANGE_SPEED, (asked.tcp_speed,))[0]
    asked = replace(asked, tcp_speed=min(asked.tcp_speed, flange_speed))
    tell("choosing a motion")
    return choose_excitation(asked, limits, space, model, CONTACT_SERVO, tell=tell)


def _checked(options: Excite) -> Excitation:
    limits = joint_limits.profile(options.limits)
    numbers.require_seed(options.seed)
    numbers.require("--seconds", options.seconds, LEAST_SECONDS.get(limits.name, 10.0), 600.0)
    require_motion_options(
        options.lead_ms, options.variation, options.connect, options.zenoh_config
    )
    if not options.dry_run:
        check_output(options.out, overwrite=options.overwrite, inputs=[options.zenoh_config])
    return Excitation(options.seconds, options.seed, _joints(options.joints))


def _joints(text: str) -> tuple[bool, ...]:
    try:
        numbers_ = [int(part) for part in text.split(",")]
    except ValueError:
        numbers_ = []
    if not numbers_ or len(set(numbers_)) != len(numbers_) or not set(numbers_) <= set(CHAIN):
        raise ConfigurationError(
            f"--joints is {text!r}; give ABB's numbers of the joints that move, each once, such "
            "as 1,2,7,3,4,5,6"
        )
    return tuple(number in numbers_ for number in CHAIN)


def _document(
    options: Excite, chosen: ChosenExcitation, report: JointMotionReport
) -> dict[str, Any]:
    usage = report.usage.as_dict()
    usage.pop("workspace")
    return {
        "file": report.file,
        "seconds": chosen.motion.duration_s,
        "seed": chosen.seed,
        "limits": options.limits,
        "samples": len(chosen.motion),
        "missed_cycles": report.missed_cycles,
        "stops": report.stops,
        "usage": usage,
        "predicted_half_width": chosen.predicted.as_dict(),
        "notes": report.notes,
    }


def _print(document: dict[str, Any], report: JointMotionReport, console: Console) -> None:
    predicted = document["predicted_half_width"]
    console.print(
        f"excitation of {document['seconds']:.0f} s, seed {document['seed']}, "
        f"limits {document['limits']}"
    )
    shown = ", ".join(f"{name} {value:.1%}" for name, value in document["usage"].items())
    console.print(f"largest use of limits: {shown}")
    console.print(
        "predicted half-widths of the 95 % intervals: "
        f"stiffness {max(predicted['kp']):.1%}, damping {max(predicted['kd']):.1%}, "
        f"friction {1e3 * max(predicted['frictionloss']):.0f} mN m, "
        f"delay {predicted['delay_ms']:.2f} ms"
    )
    for text in (*report.stops, *report.notes):
        console.print(text, markup=False)
    if report.file is not None:
        console.print(f"wrote {report.file}", markup=False)
