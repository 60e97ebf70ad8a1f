"""The bridge on the robot server's seam, with a controller written by hand: for tests.

Everything but the wires to the session: packets come in, chunks are accepted, references go out.
"""

from __future__ import annotations

import numpy as np
from egm_controller import HandController
from egm_wire import Reference

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends.egm.backend import EgmBackend
from skewmi.deploy.robot.backends.egm.leading import LeadingReferences
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.gripper.fixed import FixedGripper
from skewmi.deploy.robot.requests import RobotRequests
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.checks import limit_check
from skewmi.deploy.safety.validation import ChunkValidator, ValidationRules
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.robot_models import limits as joint_limits
from skewmi.trajectory import GRID_NS, TrajectoryChunk

LAB = joint_limits.profile("lab")
OURS = b"a" * 16
CHAIN = np.array([0.0, -130.0, -135.0, 30.0, 0.0, 40.0, 0.0])
RAMP_CYCLES = 30


class Bench:
    """A bridge and its controller, cycle by cycle; time goes on with the controller's packets."""

    def __init__(
        self, options: EgmOptions | None = None, leading: LeadingReferences | None = None
    ) -> None:
        self.options = options or EgmOptions(listen="127.0.0.1:0", listen_left="none")
        self.backend = EgmBackend(self.options, FixedGripper(0.014), leading=leading)
        rules = ValidationRules(joint_names=self.backend.joint_names, grid_ns=GRID_NS)
        speed = self.backend.admitted_speed
        limits = LAB.no_faster(self.backend.joint_speed)
        validator = ChunkValidator(rules, limit_check(limits, None, speed))
        self.robot = RobotController(self.backend, validator)
        self.requests = RobotRequests(self.backend, self.robot)
        self.backend.open(lambda: True)
        assert self.backend.right is not None
        self.link = self.backend.right.link
        self.now_ns = 1_000_000_000
        self.link.now_ns = lambda: self.now_ns
        # Or what a packet waits in its socket while a busy computer does something else would come
        # into a time that is not the computer's.
        self.link._stamped = False
        self.controller = HandController(self.link.address)
        self.sequence = 0

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.controller.socket.close()
        self.backend.close()

    def pass_time(self, seconds: float) -> None:
        self.now_ns += int(1e9 * seconds)

    def cycle(self, **changes: object) -> list[Reference]:
        """The controller sends a packet; what it is answered."""
        self.pass_time(0.004032)
        self.controller.send(**changes)
        return self.serve()

    def serve(self) -> list[Reference]:
        """The server's part of one cycle."""
        state = self.backend.read()
        if state is None:
            self.robot.no_cycle(self.now_ns)
        else:
            self.robot.cycle(state, self.now_ns)
        return self.controller.collect()

    def run(self, cycles: int, *, follow: bool = True, **changes: object) -> list[Reference]:
        """So many cycles, in which the arm goes where it was told to, if it may."""
        answers = []
        for _ in range(cycles):
            got = self.cycle(**changes)
            answers += got
            if got and follow:
                self.controller.packet.axes = tuple(got[-1].axes)
                self.controller.packet.axis_7 = tuple(got[-1].axis_7)
        return answers

    def ready(self) -> Bench:
        self.run(RAMP_CYCLES)
        assert self.backend.readiness() is None
        return self

    def armed(self) -> Bench:
        self.ready()
        self.requests.arm(OURS, self.now_ns)
        return self

    def moving(self, size: float = 0.03) -> np.ndarray:
        """Armed and with a motion under way; returns its samples, rad."""
        self.armed()
        start = np.array(self.robot.arm_motion.commanded_position())
        motion = self.motion(start, start + size * np.array([1, -0.5, 0, 0.5, 0, 1, 0]))
        self.send_chunk(motion.trajectory)
        self.run(15)
        assert self.robot.state is ServerState.EXECUTING
        return np.asarray(motion.trajectory.q)

    def motion(self, start: np.ndarray, goal: np.ndarray) -> StartMotion:
        """From rest to rest, no faster than the bridge admits."""
        limits = LAB.no_faster(self.backend.joint_speed)
        return StartMotion(start, goal, limits, flange_speed=min(self.backend.admitted_speed, 0.25))

    def send_chunk(self, trajectory: object) -> None:
        self.sequence += 1
        stamp_ns = (self.robot.clock_ns // GRID_NS + 3) * GRID_NS
        chunk = TrajectoryChunk.of(stamp_ns, self.backend.joint_names, trajectory)  # type: ignore[arg-type]
        accepted = self.robot.receive(encode_chunk(chunk), OURS, self.sequence, self.now_ns)
        assert accepted, self.robot.refusals.take()


def in_degrees(answers: list[Reference]) -> np.ndarray:
    """Angles of answers along the chain. Shape (n, 7)."""
    return np.array([answer.chain() for answer in answers])
