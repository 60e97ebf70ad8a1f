"""Start a robot server: it publishes joint and scene states and follows checked commands.

`--backend sim` is the simulated YuMi in the task's scene, in a process of its own. It listens on
this machine only unless told otherwise. Each change of its state is told on standard error, with
its reason. Ctrl-C brakes the arm and ends.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from skewmi.calibration.calibration_file import Calibration, read_calibration
from skewmi.cli.egm_flags import BareEgmFlags, EgmFlags, task_facts
from skewmi.cli.interrupt import signals_to_handle
from skewmi.cli.robot_flags import RobotName
from skewmi.cli.task_flags import TaskName
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.egm_emulator.controller_states import ArmState
from skewmi.deploy.robot.egm_emulator.emulator import Emulator
from skewmi.deploy.robot.log import told_from_a_thread
from skewmi.deploy.robot.process import EMULATOR
from skewmi.deploy.robot.run import serve_robot
from skewmi.deploy.state_machine import Transition
from skewmi.deploy.wire.domain import ros_domain
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits as joint_limits
from skewmi.sim import tasks

_log = logging.getLogger("skewmi.robot")


@dataclass(frozen=True)
class RobotCommand:
    """Options of `skewmi robot`."""

    backend: RobotName = "sim"
    """What the robot is: the simulated YuMi, one that holds what it is commanded, a real one behind
    ABB's EGM, or an emulated controller for the latter."""
    task: TaskName = field(default_factory=tasks.default)
    """Whose scene stands in front of the robot."""
    variation: str | None = None
    """How robot and scene differ from the nominal ones: a variation file (YAML), or the name of
    one that comes with the task, as `randomised`."""
    calibration: Path | None = None
    """What is known of the robot, whatever it is: a calibration file (YAML) of `skewmi calibrate`.
    Its servos get feed-forward from it, behind the checks and within the same limits, and the
    task's workspace stands where its box does. Sessions have to know the same of the box."""
    listen: str | None = None
    """Zenoh locator to listen on; by default what --zenoh-config says, else tcp/127.0.0.1:7447."""
    domain: int | None = None
    """ROS 2 domain, 0..232; by default ROS_DOMAIN_ID, else 0."""
    limits: str = "lab"
    """Joint limit profile to enforce (lab, careful); none is verified on hardware."""
    delay_ms: float | None = None
    """From a command to the state that shows it, ms: with `--backend hold`."""
    lock_step: bool = False
    """Advance only when the session's chunk has arrived: as fast as possible, repeatable."""
    zenoh_config: Path | None = None
    """Zenoh configuration file (JSON5 or YAML), such as `skewmi certificates` makes."""
    egm: BareEgmFlags = field(default_factory=EgmFlags)
    """Of a real controller, and of an emulated one."""
    json: bool = False
    """Print the robot server's description as one JSON document once it is ready."""
    end_with_input: bool = False
    """End when standard input is closed: for a parent process that must not leave it behind."""


def run_robot(options: RobotCommand) -> int:
    """Serve until interrupted. Returns 0."""
    profile = joint_limits.profile(options.limits)
    calibration = None if options.calibration is None else read_calibration(options.calibration)
    config = TransportConfig.for_robot(
        options.listen,
        domain=ros_domain(options.domain),
        lock_step=options.lock_step,
        zenoh_config=options.zenoh_config,
    )
    stop = threading.Event()
    for number in signals_to_handle():
        signal.signal(number, lambda *_: stop.set())
    if options.end_with_input:
        threading.Thread(target=_wait_for_end_of_input, args=(stop,), daemon=True).start()
    console = Console(stderr=True)
    if options.backend == EMULATOR:
        return _run_emulator(options, stop, console)

    def ready(description: RobotDescription) -> None:
        if options.json:
            print(description.to_json(), flush=True)
        pace = "lock-step" if options.lock_step else "real time"
        scene = f" ({description.task})" if description.task else ""
        domain = f", ROS 2 domain {config.domain}" if config.domain else ""
        console.print(
            f"[bold]robot {description.backend!r}[/]{scene} listens on {config.where}: {pace}, "
            f"limits {profile.name}{domain}, disarmed. Ctrl-C ends it.",
            highlight=False,
        )
        for locator in config.unprotected:
            console.print(
                f"[bold]anybody on the network can move the arm through {locator}[/]; "
                "`skewmi certificates` secures the link",
                highlight=False,
            )

    with told_from_a_thread(_teller(console)):
        serve_robot(
            options.backend,
            _backend_options(options, calibration),
            config,
            profile,
            stop,
            on_ready=ready,
            calibration=calibration,
        )
    with suppress(OSError):  # The terminal may be gone.
        console.print("arm at rest, robot server ended", highlight=False)
    return 0


def _backend_options(options: RobotCommand, calibration: Calibration | None) -> BackendOptions:
    common = BackendOptions(
        task=options.task,
        variation=options.variation,
        lock_step=options.lock_step,
        delay_s=None if options.delay_ms is None else options.delay_ms / 1e3,
    )
    if options.backend != "egm":
        return common
    facts = task_facts(options.task, calibration)
    return replace(
        common, egm=options.egm.bridge(), facts=facts, gripper=options.egm.make_gripper(facts)
    )


def _run_emulator(options: RobotCommand, stop: threading.Event, console: Console) -> int:
    """An emulated controller instead of a robot server."""
    if options.calibration is not None:
        raise ConfigurationError(
            "an emulated controller is as it is; give --calibration to the bridge, skewmi robot "
            "--backend egm"
        )
    emulated = options.egm.emulator(options.task, options.variation)
    config = TransportConfig.for_client(
        options.egm.connect,
        zenoh_config=options.zenoh_config,
        domain=ros_domain(options.domain),
    )

    def tell(side: str, transition: Transition[ArmState]) -> None:
        _log.info("%s arm: %s", side, transition)

    with told_from_a_thread(_teller(console)), Emulator.open(emulated, config, tell) as emulator:
        left = emulated.remote_left
        if options.json:
            ready = {"backend": EMULATOR, "remote": emulated.remote, "remote_left": left}
            print(json.dumps(ready), flush=True)
        console.print(
            f"[bold]emulated controller[/] ({options.task}) sends to {emulated.remote}"
            f"{'' if left is None else f' and {left}'}: RobotWare {emulated.robotware}, "
            f"{1.0 / emulated.period_s:.1f} Hz, lag {emulated.lag_ms:g} ms. Ctrl-C ends it.",
            highlight=False,
        )
        emulator.run(stop)
    with suppress(OSError):  # The terminal may be gone.
        console.print("emulated controller ended", highlight=False)
    return 0


def _teller(console: Console) -> Callable[[str], None]:
    def tell(line: str) -> None:
        with suppress(OSError):  # The terminal may be gone; the robot goes on.
            console.print(line, highlight=False, markup=False)

    return tell


def _wait_for_end_of_input(stop: threading.Event) -> None:
    # Not through sys.stdin: a thread that waits in its buffer cannot be left at exit.
    while os.read(sys.stdin.fileno(), 4096):
        pass
    stop.set()
