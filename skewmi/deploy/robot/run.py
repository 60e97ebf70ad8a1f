"""Put a simulated robot server together and run it until it is told to end."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.robot.backend import fresh_tick
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.controller import LEASE_NS, RobotController
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.server import RobotServer, ServerOptions
from skewmi.deploy.safety.limits import WORKSPACE_TOLERANCE, ChunkChecker, Forward
from skewmi.deploy.safety.validation import ChunkValidator, LimitCheck, ValidationRules
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_NS, JointPoint, JointTrajectory

NODE_NAME = "skewmi_robot"

_ROUNDING = 1e-6
"""m"""

LOCK_STEP_LEASE_NS = 20_000_000_000
"""In lock-step the arm waits for a commander however slow; only a dead one loses it."""


def limit_check(limits: JointLimits, workspace: Workspace) -> LimitCheck:
    """The limits that the robot server enforces: joints and hand speed always, the box from inside.

    A motion that starts outside the box (on the way to the start pose) is only checked for joint
    limits and hand speed; once the arm is inside, it cannot leave. The room that the checker
    leaves around the box counts as inside: else the way out would lead through it.

    Args:
        limits: Of the joints.
        workspace: The task's box.
    """
    forward = _SharedForward(ArmKinematics("right").forward)
    anywhere = ChunkChecker(limits, None, forward)
    inside = ChunkChecker(limits, workspace, forward)
    base = np.array(workspace.base_position)
    room = WORKSPACE_TOLERANCE + _ROUNDING
    low, high = np.array(workspace.low) - base - room, np.array(workspace.high) - base + room

    def check(samples: JointTrajectory, present: JointPoint, earlier: Array) -> object:
        # The first sample is where the accepted plan is, or the checker refuses it: their
        # distance, 1e-9 rad at most, is far less than the rounding that is allowed for.
        start = forward.begin(samples.q)[0][0]
        checker = inside if bool(((low <= start) & (start <= high)).all()) else anywhere
        return checker.check(samples.q, samples.v, samples.a, previous=present, earlier=earlier)

    return check


class _SharedForward:
    """Forward kinematics that are worked out once for all who judge a chunk."""

    def __init__(self, forward: Forward) -> None:
        self._forward = forward
        self._chunk: Array | None = None

    def begin(self, q: Array) -> tuple[Array, Array]:
        """Work them out for a chunk. Until the next `begin` it must not be written to."""
        self._poses, self._chunk = self._forward(q), q
        return self._poses

    def __call__(self, q: Array) -> tuple[Array, Array]:
        return self._poses if q is self._chunk else self._forward(q)


@dataclass(frozen=True)
class SimulatedRobotOptions:
    """What a simulated robot is started with."""

    limits: JointLimits
    task: str | None = None
    """Whose scene; None for that of the registry's default task."""
    lock_step: bool = False
    variation: str | None = None
    """How robot and scene differ from the nominal ones, see `MujocoBackend`."""
    start_configuration: tuple[float, ...] | None = None
    """Where the arm is at first, chain order, rad; the task's start if not given."""


def run_simulated_robot(
    config: TransportConfig,
    options: SimulatedRobotOptions,
    stop: threading.Event,
    on_ready: Callable[[RobotDescription], None] | None = None,
) -> None:
    """Serve a simulated robot until `stop` is set.

    Args:
        config: Where to listen.
        options: Task, limits, pace.
        stop: Set by a signal handler or another thread.
        on_ready: Called once everything is declared.

    Raises:
        NotFoundError: No such task or variation.
        ConfigurationError: The variation is not valid.
        TransportError: The port is in use.
    """
    start = options.start_configuration
    # The port first: a taken one is reported before the scene is compiled.
    with Link.open(config, NODE_NAME) as link:
        configuration = None if start is None else np.array(start)
        backend = MujocoBackend(options.task, configuration, options.variation)
        assert backend.layout.workspace is not None
        rules = ValidationRules(joint_names=backend.joint_names, grid_ns=GRID_NS)
        check = limit_check(options.limits, backend.layout.workspace)
        controller = RobotController(
            backend,
            ChunkValidator(rules, check),
            lease_ns=LOCK_STEP_LEASE_NS if options.lock_step else LEASE_NS,
            first_tick=fresh_tick(),
        )
        server = RobotServer(
            backend, controller, link, ServerOptions(options.limits, options.lock_step)
        )
        if on_ready is not None:
            on_ready(server.describe())
        server.run(stop)
