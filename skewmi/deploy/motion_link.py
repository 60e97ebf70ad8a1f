"""The link of a motion that is no policy's to a robot server that runs, or is started for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from skewmi.deploy.robot.description import FLANGE_SPEED, RobotDescription, admitted
from skewmi.deploy.robot.process import spawn_robot
from skewmi.deploy.safety.checks import Check
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT
from skewmi.deploy.session.agreement import check_pace, check_robot
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.stream import ChunkStream, lead_of
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.session.trust import Trust
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.limits import JointLimits

NODE_NAME = "skewmi_calibrate"


@dataclass(frozen=True)
class JointMotionOptions:
    """How to move; as `options.DeployOptions` of the same names."""

    task: str
    """Of the simulated robot that is started."""
    connect: str | None = None
    zenoh_config: Path | None = None
    variation: str | None = None
    domain: int = 0
    lock_step: bool = False
    limits: str = "lab"
    lead_ms: float = 100.0
    """Nothing has to be answered fast: as long as a busy computer may need."""
    record: Path | None = None
    overwrite: bool = False
    dry_run: bool = False
    """Plan, and leave the arm where it is."""
    metadata: dict[str, str] = field(default_factory=dict)
    """More for the recording."""
    node: str = NODE_NAME
    """Under which name others see it."""


@contextmanager
def robot_link(
    options: JointMotionOptions, tell: Callable[[str], None]
) -> Iterator[tuple[Link, TransportConfig]]:
    """An open link to the robot server that the options name, or to one that is started.

    Raises:
        TransportError: None answers, or the simulated one does not start.
    """
    with _robot_server(options, tell) as locator:
        config = TransportConfig.for_client(
            locator,
            domain=options.domain,
            lock_step=options.lock_step,
            zenoh_config=options.zenoh_config,
        )
        with Link.open(config, options.node) as link:
            link.wait_for_robot(5.0)
            yield link, config


@dataclass(frozen=True)
class MetRobot:
    """A robot server that was found, and a session's ends of the link to it."""

    robot: RobotClient
    status: SessionStatus
    trust: Trust
    described: RobotDescription

    @staticmethod
    def on(link: Link, options: JointMotionOptions) -> MetRobot:
        """Find it, and see that limits and pace agree.

        Raises:
            TransportError: There is none, or more than one.
            ConfigurationError: They do not agree.
        """
        told = link.publisher(topics.YUMI_STATUS)
        commands = link.publisher(topics.YUMI_TRAJECTORY)
        gripper = link.publisher(topics.YUMI_GRIPPER)
        own = {
            topics.YUMI_STATUS.name: (told.gid,),
            topics.YUMI_TRAJECTORY.name: (commands.gid,),
            topics.YUMI_GRIPPER.name: (gripper.gid,),
        }
        status, trust = SessionStatus(told), Trust(link, own, None)
        trust.on_stranger = status.tell_strangers
        robot = RobotClient.open(link, trust, commands, gripper, dry_run=False)
        described = trust.meet(with_scene=True)
        check_pace(described, lock_step=options.lock_step)
        check_robot(joint_limits.profile(options.limits), described)
        return MetRobot(robot, status, trust, described)

    def admitted(self, profile: str) -> JointLimits:
        """A profile's limits as far as the robot follows them."""
        return admitted(joint_limits.profile(profile), self.described)

    @property
    def flange_speed(self) -> float:
        """That the robot admits, m/s."""
        admitted = self.described.limits.get(FLANGE_SPEED, (TCP_SPEED_LIMIT,))[0]
        return min(admitted, TCP_SPEED_LIMIT)

    def stream(
        self,
        options: JointMotionOptions,
        stages: Sequence[tuple[str, Check]],
        times: CycleTimes,
    ) -> ChunkStream:
        """Where chunks go to.

        Args:
            options: Lead and pace.
            stages: Checks that every chunk has to pass.
            times: Told how long they take.
        """
        return ChunkStream(
            self.robot.put_chunk,
            self.described.joint_names,
            stages,
            times,
            lock_step=options.lock_step,
            lead_ns=lead_of(options.lead_ms, self.described.cycle_ns),
        )


def _robot_server(
    options: JointMotionOptions, tell: Callable[[str], None]
) -> AbstractContextManager[str | None]:
    """Where to connect to; the simulated robot, if none is named, runs as long as the context."""
    if options.connect is not None or options.zenoh_config is not None:
        return nullcontext(options.connect)
    tell("starting the simulated robot in its own process")
    return spawn_robot(
        "sim",
        options.task,
        options.limits,
        lock_step=options.lock_step,
        variation=options.variation,
        domain=options.domain,
    )
