"""Where a session's parts are made and put together, on an open link to a robot server."""

from __future__ import annotations

import threading
from collections.abc import Callable

from skewmi.box_frame import known_stiffness, placed
from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.calibration_use import servo_constants
from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.report import DeployReport
from skewmi.deploy.robot.description import FLANGE_SPEED, RobotDescription, admitted
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT
from skewmi.deploy.session.agreement import check_agreement, check_pace
from skewmi.deploy.session.approach import Approach
from skewmi.deploy.session.arm_delay import ArmDelay
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.deployable import require_workspace
from skewmi.deploy.session.episode import EpisodeRunner
from skewmi.deploy.session.known_robot import agree_on_box, agree_on_calibration
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.open_space import obstacles_before
from skewmi.deploy.session.pace import Pace, choose_pace, planning_limits
from skewmi.deploy.session.policy_motion import PolicyMotion
from skewmi.deploy.session.policy_topics import PolicyTopics
from skewmi.deploy.session.preflight import Preflight
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.session import Session
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.steadiness import TooBusyError, check_steadiness
from skewmi.deploy.session.stream import ChunkStream, lead_of
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.session.trust import Trust
from skewmi.deploy.session.warm_up import Rehearsal, warm_up
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link
from skewmi.policy_io import Policy


def connect(
    policy: Policy,
    options: DeployOptions,
    link: Link,
    report: DeployReport,
    stop: threading.Event,
    tell: Callable[[str], None],
    known: Calibration | None = None,
) -> Session:
    """Make a session that is ready to run; the arm does not move yet.

    Args:
        policy: What decides.
        options: How.
        link: Open, to the robot server.
        report: Told the speed, and given to the session.
        stop: Set from outside to end the run with a smooth stop.
        tell: Told in words what happens.
        known: Of robot and scene.

    Raises:
        LayoutMismatchError: The robot server is not what the policy was made for.
        ConfigurationError: The robot server's limits or pace differ.
        TransportError: It does not answer.
        TooBusyError: This computer is too busy, and the simulated robot of this run could wait.
    """
    layout, servos = policy.layout, servo_constants(known)
    shown = PolicyTopics.open(link, layout)
    robot, status, trust = _ends_of(link, shown, options)
    described = trust.meet(with_scene=True)
    limits = admitted(planning_limits(options.limits, options.speed, servos), described)
    check_pace(described, lock_step=options.lock_step)
    check_agreement(layout, options.robot_model_hash, limits, described)
    workspace = placed(require_workspace(layout), agree_on_box(known, described))
    status.clock_ns = described.clock_ns
    robot.delay = _agreed_delay(known, described, report, tell)
    lead_s = options.lead_ms / 1e3
    observer = Observer.open(link, layout, described, trust.senders, lead_s, known)
    flange_speed = described.limits.get(FLANGE_SPEED, (TCP_SPEED_LIMIT,))[0]
    checks = ChunkChecks(limits, workspace, flange_speed, obstacles_before(described))
    times = CycleTimes()
    stream = _stream_to(robot, described, checks, times, options)
    loop = ControlLoop(robot, observer, stream, times, status, stop, lock_step=options.lock_step)
    planner = Planner(workspace, limits, flange_speed=flange_speed)
    pace = choose_pace(layout, options.speed, planner.hand_bounds.speed, limits.name)
    _tell_pace(pace, report, tell)
    motion = PolicyMotion(
        *(policy, planner, observer, stream, robot, shown, times, pace.step_cycles),
        known_stiffness(known, workspace),
    )
    parts = layout, options, limits, robot, observer, checks, status, stop, described, workspace
    preflight = Preflight(*parts)
    approach = Approach(loop, stream, limits, flange_speed)
    episodes = EpisodeRunner(
        layout, options, preflight, approach, motion, loop, checks, robot, status
    )
    spare = Planner(workspace, limits, flange_speed=flange_speed)
    rehearsal = warm_up(Rehearsal(policy, workspace, spare, checks), stream)
    can_wait = described.simulated and options.may_wait
    _watch_pace(observer, rehearsal, report, tell, can_wait)
    can_wait = can_wait and options.live is None  # who looks on has seen what would begin anew
    status.fire(SessionEvent.CONNECTED, f"{described.backend} robot, {described.task}")
    return Session(options, episodes, status, trust, stream, times, report, stop, can_wait, tell)


def _agreed_delay(
    known: Calibration | None,
    described: RobotDescription,
    report: DeployReport,
    tell: Callable[[str], None],
) -> ArmDelay:
    """How late the arm is, as far as session and robot server know of it."""
    agreement = agree_on_calibration(known, described)
    _tell(agreement.note, report, tell)
    return ArmDelay(agreement.delay_s)


def _ends_of(
    link: Link, shown: PolicyTopics, options: DeployOptions
) -> tuple[RobotClient, SessionStatus, Trust]:
    """A session's ends of the link: whom it commands, what it says, and whom it believes."""
    told = link.publisher(topics.YUMI_STATUS)
    commands, gripper = link.publisher(topics.YUMI_TRAJECTORY), link.publisher(topics.YUMI_GRIPPER)
    own = {
        topics.YUMI_STATUS.name: (told.gid,),
        topics.YUMI_TRAJECTORY.name: (commands.gid,),
        topics.YUMI_GRIPPER.name: (gripper.gid,),
        **shown.gids,
    }
    status, trust = SessionStatus(told), Trust(link, own, options.scene_from)
    trust.on_stranger = status.tell_strangers
    robot = RobotClient.open(link, trust, commands, gripper, dry_run=options.dry_run)
    return robot, status, trust


def _stream_to(
    robot: RobotClient,
    described: RobotDescription,
    checks: ChunkChecks,
    times: CycleTimes,
    options: DeployOptions,
) -> ChunkStream:
    """Where chunks go to."""
    return ChunkStream(
        robot.put_chunk,
        described.joint_names,
        checks.stages,
        times,
        lock_step=options.lock_step,
        lead_ns=lead_of(options.lead_ms, described.cycle_ns),
    )


def _watch_pace(
    observer: Observer,
    rehearsal: Rehearsal,
    report: DeployReport,
    tell: Callable[[str], None],
    can_wait: bool,
) -> None:
    """See whether this computer keeps up; a robot that can wait for it is left to the caller."""
    if report.lock_step:
        return
    try:
        check_steadiness(observer, rehearsal)
    except TooBusyError as error:
        if can_wait:
            raise
        report.notes.append(str(error))
        tell(str(error))


def _tell_pace(pace: Pace, report: DeployReport, tell: Callable[[str], None]) -> None:
    report.speed = pace.speed
    _tell(pace.note, report, tell)


def _tell(note: str | None, report: DeployReport, tell: Callable[[str], None]) -> None:
    if note is not None:
        report.notes.append(note)
        tell(note)
