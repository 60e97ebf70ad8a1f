"""Move the joints as a motion says that is known beforehand, and record what they do.

`run_joint_motion` is to `skewmi calibrate excite` what `run.run_deploy` is to `skewmi deploy`: it
starts the simulated robot if none is named, records beside the hot loop, and ends at rest.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace

from skewmi.deploy.motion_link import JointMotionOptions, MetRobot, robot_link
from skewmi.deploy.recording.reader import run_metadata
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.robot.description import (
    RobotDescription,
    admitted,
    limit_values,
    recorded_facts,
)
from skewmi.deploy.safety.flange_space import CALIBRATION
from skewmi.deploy.safety.limits import LimitUsage
from skewmi.deploy.session.approach import Approach
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.joint_run import JointRun
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.open_space import open_space
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.session.trust import Trust
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.trajectory import JointTrajectory

ARRIVED = 0.1
"""Largest joint error at the end of a way, rad: an arm that is yet to be calibrated may be held off
by friction, and nothing is touched here. The robot server faults at 0.35 rad."""

Plan = Callable[[RobotDescription], JointTrajectory]
"""What the robot server says of itself and its scene -> the motion."""


@dataclass
class JointMotionReport:
    """What happened."""

    usage: LimitUsage = field(default_factory=LimitUsage)
    """Largest use of each limit over everything that was sent, stops included."""
    missed_cycles: int = 0
    cycles: int = 0
    stops: list[str] = field(default_factory=list)
    """Why it was stopped; empty if it was not."""
    notes: list[str] = field(default_factory=list)
    file: str | None = None
    """The recording, if it is whole."""
    interrupted: bool = False


def run_joint_motion(
    plan: Plan,
    options: JointMotionOptions,
    *,
    stop: threading.Event | None = None,
    on_event: Callable[[str], None] | None = None,
) -> JointMotionReport:
    """Carry out a motion in the calibration workspace.

    Args:
        plan: Makes the motion.
        options: Of which robot, how fast.
        stop: Set it from anywhere to bring the arm smoothly to rest.
        on_event: Told in words what happens, for progress.

    Returns:
        What happened. Trouble during the motion is in the report, not raised.

    Raises:
        TransportError: No robot server answers, or the simulated one does not start.
        ConfigurationError: Limits or pace of the robot server differ.
        SkewmiError: What `plan` raises.
    """
    stop = threading.Event() if stop is None else stop
    tell = (lambda text: None) if on_event is None else on_event
    report = JointMotionReport()
    with robot_link(options, tell) as (link, config):
        _on_link(plan, options, link, config, report, stop, tell)
    report.interrupted = stop.is_set()
    return report


def _on_link(
    plan: Plan,
    options: JointMotionOptions,
    link: Link,
    config: TransportConfig,
    report: JointMotionReport,
    stop: threading.Event,
    tell: Callable[[str], None],
) -> None:
    met = MetRobot.on(link, options)
    limits = met.admitted(options.limits)
    robot, status, trust, described = met.robot, met.status, met.trust, met.described
    trajectory = plan(described)
    if options.dry_run:
        return
    observer = Observer.open(link, None, described, trust.senders, options.lead_ms / 1e3)
    times, checks = CycleTimes(), open_space(described, CALIBRATION, limits)
    stream = met.stream(options, checks.stages, times)
    loop = ControlLoop(robot, observer, stream, times, status, stop, lock_step=options.lock_step)
    run = JointRun(
        robot,
        CALIBRATION,
        observer,
        stream,
        loop,
        Approach(loop, stream, limits, met.flange_speed, ARRIVED),
        checks.stages,
        limits,
        status,
        stop,
        lock_step=options.lock_step,
        tell=tell,
    )
    stream.warm_up()
    status.fire(SessionEvent.CONNECTED, f"{described.backend} robot")
    with _recording(options, described, link, trust, config, report):
        report.stops = run.run(trajectory)
    report.usage = stream.usage
    report.missed_cycles, report.cycles = stream.missed_cycles, times.cycles


@contextmanager
def _recording(
    options: JointMotionOptions,
    described: RobotDescription,
    link: Link,
    trust: Trust,
    config: TransportConfig,
    report: JointMotionReport,
) -> Iterator[None]:
    if options.record is None:
        yield
        return
    limits = admitted(joint_limits.profile(options.limits), described)
    metadata = run_metadata(
        limits=limit_values(limits),
        scene=described.scene or None,
        task=described.task,
        limit_profile=limits.name,
        robot_model_hash=yumi.MODEL_HASH,
        **recorded_facts(described),
        **options.metadata,
    )
    recorder = Recorder.start(
        options.record,
        replace(config, lock_step=False),
        metadata,
        believed=trust.believed,
        overwrite=options.overwrite,
    )
    trust.on_believed.append(recorder.believe)
    link.call(topics.YUMI_DESCRIBE, 5.0, only=trust.server)
    try:
        yield
    except BaseException:
        with suppress(TransportError):
            recorder.close()
        raise
    try:
        summary = recorder.close()
    except TransportError as error:
        report.notes.append(str(error))
        return
    report.file = str(summary.path)
    if summary.missed:
        report.notes.append(f"the recording lacks {summary.missed} messages")
