"""Run a policy on a robot: `run_deploy` is everything `skewmi deploy` does but parse and print."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from importlib import import_module

from skewmi.box_frame import box_displacement
from skewmi.calibration.calibration_file import Calibration, read_calibration
from skewmi.calibration.calibration_use import require_robot, servo_constants
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import run_metadata
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.replay.live import LiveView
from skewmi.deploy.report import DeployReport
from skewmi.deploy.robot.description import (
    SCENE_REQUEST,
    RobotDescription,
    admitted,
    limit_values,
    recorded_facts,
)
from skewmi.deploy.robot.process import EMULATOR, spawn_robot
from skewmi.deploy.run_watch import RunWatch
from skewmi.deploy.session.deployable import require_workspace
from skewmi.deploy.session.steadiness import TooBusyError
from skewmi.deploy.session.trust import Trust
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError
from skewmi.policy_io import Policy
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi

NODE_NAME = "skewmi_deploy"


def run_deploy(
    policy: Policy,
    options: DeployOptions,
    *,
    stop: threading.Event | None = None,
    on_event: Callable[[str], None] | None = None,
    watch: RunWatch | None = None,
) -> DeployReport:
    """Run episodes of a policy on a robot server.

    Args:
        policy: An ONNX policy, or anything else that acts on observations of its layout.
        options: Which robot, how many episodes, how fast.
        stop: Set it from anywhere to bring the arm smoothly to rest and end the run.
        on_event: Told in words what happens, for progress.
        watch: Can tell at any time, from any thread, how far the run is.

    Returns:
        What happened. Trouble during an episode is in the report, not raised.

    Raises:
        NotFoundError: No such limit profile or calibration file.
        TransportError: No robot server answers, or the simulated one does not start.
        LayoutMismatchError: The robot server is not what the policy was made for.
        ConfigurationError: Limits or pace of the robot server differ, or the calibration is none
            of this robot model.
    """
    stop = threading.Event() if stop is None else stop
    tell = (lambda text: None) if on_event is None else on_event
    joint_limits.profile(options.limits)
    require_workspace(policy.layout)
    try:
        return _run(policy, options, stop, tell, watch)
    except TooBusyError as busy:
        note = f"{busy}. The run begins anew: the simulated robot waits for it now (--lock-step)"
        tell(note)
        # A file that is there was begun by this run, or might be replaced anyway.
        report = _run(policy, replace(options, lock_step=True, overwrite=True), stop, tell, watch)
        report.notes.insert(0, note)
        return report


def _run(
    policy: Policy,
    options: DeployOptions,
    stop: threading.Event,
    tell: Callable[[str], None],
    watch: RunWatch | None,
) -> DeployReport:
    """As `run_deploy`, at the pace of the options.

    Raises:
        TooBusyError: In real time, by a simulated robot that was started for this run.
        SkewmiError: As `run_deploy`.
    """
    profile = joint_limits.profile(options.limits)
    report = DeployReport(
        task=policy.layout.task,
        robot=options.connect or str(options.zenoh_config or options.robot),
        limit_profile=profile.name,
        speed=options.speed,
        lock_step=options.lock_step,
        dry_run=options.dry_run,
        velocity_fraction=options.speed,
        planned_episodes=options.episodes,
    )
    known = None if options.calibration is None else read_calibration(options.calibration)
    serves = servo_constants(known) is not None or box_displacement(known) is not None
    if known is not None and options.starts_robot:
        # Before a robot is started: it would say the same, and nobody would see it.
        require_robot(known, _served(options.robot))
    with _robot_server(options, policy.layout.task, tell, serves) as locator:
        config = TransportConfig.for_client(
            locator,
            domain=options.domain,
            lock_step=options.lock_step,
            zenoh_config=options.zenoh_config,
        )
        # Late: what plans and judges takes a while to import, and a robot that is started needs the
        # same while.
        from skewmi.deploy.session.connect import connect

        with Link.open(config, NODE_NAME) as link:
            link.wait_for_robot(5.0)
            session = connect(policy, options, link, report, stop, tell, known)
            with (
                _beside(options, policy, link, session.trust, config, report, known),
                nullcontext() if watch is None else watch.on(session.progress),
            ):
                session.run()
    return report


def _served(robot: str) -> str:
    """What the robot server of a robot that is started calls it: a bridge, for an emulator."""
    return "egm" if robot == EMULATOR else robot


def _robot_server(
    options: DeployOptions, task: str, tell: Callable[[str], None], serves: bool
) -> AbstractContextManager[str | None]:
    """Locator of the robot server that the options name, or of one that is started.

    Args:
        options: Name it.
        task: Of the policy.
        tell: Told that one is started.
        serves: Whether the calibration says anything that a robot server needs.
    """
    if not options.starts_robot:
        return nullcontext(options.connect)
    tell(f"starting the robot {options.robot!r} in its own process")
    return spawn_robot(
        options.robot,
        task,
        options.limits,
        lock_step=options.lock_step,
        variation=options.variation,
        calibration=options.calibration if serves else None,
        domain=options.domain,
        meanwhile=_prepare,
    )


def _prepare() -> None:
    """Load what the session needs, while its robot starts."""
    import_module("skewmi.deploy.session.connect")


@contextmanager
def _beside(
    options: DeployOptions,
    policy: Policy,
    link: Link,
    trust: Trust,
    config: TransportConfig,
    report: DeployReport,
    known: Calibration | None,
) -> Iterator[None]:
    """Record and show the run, if asked to, from processes of their own."""
    if options.record is None and options.live is None:
        yield
        return
    metadata = _metadata(options, policy, link, trust, known)
    client = replace(config, lock_step=False)
    with (
        _live_view(options, metadata, client, trust, report),
        _recording(options, metadata, client, trust, report),
    ):
        # They have subscribed at the robot server. Once it answers, our publishers know, too, and
        # the first messages are not lost.
        link.call(topics.YUMI_DESCRIBE, 5.0, only=trust.server)
        yield


def _metadata(
    options: DeployOptions, policy: Policy, link: Link, trust: Trust, known: Calibration | None
) -> dict[str, str]:
    """What the run is about."""
    from skewmi.deploy.session.pace import planning_limits

    servos = servo_constants(known)
    reply = link.call(topics.YUMI_DESCRIBE, 5.0, SCENE_REQUEST, only=trust.server)
    description = RobotDescription.from_json(reply.message)
    limits = admitted(planning_limits(options.limits, options.speed, servos), description)
    return run_metadata(
        layout_json=policy.layout.to_json(),
        limits=limit_values(limits),
        scene=description.scene or None,
        task=policy.layout.task,
        policy=options.policy_name,
        seed=str(options.seed),
        limit_profile=limits.name,
        robot_model_hash=yumi.MODEL_HASH,
        lock_step=str(options.lock_step),
        **recorded_facts(description),
        **({} if options.variation is None else {"variation": options.variation}),
        **({} if options.calibration is None else {"calibration": str(options.calibration)}),
    )


@contextmanager
def _recording(
    options: DeployOptions,
    metadata: dict[str, str],
    client: TransportConfig,
    trust: Trust,
    report: DeployReport,
) -> Iterator[None]:
    """What the run is about first, how it went at the end."""
    if options.record is None:
        yield
        return
    recorder = Recorder.start(
        options.record,
        client,
        metadata,
        believed=trust.believed,
        overwrite=options.overwrite,
    )
    trust.on_believed.append(recorder.believe)
    try:
        yield
    except BaseException:
        # What went wrong first matters more than what went wrong with the recording.
        with suppress(TransportError):
            recorder.close()
        raise
    try:
        recorder.add_metadata({"report": json.dumps(report.as_dict())})
        summary = recorder.close()
    except TransportError as error:
        # What the arm did is told even if the file is lost.
        report.broken_files.append(str(options.record))
        report.notes.append(str(error))
        return
    report.files.append(str(summary.path))
    report.add_strangers(summary.strangers)
    if summary.missed:
        report.notes.append(f"the recording lacks {summary.missed} messages")


@contextmanager
def _live_view(
    options: DeployOptions,
    metadata: dict[str, str],
    client: TransportConfig,
    trust: Trust,
    report: DeployReport,
) -> Iterator[None]:
    if options.live is None:
        yield
        return
    title = options.policy_name or report.task
    with LiveView.start(options.live, client, metadata, title, trust.believed) as view:
        trust.on_believed.append(view.believe)
        yield
        report.notes += view.close()
        report.add_strangers(view.strangers)
    if options.live.out is not None:
        kept = report.files if view.file_is_whole else report.broken_files
        kept.append(str(options.live.out))
