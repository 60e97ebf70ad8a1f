"""From a robot server to an armed one with a free way to where the episode starts."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.deploy.session.agreement import check_agreement, check_same_box
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.deployable import require_workspace
from skewmi.deploy.session.interrupt import StopRequestedError, check_interrupt
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.readiness import wait_until_ready
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.status import SessionStatus
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array, PolicyLayout, Workspace
from skewmi.robot_models.base_frame import BaseFrame
from skewmi.robot_models.frames import rotation_from_quaternion
from skewmi.robot_models.kinematics import ArmKinematics, require_converged
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import JointPoint

OTHER_POSTURE = 0.5
"""Joint distance from the task's posture beyond which the start is sought from there, rad."""

_START_ITERATIONS = 50

_WAY_SAMPLES = 10
"""The guard looks at so many samples at once: few enough to be near each other."""


@dataclass(frozen=True)
class AtHold:
    """An armed robot server that holds the arm, ready to move.

    Attributes:
        state: The newest state.
        q: Where the arm is held, rad. Shape (7,).
        q_goal: Where the episode starts, rad. Shape (7,).
    """

    state: ArmState
    q: Array
    q_goal: Array


class Preflight:
    """Everything between two episodes, or before the first, that moves nothing.

    Args:
        layout: Of the policy; must have a workspace.
        options: Spread of the starts, hash of the policy's robot model.
        limits: That motion is planned with.
        robot: To arm.
        observer: Where states come from.
        checks: That every chunk has to pass.
        status: Keeps the time of the newest state.
        stop: Set from outside to end the run.
        description: What the robot server said of itself when the session connected to it.
        workspace: The layout's, placed as both sides agreed that the box stands.
    """

    def __init__(
        self,
        layout: PolicyLayout,
        options: DeployOptions,
        limits: JointLimits,
        robot: RobotClient,
        observer: Observer,
        checks: ChunkChecks,
        status: SessionStatus,
        stop: threading.Event,
        description: RobotDescription,
        workspace: Workspace | None = None,
    ) -> None:
        self._layout = layout
        self._workspace = require_workspace(layout) if workspace is None else workspace
        self._box_pose = dict(description.box_pose)
        self._options = options
        self._limits = limits
        self._robot = robot
        self._observer = observer
        self._checks = checks
        self._status = status
        self._stop = stop
        self._known_stops = description.stops

    def run(self, seed: int) -> AtHold:
        """Arm the robot server, and check the way to the start of an episode.

        Args:
            seed: Of the start, and of a simulated scene.

        Raises:
            StopRequestedError: Somebody has asked to stop.
            SkewmiError: The arm may not move; the message says why.
        """
        check_interrupt(self._stop)
        self._robot.meet()
        self._wait_until_ready()
        # Armed first: a scene that somebody else works in must not be reset.
        self._robot.arm()
        description = self._robot.describe()
        check_agreement(self._layout, self._options.robot_model_hash, self._limits, description)
        check_same_box(self._box_pose, description)
        if description.resettable:
            description = self._reset_scene(seed)
        if description.stops > self._known_stops:
            # Between two episodes a stop changes no state: nothing else tells of it.
            raise StopRequestedError("somebody has asked to stop since the last episode")
        self._status.clock_ns = description.clock_ns
        self._robot.open_gripper(self._workspace.gripper_opening, description.clock_ns)
        q = np.array(description.commanded_position)
        q_goal = draw_start(self._workspace, seed, self._options.start_spread, q)
        self._checks.begin_way(q)
        check_way(q, q_goal, self._limits, self._checks)
        # Checking takes a while: what was fresh before is not any more.
        state = self._observer.fresh_state()
        check_interrupt(self._stop)
        return AtHold(state, q, q_goal)

    def _wait_until_ready(self) -> RobotDescription:
        return wait_until_ready(self._robot, self._stop, dry_run=self._options.dry_run)

    def _reset_scene(self, seed: int) -> RobotDescription:
        """Put the scene back, and command the robot again if it had to be moved for that."""
        self._robot.reset_scene(seed)
        description = self._wait_until_ready()
        if description.state != ServerState.DISARMED.value or self._options.dry_run:
            return description
        self._robot.arm()
        return self._robot.describe()


def draw_start(workspace: Workspace, seed: int, spread: float, q_near: Array) -> Array:
    """Joint angles of an episode's start, drawn around the task's start position.

    Args:
        workspace: Start, posture and orientation of the hand.
        seed: Of the draw.
        spread: Half-width of the uniform offset, m per axis.
        q_near: Where the arm is, rad: the start is the configuration next to it, unless that is
            another posture altogether. Shape (7,).

    Returns:
        rad. Shape (7,).

    Raises:
        KinematicsError: The start cannot be reached.
    """
    offset = np.random.default_rng(seed).uniform(-spread, spread, 3)
    start = np.clip(np.array(workspace.start) + offset, workspace.low, workspace.high)
    posture = np.array(workspace.start_configuration)
    near = posture if np.abs(q_near - posture).max() > OTHER_POSTURE else q_near
    base = BaseFrame.of(workspace)
    result = ArmKinematics("right").inverse(
        base.to_base(start)[None],
        base.rotations_to_base(rotation_from_quaternion(workspace.hand_quaternion_wxyz)),
        near[None],
        posture=posture,
        max_iterations=_START_ITERATIONS,
    )
    require_converged(result)
    q: Array = result.q[0]
    return q


def check_way(q: Array, q_goal: Array, limits: JointLimits, checks: ChunkChecks) -> None:
    """Check the whole motion to a start before any of it is sent.

    Args:
        q: Where the arm rests, rad. Shape (7,).
        q_goal: Where it is to go, rad. Shape (7,).
        limits: To plan with.
        checks: That every chunk has to pass.

    Raises:
        LimitViolationError: An end is outside the position limits, or the way leads through the
            arm, body, table or scene or asks for too much torque.
    """
    motion = StartMotion(q, q_goal, limits).trajectory
    rest = np.zeros(7)
    # Braking tails stay on the line of the motion: where it is free, they are. Limits on the grid
    # are the motion's own business, and every chunk is checked for everything when it is sent.
    guard = dict(checks.stages)["guard"]
    for first in range(0, len(motion), _WAY_SAMPLES):
        start = JointPoint(motion.q[first], rest, rest)
        try:
            guard(motion.part(slice(first, first + _WAY_SAMPLES + 1)), start, start.q[None])
        except LimitViolationError as error:
            if "clearance" not in error.limit:
                raise
            raise LimitViolationError(
                f"the way to the start is not free, {error.limit}", error.value, error.bound,
                f"{error.detail}; skewmi home may find another one",
            ) from error  # fmt: skip
