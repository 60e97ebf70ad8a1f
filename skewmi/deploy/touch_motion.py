"""Touch a scene's faces with a guarded hand, and say where the joints were.

`run_touches` is to `skewmi calibrate scene` what `joint_motion.run_joint_motion` is to `excite`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from skewmi.deploy.motion_link import JointMotionOptions, MetRobot, robot_link
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.safety.flange_space import CALIBRATION, FINGER_TIP, TOUCH
from skewmi.deploy.safety.limits import LimitUsage
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.guarded_motion import Watch
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.open_space import open_space
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.session.touch_plan import (
    PlannedTouch,
    SwitchedChecks,
    TouchReading,
    TouchSettings,
    require_touches,
)
from skewmi.deploy.session.touch_run import TouchRun
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.deploy.wire.transport import LatestReader, Link
from skewmi.robot_models import yumi

CREEP_SPEED = 0.005
"""Towards a face, m/s: while a touch is noticed and the arm stops, the command goes on by 1 mm."""
CLOSED = yumi.GRIPPER.hook_length / 2.0
"""Travel of each finger at which the hook meets the other finger, m."""

Plan = Callable[[RobotDescription], Sequence[PlannedTouch]]
"""What the robot server says of itself and its scene -> the touches."""


@dataclass
class TouchReport:
    """What happened.

    Attributes:
        readings: Of the touches that were made.
        stops: Why it was stopped; empty if it was not.
        largest_force: Estimated anywhere, N.
        scene: Mean of what the scene's joints read, by the joint's name; rad or m.
        scene_scatter: Standard deviations of these means.
        contact: What a simulated robot knows of forces (`skewmi.contact`); else empty.
        usage: Largest use of each limit over everything that was sent.
        missed_cycles: In which no chunk could be sent in time.
        seconds: Of the robot's time.
        interrupted: Whether somebody asked to stop.
    """

    readings: list[TouchReading] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)
    largest_force: float = 0.0
    scene: dict[str, float] = field(default_factory=dict)
    scene_scatter: dict[str, float] = field(default_factory=dict)
    contact: dict[str, float] = field(default_factory=dict)
    usage: LimitUsage = field(default_factory=LimitUsage)
    missed_cycles: int = 0
    seconds: float = 0.0
    interrupted: bool = False


def run_touches(
    plan: Plan,
    watch: Watch,
    options: JointMotionOptions,
    force_limit: float,
    *,
    stop: threading.Event | None = None,
    on_event: Callable[[str], None] | None = None,
) -> TouchReport:
    """Make some touches.

    Args:
        plan: Makes their paths.
        watch: Says when something is met.
        options: Of which robot, how fast.
        force_limit: More than that ends the run, N.
        stop: Set it from anywhere to bring the arm smoothly to rest.
        on_event: Told in words what happens, for progress.

    Returns:
        What happened. Trouble during the motion is in the report, not raised.

    Raises:
        TransportError: No robot server answers, or the simulated one does not start.
        ConfigurationError: Limits or pace of the robot server differ, or it gives no workspace.
        SkewmiError: What `plan` raises.
    """
    stop = threading.Event() if stop is None else stop
    tell = (lambda text: None) if on_event is None else on_event
    with robot_link(options, tell) as (link, _):
        report = _on_link(plan, watch, options, force_limit, link, stop, tell)
    report.interrupted = stop.is_set()
    return report


def _on_link(
    plan: Plan,
    watch: Watch,
    options: JointMotionOptions,
    force_limit: float,
    link: Link,
    stop: threading.Event,
    tell: Callable[[str], None],
) -> TouchReport:
    met = MetRobot.on(link, options)
    limits = met.admitted(options.limits)
    robot, status, trust, described = met.robot, met.status, met.trust, met.described
    spaces = {name: open_space(described, name, limits) for name in (CALIBRATION, TOUCH)}
    checks = SwitchedChecks(spaces, met.flange_speed)
    touches = plan(described)
    require_touches(touches)
    observer = Observer.open(link, None, described, trust.senders, options.lead_ms / 1e3)
    senders = trust.apart(topics.YUMI_SCENE_STATES)
    scene = link.subscribe(topics.YUMI_SCENE_STATES, depth=None, senders=senders)
    times = CycleTimes()
    stream = met.stream(options, checks.stages, times)
    loop = ControlLoop(robot, observer, stream, times, status, stop, lock_step=options.lock_step)
    settings = TouchSettings(
        limits,
        CALIBRATION,
        TOUCH,
        checks.speeds,
        CREEP_SPEED,
        force_limit,
        CLOSED,
        FINGER_TIP,
    )
    run = TouchRun(
        robot,
        observer,
        stream,
        loop,
        checks,
        settings,
        watch,
        status,
        stop,
        lock_step=options.lock_step,
        tell=tell,
    )
    stream.warm_up()
    status.fire(SessionEvent.CONNECTED, f"{described.backend} robot")
    stops = run.run(touches)
    after = robot.describe()
    report = TouchReport(run.readings, stops, run.largest_force)
    report.scene, report.scene_scatter = _scene_means(scene)
    report.contact = dict(after.contact)
    report.usage, report.missed_cycles = stream.usage, stream.missed_cycles
    report.seconds = (after.clock_ns - described.clock_ns) / 1e9
    return report


def _scene_means(reader: LatestReader) -> tuple[dict[str, float], dict[str, float]]:
    """Mean and its standard deviation of what each joint of the scene read."""
    values: dict[str, list[float]] = {}
    for sample in reader.drain():
        message = decode_joint_states(sample.payload)
        for name, value in zip(message.names, message.position, strict=True):
            if isfinite(value):
                values.setdefault(name, []).append(float(value))
    means = {name: float(np.mean(every)) for name, every in values.items()}
    scatter = {
        name: float(np.std(every)) / max(len(every), 1) ** 0.5 for name, every in values.items()
    }
    return means, scatter
