"""Put a robot server together for a robot of any kind, and run it until it is told to end."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

from skewmi.box_frame import box_displacement
from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.calibration_use import (
    fingerprint,
    low_pass_s,
    require_robot,
    servo_constants,
)
from skewmi.deploy.robot.backend import Scene, fresh_start_ns
from skewmi.deploy.robot.backends import BackendOptions, make_backend
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.controller import LEASE_NS, RobotController
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.server import RobotServer
from skewmi.deploy.robot.warm_up import warm_up
from skewmi.deploy.robot.workspaces import spaces_of, told_box
from skewmi.deploy.safety.checks import limit_check, space_checks
from skewmi.deploy.safety.validation import ChunkValidator, ValidationRules
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_NS

NODE_NAME = "skewmi_robot"

LOCK_STEP_LEASE_NS = 20_000_000_000
"""In lock-step the arm waits for a commander however slow; only a dead one loses it."""


def serve_robot(
    name: str,
    options: BackendOptions,
    config: TransportConfig,
    limits: JointLimits,
    stop: threading.Event,
    on_ready: Callable[[RobotDescription], None] | None = None,
    calibration: Calibration | None = None,
) -> None:
    """Serve a robot until `stop` is set.

    Args:
        name: Of the robot, one of `backends.BACKENDS`.
        options: For it.
        config: Where to listen.
        limits: To enforce.
        stop: Set by a signal handler or another thread.
        on_ready: Called once everything is declared.
        calibration: What is known of the robot and its scene: its servos get feed-forward from it,
            behind the checks and within the same limits, and the task is that of the box where it
            says that it stands.

    Raises:
        NotFoundError: No such robot, task or variation.
        ConfigurationError: The options are not for that robot, or it has no use for the
            calibration, or cannot do the task where the box stands.
        TransportError: The port is in use, or the robot cannot be reached.
    """
    known = ""
    if calibration is not None:
        options = _knowing(name, options, limits, calibration)
        known = "" if options.feed_forward is None else fingerprint(calibration)
    # The port first: a taken one is reported before a scene is compiled.
    with Link.open(config, NODE_NAME) as link:
        backend = make_backend(name, replace(options, link=link))
        _require_box(name, backend.scene, options.box)
        enforced = limits.no_faster(backend.joint_speed)
        workspace = None if backend.scene is None else backend.scene.workspace
        spaces = spaces_of(backend.scene)
        rules = ValidationRules(joint_names=backend.joint_names, grid_ns=GRID_NS)
        validator = ChunkValidator(
            rules,
            limit_check(enforced, workspace, backend.admitted_speed),
            space_checks(enforced, spaces, backend.admitted_speed),
        )
        warm_up(backend, validator)
        controller = RobotController(
            backend,
            validator,
            lease_ns=LOCK_STEP_LEASE_NS if backend.lock_step else LEASE_NS,
            start_ns=fresh_start_ns(),
        )
        server = RobotServer(backend, controller, link, limits, spaces, calibration=known)
        server.open_stop_path(config)
        server.run(stop, on_ready)


def _knowing(
    name: str, options: BackendOptions, limits: JointLimits, calibration: Calibration
) -> BackendOptions:
    """What a robot is told of a calibration, besides its options.

    Raises:
        ConfigurationError: It is of another kind of robot, or says nothing that is of use to one.
    """
    egm = _bridge(name, options)
    require_robot(calibration, name, None if egm is None else egm.feed_forward)
    followed = limits if egm is None else limits.no_faster(egm.joint_speed)
    return replace(
        options,
        feed_forward=_feed_forward(calibration, followed),
        low_pass_s=low_pass_s(calibration),
        box=box_displacement(calibration),
    )


def _bridge(name: str, options: BackendOptions) -> EgmOptions | None:
    """Of a bridge to a controller; None for other robots."""
    if name != "egm":
        return None
    return EgmOptions() if options.egm is None else options.egm


def _feed_forward(calibration: Calibration, limits: JointLimits) -> FeedForward | None:
    """Of servos that were calibrated; None if the box alone was.

    Raises:
        ConfigurationError: Nothing was that a robot server can use.
    """
    constants = servo_constants(calibration)
    if constants is not None:
        return FeedForward(constants, limits)
    if box_displacement(calibration) is None:
        raise ConfigurationError(
            "the calibration knows neither servos nor where the box stands, and a robot server has "
            "no use for anything else; run skewmi calibrate servo or scene"
        )
    return None


def _require_box(
    name: str, scene: Scene | None, displacement: tuple[float, float, float] | None
) -> None:
    """See that a robot's scene has taken over where the box is known to stand.

    Raises:
        ConfigurationError: It has not, and its workspace would be another one than the session's.
    """
    box = told_box(scene)
    if displacement != (None if box is None else (box.x, box.y, box.yaw_deg)):
        raise ConfigurationError(
            f"the calibration says where the task's box stands (section scene), and robot {name!r} "
            "has no scene that can be told: give it a calibration without that section"
        )
