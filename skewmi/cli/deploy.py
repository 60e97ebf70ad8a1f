"""Run an ONNX policy on a robot server, and tell how it went.

Without `--connect` a simulated robot is started in a process of its own and ended afterwards.
Ctrl-C brakes the arm smoothly; so does killing this process, because whatever the robot server has
accepted ends at rest. Exit code 0 if all episodes ran to their end (however many succeeded), 1 if
one was stopped or faulted or a file is not whole, 2 for bad input, 130 after Ctrl-C, SIGTERM or
SIGHUP.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from skewmi import policies
from skewmi.cli import numbers
from skewmi.cli.interrupt import stop_on_signal
from skewmi.cli.live_flags import live_options
from skewmi.cli.robot_flags import RobotName
from skewmi.cli.task_flags import variation_option
from skewmi.contact import QUANTITIES
from skewmi.deploy import run as deploy_run
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.policy import OnnxPolicy
from skewmi.deploy.report import DeployReport
from skewmi.deploy.run_watch import RunWatch
from skewmi.deploy.wire.domain import ros_domain
from skewmi.outputs import check_output
from skewmi.progress import LiveLine
from skewmi.smoothness import LIMITS

BUNDLED = ", ".join(policies.bundled()) or "there is none"


@dataclass(frozen=True)
class DeployCommand:
    """Options of `skewmi deploy`."""

    policy: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(help=f"Policy file of `skewmi export-onnx`, or a bundled one: {BUNDLED}."),
    ]
    robot: RobotName = "sim"
    """Which robot to start for this run, unless --connect or --zenoh-config names one that runs."""
    connect: str | None = None
    """Zenoh locator of a running `skewmi robot`, such as tcp/127.0.0.1:7447."""
    domain: int | None = None
    """ROS 2 domain, 0..232; by default ROS_DOMAIN_ID, else 0."""
    variation: str | None = None
    """How the simulated robot that is started and its scene differ from the nominal ones: a
    variation file (YAML), or the name of one that comes with the task, as `randomised`. Each
    episode draws by its own seed."""
    calibration: Path | None = None
    """What is known of the robot and its scene, whatever they are: a calibration file (YAML) of
    `skewmi calibrate`. The robot that is started gets it, too; give a running one the same, or it
    is refused if the two have the box at different places."""
    episodes: int = 1
    """How many."""
    seed: int = 0
    """Of the start positions."""
    lock_step: bool = False
    """Robot server and session wait for each other: as fast as possible and repeatable."""
    limits: str = "lab"
    """Joint limit profile (lab, careful); none is verified on hardware."""
    speed: float = 1.0
    """Fraction of the training's speed, 0.1..1."""
    lead_ms: float = 24.0
    """Time from a robot state to the motion that answers it, ms, a multiple of 4 in 8..100: raise
    it if states or commands are late on a busy computer, at the price of slower reactions. States
    may be three times as old, at least 100 ms."""
    record: Path | None = None
    """MCAP file to record everything to."""
    live: bool = False
    """Open a Rerun viewer that shows the run while it happens: what `skewmi replay` shows. Without
    a screen it is served for a browser, and the address told."""
    live_connect: str | None = None
    """The same in a Rerun viewer that runs somewhere, such as rerun+http://10.0.0.5:9876/proxy."""
    live_out: Path | None = None
    """The same into a Rerun file (.rrd), alone or besides; needs no screen."""
    overwrite: bool = False
    """Replace existing files of --record and --live-out."""
    dry_run: bool = False
    """Do everything but send: the arm does not move."""
    scene_from: str | None = None
    """Who publishes the scene's states, if not the robot server or whom it names: the name of a
    ROS 2 node, such as that of a camera, or a publisher's id."""
    zenoh_config: Path | None = None
    """Zenoh configuration file (JSON5 or YAML) that tells how and where to reach a running
    `skewmi robot`, such as `skewmi certificates` makes; --connect overrides where."""
    json: bool = False
    """Print the report as one JSON document."""


def deploy_policy(options: DeployCommand) -> DeployReport:
    """Load the policy and run it; progress on standard error."""
    numbers.require("--episodes", options.episodes, 1, numbers.MAX_EPISODES)
    numbers.require_seed(options.seed)
    policy = OnnxPolicy.load(options.policy)
    variation = variation_option(policy.layout.task, options.variation).get("variation")
    _check_outputs(options)
    watch = RunWatch()
    with stop_on_signal() as stop, LiveLine(watch.words) as line:
        live = live_options(options.live, options.live_connect, options.live_out, line.note)
        return deploy_run.run_deploy(
            policy,
            DeployOptions(
                episodes=options.episodes,
                seed=options.seed,
                robot=options.robot,
                connect=options.connect,
                domain=ros_domain(options.domain),
                variation=variation,
                calibration=options.calibration,
                lock_step=options.lock_step,
                limits=options.limits,
                speed=options.speed,
                lead_ms=options.lead_ms,
                dry_run=options.dry_run,
                record=options.record,
                overwrite=options.overwrite,
                live=live,
                policy_name=str(options.policy),
                robot_model_hash=policy.metadata["robot_model_hash"],
                zenoh_config=options.zenoh_config,
                scene_from=options.scene_from,
            ),
            stop=stop,
            on_event=line.note,
            watch=watch,
        )


def _check_outputs(options: DeployCommand) -> None:
    """See that the run's files can be written, before anything moves."""
    variation = None if options.variation is None else Path(options.variation)
    needed = [policies.locate(options.policy), options.zenoh_config, variation, options.calibration]
    outputs = [options.record, options.live_out]
    for output, other in zip(outputs, reversed(outputs), strict=True):
        if output is not None:
            check_output(output, overwrite=options.overwrite, inputs=[*needed, other])


def run_deploy(options: DeployCommand) -> int:
    """Run and print. Returns the exit code."""
    report = deploy_policy(options)
    if options.json:
        print(json.dumps(report.as_dict()))
    else:
        print_report(report, Console())
    if report.interrupted:
        return 130
    return 1 if report.stops or report.broken_files else 0


def print_report(report: DeployReport, console: Console) -> None:
    """The report as tables for people."""
    table = Table(title=f"{report.task} on {report.robot}", title_justify="left")
    for heading in ("episode", "outcome", "steps", "reason"):
        table.add_column(heading, justify="right" if heading in ("episode", "steps") else "left")
    for episode in report.episodes:
        table.add_row(
            str(episode.index + 1), episode.outcome, str(episode.steps), escape(episode.reason)
        )
    console.print(table)
    if report.dry_run:
        console.print("dry run: nothing was sent, the arm did not move")
    count = len(report.episodes)
    console.print(f"success rate {report.success_rate:.1%} ({report.successes} of {count})")
    usage = report.usage
    fractions = {
        "|q|": usage.position,
        "|v|": usage.velocity,
        "|a|": usage.acceleration,
        "|jerk|": usage.jerk,
        "hand speed": usage.tcp_speed,
    }
    shown = ", ".join(f"{name} {value:.1%}" for name, value in fractions.items())
    profile = report.limit_profile
    if report.velocity_fraction < 1.0:
        profile += f", velocity at most {report.velocity_fraction:.0%} of full"
    console.print(f"largest use of limits ({profile}): {shown}")
    contact = report.contact()
    if contact:
        shown = "; ".join(_contact_words(name, metrics) for name, metrics in contact.items())
        console.print(f"largest contact in the simulation: {shown}", markup=False)
    if report.smoothness():
        shown = "; ".join(
            f"above {frequency:g} Hz {metrics['max']:.1%} of {metrics['limit']:.0%}"
            for frequency, metrics in zip(LIMITS, report.smoothness().values(), strict=True)
        )
        console.print(f"largest power of a joint's commanded acceleration: {shown}")
    cycle = ", ".join(f"{name} {value:.2f}" for name, value in report.cycle_ms.items())
    pace = "lock-step" if report.lock_step else f"real time ({', '.join(report.granted)})"
    console.print(f"cycle, ms: {cycle}; missed {report.missed_cycles} of {report.cycles}; {pace}")
    for stop in report.stops:
        console.print(f"stopped: {stop}", markup=False)
    for stranger in report.strangers:
        console.print(f"not believed: {stranger}, {stranger.messages} messages", markup=False)
    for note in report.notes:
        console.print(note, markup=False)
    for file in report.broken_files:
        console.print(f"not whole: {file}", markup=False)
    for file in report.files:
        console.print(f"wrote {file}", markup=False)


def _contact_words(name: str, metrics: Mapping[str, float]) -> str:
    label, _, unit = QUANTITIES[name].label.removesuffix("]").partition(" [")
    of_limit = f" of {metrics['limit']:.0f}" if "limit" in metrics else ""
    return f"{label} {metrics['max']:.1f}{of_limit} {unit}"
