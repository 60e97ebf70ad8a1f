"""Options of `skewmi robot` for a real controller, and for an emulated one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from skewmi.box_frame import box_displacement
from skewmi.calibration.calibration_file import Calibration
from skewmi.deploy.robot.backends.egm.options import EgmOptions, TaskFacts
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.backends.mujoco.scene_geometry import Standing, scene_geometry
from skewmi.deploy.robot.egm_emulator.emulator import REAL_RATE_HZ, EmulatorOptions
from skewmi.deploy.robot.egm_emulator.wires import NetworkOptions
from skewmi.deploy.robot.gripper.base import Gripper
from skewmi.deploy.robot.gripper.fixed import FixedGripper
from skewmi.deploy.robot.gripper.rws import RwsGripper
from skewmi.deploy.robot.gripper.rws_client import DEFAULT_PASSWORD, DEFAULT_USER, RwsClient
from skewmi.errors import ConfigurationError
from skewmi.sim import tasks
from skewmi.sim.arm.scene import ArmScene, workspace_of

_PROGRAM = ProgramSettings()


@dataclass(frozen=True)
class EgmFlags:
    """Of `--backend egm`, and of `--backend egm-emulator` where both sides share them."""

    egm_listen: str = "127.0.0.1:6512"
    """Where the controller sends the right arm's packets to, HOST:PORT of this computer: with
    `--backend egm`."""
    egm_listen_left: str | None = None
    """The same for the left arm; by default the port before, and "none" for no left arm."""
    egm_controller: str | None = None
    """IPv4 address that packets must come from; by default the first sender's."""
    egm_gain: float = _PROGRAM.gain
    """Position gain of the controller, 1/s: Default Proportional Position Gain in moc.cfg."""
    egm_low_pass_hz: float = _PROGRAM.low_pass_hz
    """LpFilter of the program, Hz."""
    egm_feed_forward: float = 1.0
    """Fraction of the plan's speed that is sent as speed reference, 0..1."""
    egm_run_on_limit_mm: float = 10.0
    """How far the flange may run on if the bridge dies, mm: bounds the speed that is admitted."""
    egm_comm_timeout_s: float | None = None
    """CommTimeout of the program, s; by default what `rapid/` sets (0.1), and 1 for the
    emulator."""
    egm_ramp_in_s: float = _PROGRAM.ramp_in_s
    """RampInTime of the program, s."""
    egm_ramp_out_s: float = _PROGRAM.ramp_out_s
    """Default Ramp Time in moc.cfg, s."""
    egm_max_speed_deviation: float = _PROGRAM.max_speed_deviation_deg_s
    """MaxSpeedDeviation of the program, deg/s."""
    gripper: Literal["none", "fixed", "rws"] = "fixed"
    """How the right gripper is moved: not at all, fixed at the task's opening, or by Robot Web
    Services and the RAPID task of `rapid/`: with `--backend egm`."""
    gripper_opening_mm: float | None = None
    """Opening of each finger with `--gripper fixed`, mm; by default the task's."""
    rws_url: str = "http://192.168.125.1"
    """Robot Web Services of the controller, RobotWare 6: with `--gripper rws`."""
    rws_user: str = DEFAULT_USER
    """User of the controller."""
    rws_password: str = DEFAULT_PASSWORD
    """Of that user."""

    egm_remote: str = "127.0.0.1:6512"
    """Where the emulated controller sends the right arm's packets to, HOST:PORT."""
    egm_remote_left: str | None = None
    """The same for the left arm; without it the emulated controller has one arm."""
    egm_rate_hz: float = round(REAL_RATE_HZ, 1)
    """Cycles a second of the emulated controller; 248 are 4.032 ms."""
    egm_lag_ms: float = 20.0
    """From its desired position to the servos, ms; ABB says 10 to 20."""
    egm_loss: float = 0.0
    """Probability that a datagram is lost, each way."""
    egm_jitter_ms: float = 0.0
    """Datagrams come up to so much later, ms."""
    robotware: Literal[6, 7] = 6
    """Whose packets the emulated controller sends."""
    seed: int = 0
    """Of loss and jitter."""
    connect: str | None = None
    """Zenoh locator of the robot server that the emulator's scene belongs to; by default
    tcp/127.0.0.1:7447. The emulator runs without it, and keeps trying."""

    def program(self, *, comm_timeout_s: float) -> ProgramSettings:
        """What the program does; `comm_timeout_s` unless the flag says otherwise."""
        given = self.egm_comm_timeout_s
        return ProgramSettings(
            gain=self.egm_gain,
            low_pass_hz=self.egm_low_pass_hz,
            ramp_in_s=self.egm_ramp_in_s,
            ramp_out_s=self.egm_ramp_out_s,
            comm_timeout_s=comm_timeout_s if given is None else given,
            max_speed_deviation_deg_s=self.egm_max_speed_deviation,
        )

    def bridge(self) -> EgmOptions:
        """For `--backend egm`."""
        return EgmOptions(
            listen=self.egm_listen,
            listen_left=self.egm_listen_left,
            controller=self.egm_controller,
            program=self.program(comm_timeout_s=_PROGRAM.comm_timeout_s),
            feed_forward=self.egm_feed_forward,
            run_on_limit=self.egm_run_on_limit_mm / 1e3,
        )

    def emulator(self, task: str, variation: str | None) -> EmulatorOptions:
        """For `--backend egm-emulator`."""
        return EmulatorOptions(
            remote=self.egm_remote,
            remote_left=self.egm_remote_left,
            rate_hz=self.egm_rate_hz,
            lag_ms=self.egm_lag_ms,
            robotware=self.robotware,
            program=self.program(comm_timeout_s=1.0),
            network=NetworkOptions(self.egm_loss, self.egm_jitter_ms, self.seed),
            task=task,
            variation=variation,
        )

    def make_gripper(self, facts: TaskFacts) -> Gripper | None:
        """For `--backend egm`."""
        opening = facts.workspace.gripper_opening
        if self.gripper_opening_mm is not None:
            opening = self.gripper_opening_mm / 1e3
        if self.gripper == "none":
            return None
        if self.gripper == "fixed":
            return FixedGripper(opening)
        return RwsGripper.open(RwsClient(self.rws_url, self.rws_user, self.rws_password), opening)


BareEgmFlags = Annotated[EgmFlags, tyro.conf.arg(name="")]
"""Without a prefix of their own."""


def task_facts(task: str, calibration: Calibration | None = None) -> TaskFacts:
    """What a robot has to know of a task.

    Args:
        task: Its name.
        calibration: Says where its box stands, if that was found.

    Raises:
        NotFoundError: No such task.
        ConfigurationError: It is not one for a robot, or cannot be done where the box stands.
    """
    spec = tasks.find(task)
    if spec.arm is None:
        raise ConfigurationError(f"task {task!r} has no robot in it")
    scene = ArmScene(spec.arm, box_displacement(calibration))
    standing = Standing(scene.base, spec.arm.box_body)
    geometry = scene_geometry(scene.model, spec.scene_fields, standing)
    return TaskFacts(
        task=task,
        layout_hashes=tuple(layout.hash() for _, layout in spec.layouts()),
        workspace=workspace_of(scene.placed(spec.layout())),
        shapes_json=geometry.to_json(),
        box=scene.box,
    )
