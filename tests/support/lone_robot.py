"""A robot without wires: backend, controller and requests, moved on cycle by cycle."""

from __future__ import annotations

from typing import Any

import numpy as np

from skewmi.deploy.robot.backend import BackendFaultError, RobotBackend
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.refusals import Refusal
from skewmi.deploy.robot.requests import RobotRequests
from skewmi.deploy.safety.checks import limit_check
from skewmi.deploy.safety.validation import ChunkValidator, ValidationRules
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.policy_io import Array
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_NS, JointPoint, JointTrajectory, TrajectoryChunk


class LoneRobot:
    """What `RobotServer` does with a robot, in steps; it has seen the first cycle.

    Args:
        backend: In lock-step or not opened: it must not sleep.
        limits: To enforce.
        controller_options: Of `RobotController`.
    """

    def __init__(
        self, backend: RobotBackend, limits: JointLimits, **controller_options: Any
    ) -> None:
        self.backend = backend
        workspace = None if backend.scene is None else backend.scene.workspace
        rules = ValidationRules(joint_names=backend.joint_names, grid_ns=GRID_NS)
        validator = ChunkValidator(rules, limit_check(limits, workspace))
        self.controller = RobotController(backend, validator, **controller_options)
        self.requests = RobotRequests(backend, self.controller)
        self.targets: list[JointPoint] = []
        """Everything that was written since the first cycle."""
        follow = backend.write

        def write(command: JointPoint) -> None:
            self.targets.append(JointPoint(*(part.copy() for part in command)))
            follow(command)

        backend.write = write  # type: ignore[method-assign]
        backend.open(lambda: True)
        self.run(1)
        self.targets.clear()

    def run(self, cycles: int, now_ns: int = 0) -> None:
        for _ in range(cycles):
            try:
                state = self.backend.read()
            except BackendFaultError as fault:
                self.controller.fault(str(fault))
                continue
            assert state is not None
            self.controller.cycle(state, now_ns)
            self.requests.move_fingers()

    @property
    def measured(self) -> Array:
        """The newest state's positions, rad, and of the finger, m. Shape (8,)."""
        state = self.controller.arm_motion.state
        assert state is not None
        return state.position

    @property
    def due(self) -> int:
        """Grid steps of the clock until the sample that is due next."""
        return self.controller.clock_ns // GRID_NS

    @property
    def commanded(self) -> Array:
        """Where the plan ends, rad. Shape (7,)."""
        return np.array(self.controller.arm_motion.commanded_position())

    def planned(self, steps: int) -> Array:
        """What is commanded in the next grid steps, rad. Shape (steps, 7)."""
        plan, clock_ns = self.controller.arm_motion.plan, self.controller.clock_ns
        return np.array([plan.at(clock_ns + k * GRID_NS).q for k in range(steps)])

    def payload(self, motion: JointTrajectory, tick: int) -> bytes:
        """A chunk that is due so many grid steps after the clock's zero."""
        names = self.backend.joint_names
        return encode_chunk(TrajectoryChunk.of(tick * GRID_NS, names, motion))

    def refusals(self) -> list[Refusal]:
        """What has been refused since the last call."""
        return self.controller.refusals.take()
