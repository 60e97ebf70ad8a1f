"""Lead the arm from wherever it rests to a pose, or by a small step.

`run_way` is to `skewmi home` and `skewmi jog` what `touch_motion.run_touches` is to `skewmi
calibrate scene`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from skewmi.deploy.motion_link import JointMotionOptions, MetRobot, robot_link
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.safety.flange_space import FINGER_TIP
from skewmi.deploy.safety.limits import LimitUsage
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.path_follower import PathFollower
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.session.touch_plan import SwitchedChecks
from skewmi.deploy.session.way_plan import Leg, WayPlanner
from skewmi.deploy.session.way_run import WayRun
from skewmi.deploy.session.way_spaces import way_spaces
from skewmi.deploy.wire.transport import Link
from skewmi.policy_io import Array

Plan = Callable[[RobotDescription, WayPlanner], Sequence[Leg]]
"""What the robot server says of itself, and who finds ways from where its arm rests -> the way."""


@dataclass
class WayReport:
    """What happened.

    Attributes:
        legs: Workspace and words of each leg that was planned.
        stops: Why it was stopped; empty if it was not.
        measured: Where the arm was at the end, if it got there, rad. Shape (7,).
        contact: What a simulated robot knows of forces (`skewmi.contact`); else empty.
        usage: Largest use of each limit over everything that was sent.
        missed_cycles: In which no chunk could be sent in time.
        seconds: Of the robot's time.
        interrupted: Whether somebody asked to stop.
    """

    legs: list[tuple[str, str]] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)
    measured: Array | None = None
    contact: dict[str, float] = field(default_factory=dict)
    usage: LimitUsage = field(default_factory=LimitUsage)
    missed_cycles: int = 0
    seconds: float = 0.0
    interrupted: bool = False


def run_way(
    plan: Plan,
    options: JointMotionOptions,
    *,
    slow: bool = False,
    stop: threading.Event | None = None,
    on_event: Callable[[str], None] | None = None,
) -> WayReport:
    """Carry out a way.

    Args:
        plan: Chooses it.
        options: Of which robot, how fast.
        slow: See `way_spaces.way_spaces`.
        stop: Set it from anywhere to bring the arm smoothly to rest.
        on_event: Told in words what happens, for progress.

    Returns:
        What happened. Trouble during the motion is in the report, not raised.

    Raises:
        TransportError: No robot server answers.
        ConfigurationError: Limits or pace of the robot server differ, or it gives no workspace.
        SkewmiError: What `plan` raises.
    """
    stop = threading.Event() if stop is None else stop
    tell = (lambda text: None) if on_event is None else on_event
    with robot_link(options, tell) as (link, _):
        report = _on_link(plan, options, slow, link, stop, tell)
    report.interrupted = stop.is_set()
    return report


def _on_link(
    plan: Plan,
    options: JointMotionOptions,
    slow: bool,
    link: Link,
    stop: threading.Event,
    tell: Callable[[str], None],
) -> WayReport:
    met = MetRobot.on(link, options)
    limits = met.admitted(options.limits)
    q = np.array(met.described.commanded_position)
    spaces = way_spaces(met.described, limits, q, slow=slow)
    legs = plan(met.described, WayPlanner(spaces, q))
    report = WayReport([(leg.workspace, leg.words) for leg in legs])
    if not legs:
        report.measured = q
    if not legs or options.dry_run:
        return report
    checks = SwitchedChecks(spaces, met.flange_speed)
    observer = Observer.open(link, None, met.described, met.trust.senders, options.lead_ms / 1e3)
    times = CycleTimes()
    stream = met.stream(options, checks.stages, times)
    loop = ControlLoop(
        met.robot, observer, stream, times, met.status, stop, lock_step=options.lock_step
    )
    follower = PathFollower(
        met.robot, observer, stream, loop, checks, limits, FINGER_TIP, met.status
    )
    run = WayRun(
        met.robot,
        stream,
        loop,
        follower,
        met.status,
        stop,
        lock_step=options.lock_step,
        tell=tell,
    )
    stream.warm_up()
    met.status.fire(SessionEvent.CONNECTED, f"{met.described.backend} robot")
    report.stops = run.run(legs)
    after = met.robot.describe()
    report.measured, report.contact = run.measured, dict(after.contact)
    report.usage, report.missed_cycles = stream.usage, stream.missed_cycles
    report.seconds = (after.clock_ns - met.described.clock_ns) / 1e9
    return report
