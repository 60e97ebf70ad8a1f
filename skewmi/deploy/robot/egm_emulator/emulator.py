"""The emulated controller as a program: arms, scene and links, run in real time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.robot.backends.egm.link import parse_address
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.egm_emulator.controller import EmulatedController
from skewmi.deploy.robot.egm_emulator.controller_states import ArmState
from skewmi.deploy.robot.egm_emulator.emulated_arm import ArmOptions, EmulatedArm
from skewmi.deploy.robot.egm_emulator.pace import RealTimePace
from skewmi.deploy.robot.egm_emulator.plant import ScenePlant
from skewmi.deploy.robot.egm_emulator.scene_link import SceneLink
from skewmi.deploy.robot.egm_emulator.wires import NetworkOptions, Wires
from skewmi.deploy.state_machine import Transition
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.errors import ConfigurationError
from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import Side
from skewmi.trajectory import Array

REAL_RATE_HZ = 1000.0 / 4.032
"""Of a real controller."""


OnTransition = Callable[[Side, Transition[ArmState]], None]


@dataclass(frozen=True)
class EmulatorOptions:
    """What an emulated controller is started with.

    Raises:
        ConfigurationError: A value makes no sense.
    """

    remote: str = "127.0.0.1:6512"
    """HOST:PORT that the right arm's packets are sent to."""
    remote_left: str | None = None
    """The same for the left arm; None for a controller of one arm."""
    rate_hz: float = REAL_RATE_HZ
    """Cycles a second."""
    lag_ms: float = 20.0
    """From the desired position to the servos."""
    robotware: int = 6
    """6 or 7."""
    program: ProgramSettings = field(default_factory=ProgramSettings)
    """Of both arms."""
    network: NetworkOptions = field(default_factory=NetworkOptions)
    """What happens to datagrams."""
    task: str | None = None
    """Whose scene stands before the robot; None for the registry's default."""
    variation: str | None = None
    """How robot and scene differ from the nominal ones."""

    def __post_init__(self) -> None:
        if not 10.0 <= self.rate_hz <= 1000.0:
            raise ConfigurationError(f"EGM rate is {self.rate_hz:g} Hz; it must be in 10..1000")
        if not 0.0 <= self.lag_ms <= 200.0:
            raise ConfigurationError(f"EGM lag is {self.lag_ms:g} ms; it must be in 0..200")
        if self.robotware not in (6, 7):
            raise ConfigurationError(f"RobotWare {self.robotware}; there are 6 and 7")

    @property
    def period_s(self) -> float:
        """Of a cycle: 4.032 ms is what 248 Hz mean."""
        near = abs(self.rate_hz - REAL_RATE_HZ) < 0.05
        return 0.004032 if near else 1.0 / self.rate_hz


class Emulator:
    """A controller with its scene; `open` makes one, and as a context manager it closes itself.

    Args:
        options: How it is.
        simulation: Of the right arm and the scene.
        controller: With that behind it.
    """

    def __init__(
        self, options: EmulatorOptions, simulation: ArmSimulation, controller: EmulatedController
    ) -> None:
        self.options = options
        self.simulation = simulation
        self.controller = controller
        self.pace = RealTimePace(round(1e9 * options.period_s))
        self.scene: SceneLink | None = None

    @staticmethod
    def open(
        options: EmulatorOptions,
        config: TransportConfig | None = None,
        on_transition: OnTransition | None = None,
    ) -> Emulator:
        """Open the controller's sockets, and begin to look for a robot server.

        Args:
            options: How it is.
            config: Where a robot server listens for scene states; None for a controller alone.
            on_transition: Called after every change of an arm's state.

        Raises:
            NotFoundError: No such task or variation.
            ConfigurationError: An address or the variation makes no sense.
            TransportError: No socket can be opened.
        """
        remotes: dict[Side, tuple[str, int]] = {"right": parse_address(options.remote)}
        if options.remote_left is not None:
            remotes["left"] = parse_address(options.remote_left)
        simulation = ArmSimulation(options.task, None, options.variation)
        start = simulation.robot_state(0).position[:7]
        arms = {
            side: _arm(options, side, start if side == "right" else _HOME, on_transition)
            for side in remotes
        }
        wires = {
            side: Wires.open(remote, replace(options.network, seed=options.network.seed + index))
            for index, (side, remote) in enumerate(remotes.items())
        }
        plant = ScenePlant(simulation, options.period_s)
        emulator = Emulator(options, simulation, EmulatedController(arms, wires, plant))
        if config is not None:
            emulator.scene = SceneLink.open(
                config, simulation.scene_state, simulation.contact.summary, emulator.reset
            )
        return emulator

    def __enter__(self) -> Emulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(self, stop: threading.Event) -> list[str]:
        """Start the programs and run until `stop` is set. Returns what the loop was granted."""
        self.controller.start()
        with hot_loop(priority=True) as granted:
            self.pace.run(self, lambda: not stop.is_set())
        return granted

    def cycle(self, now_ns: int) -> None:
        """One cycle of the controller, then the scene's turn."""
        self.controller.cycle(now_ns)
        if self.scene is not None:
            self.scene.serve()

    def carry(self, now_ns: int) -> None:
        """Datagrams that are due between two cycles."""
        self.controller.carry(now_ns)

    @property
    def next_due_ns(self) -> int | None:
        """When `carry` has something to do."""
        return self.controller.next_due_ns

    def reset(self, seed: int) -> Array:
        """Scene and right arm as the task begins; its program is started again from main."""
        q = self.simulation.reset(seed)
        arm = self.controller.arms["right"]
        arm.restart_controller(q)
        arm.start()
        return q

    def close(self) -> None:
        """Close sockets and link."""
        if self.scene is not None:
            self.scene.close()
        self.controller.close()


def _arm(
    options: EmulatorOptions, side: Side, q: Array, on_transition: OnTransition | None
) -> EmulatedArm:
    arm_options = ArmOptions(
        side, options.program, options.period_s, options.lag_ms / 1e3, options.robotware
    )
    if on_transition is None:
        return EmulatedArm(arm_options, q)
    return EmulatedArm(arm_options, q, lambda transition: on_transition(side, transition))


_HOME: Array = np.array(yumi.HOME["left"])
