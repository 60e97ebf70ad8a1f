"""The simulated YuMi as a robot: it sleeps until a step is due, or waits for its commander."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from math import inf

import numpy as np

from skewmi.deploy.robot.backend import BackendFaultError, LinkErrors, RobotBackend, RobotState
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.backends.mujoco.scene import MujocoScene
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.gripper.base import check_opening
from skewmi.deploy.robot.pace import Beat, Pace, make_pace
from skewmi.deploy.wire.simulation_status import SCENE_POSES
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.trajectory import GRID_NS, JointPoint

_log = logging.getLogger(__name__)


class MujocoBackend:
    """Arm and gripper of a simulation; satisfies `RobotBackend`, `LinkVaries`,
    `SendsAhead` and `TellsContact`.

    Args:
        simulation: Of a task; the nominal one of the registry's default task if not given.
        lock_step: Let time pass only when commands have arrived.
    """

    name = "sim"
    admitted_speed = inf
    joint_speed = inf
    period_ns = GRID_NS

    def __init__(self, simulation: ArmSimulation | None = None, *, lock_step: bool = False) -> None:
        self.simulation = ArmSimulation() if simulation is None else simulation
        self.scene = MujocoScene(self.simulation)
        self.joint_names = yumi.joint_names("right")
        self.state_names = (*self.joint_names, yumi.finger_names("right")[0])
        self.lock_step = lock_step
        self._time_ns = -GRID_NS
        self._pace: Pace | None = None
        self._fault: BackendFaultError | None = None

    @property
    def slips(self) -> int:
        """How often cycles were left out because the server came too late."""
        return 0 if self._pace is None else self._pace.slips

    def open(self, may_advance: Callable[[], bool]) -> None:
        """Begin."""
        if self.lock_step and self.simulation.link_errors is not None:
            _log.warning(
                "the variation's section 'link' has no effect in lock-step, where time waits for "
                "the link; leave out --lock-step to have it"
            )
        self._pace = make_pace(GRID_NS, may_advance, lock_step=self.lock_step)

    def readiness(self) -> str | None:
        """Nothing is ever missing."""
        return None

    def read(self) -> RobotState | None:
        """Wait for the next step, make it with the last command, and measure."""
        assert self._pace is not None, "open it first"
        beat = self._pace.wait()
        if beat is Beat.NONE:
            return None
        if beat is Beat.NEXT:
            self._time_ns += GRID_NS
            if self._time_ns > 0:
                self._step()
        return self.simulation.robot_state(self._time_ns)

    def _step(self) -> None:
        try:
            self.simulation.step()
        except BackendFaultError as fault:
            self._fault = fault

    def due(self) -> bool:
        """Whether the next cycle has come."""
        return self._pace is not None and self._pace.due()

    def write(self, command: JointPoint) -> None:
        """The servos' targets for the step that comes next.

        Raises:
            BackendFaultError: MuJoCo found a state that is not physical.
        """
        self.simulation.command = command
        fault, self._fault = self._fault, None
        if fault is not None:
            raise fault

    def rest_at(self, q: Array) -> None:
        """See `SendsAhead`."""
        self.simulation.rest_at(q)

    def activate(self) -> None:
        """The servos are always on."""

    def deactivate(self) -> None:
        """They stay on and hold."""

    def open_gripper(self, opening: float) -> None:
        """Move each finger to `opening` m from closed.

        Raises:
            CommandRefusedError: Not an opening of the fingers.
        """
        check_opening(opening)
        self.simulation.open_gripper(opening)

    def link_errors(self) -> LinkErrors | None:
        """What the variation says; nothing in lock-step, where time waits for the link."""
        return None if self.lock_step else self.simulation.link_errors

    def told(self) -> Mapping[str, str]:
        """Where the scene really stands: for pictures; sessions find out by themselves."""
        return {SCENE_POSES: self.scene.poses_json}

    def contact_forces(self) -> tuple[float, float]:
        """See `TellsContact`."""
        return self.simulation.contact.lately()

    def close(self) -> None:
        """Nothing is left."""


def make(options: BackendOptions) -> RobotBackend:
    """See `backends.make_backend`."""
    if options.delay_s is not None:
        raise ConfigurationError(
            "a delay (--delay-ms) is for the robot 'hold'; the simulated robot's is its servos': "
            "give --variation instead"
        )
    start = options.start_configuration
    configuration = None if start is None else np.array(start)
    simulation = ArmSimulation(
        options.task, configuration, options.variation, options.feed_forward, options.box
    )
    return MujocoBackend(simulation, lock_step=options.lock_step)
