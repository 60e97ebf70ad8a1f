"""Whatever is sent in a workspace, the hand that is in it stays in it, its fingers up, and slow.

Random and hostile commanders: motion towards, along and through the sides of the box and down to
the scene, chunks laid over one another at any sample, pushed by what splices tolerate, stops, other
workspaces, silence.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
import ruckig
from lone_motions import LAB, OURS, assert_within_limits
from lone_robot import LoneRobot

from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.deploy.robot.controller import LEASE_NS
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.checks import space_checks
from skewmi.deploy.safety.flange_space import (
    CALIBRATION,
    FINGER_TIP,
    TASK,
    TOUCH,
    FlangeSpace,
    flange_spaces,
    lowest_of_hand,
)
from skewmi.deploy.safety.limits import WORKSPACE_TOLERANCE
from skewmi.deploy.safety.validation import ChunkValidator
from skewmi.deploy.wire.arm_request import ArmRequest
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.robot_models.frames import HAND_DOWN, rotation_about
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.obstacle import Obstacle
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import GRID_S, JointTrajectory

WORKSPACE = make_layout().workspace
assert WORKSPACE is not None
BOX = Obstacle((0.391, -0.0735, 0.06), (0.109, 0.0765, 0.06))
"""Around the task's box with its lid and handle."""
SPACES = flange_spaces(WORKSPACE, (BOX,))
ARM = ArmKinematics("right")
START = np.array(yumi.TABLE_CONFIGURATION)
ROOM = WORKSPACE_TOLERANCE + 1e-6


def excess(space: FlangeSpace, position: Array) -> Array:
    """How far flanges are outside, m; negative inside. Shape (n, 3) -> (n,)."""
    worst: Array = np.maximum(space.low - position, position - space.high).max(axis=1)
    return worst


def toward(present: tuple[Array, Array, Array], goal: Array, slow: float) -> JointTrajectory:
    """The fastest motion from a state to rest, at a part of the speed limits, as far towards a goal
    as one chunk goes."""
    request = ruckig.InputParameter(7)
    request.synchronization = ruckig.Synchronization.No
    request.current_position, request.current_velocity, request.current_acceleration = (
        part.tolist() for part in present
    )
    request.max_velocity = np.maximum(slow * LAB.velocity, np.abs(present[1]) * 1.01).tolist()
    request.max_acceleration = (0.9 * LAB.acceleration).tolist()
    request.max_jerk = (0.9 * LAB.jerk).tolist()
    for part in (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.0):
        target = present[0] + part * (goal - present[0])
        request.target_position = target.tolist()
        trajectory = ruckig.Trajectory(7)
        ruckig.Ruckig(7).calculate(request, trajectory)
        count = int(np.ceil(trajectory.duration / GRID_S)) + 2
        if count <= 500:
            break
    rows = np.array([trajectory.at_time(k * GRID_S)[:3] for k in range(count)])
    rows[0] = present
    rows[-1] = target, np.zeros(7), np.zeros(7)
    return JointTrajectory(rows[:, 0], rows[:, 1], rows[:, 2])


@dataclass
class Commander:
    """Sends whatever may take the hand out."""

    robot: LoneRobot
    rng: np.random.Generator
    sequence: int = 0
    accepted: dict[str, int] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    where: list[str] = field(default_factory=list)
    """Workspace that held in each cycle; what ends an arm's lease does not end its motion."""

    def arm(self) -> None:
        name = str(self.rng.choice([CALIBRATION, CALIBRATION, TOUCH]))
        self.robot.requests.arm(ArmRequest(OURS, workspace=name).encode(), 0)

    def goal(self) -> Array:
        """Near a side of the space, low over the scene, or anywhere, the hand tilted."""
        space = SPACES[CALIBRATION]
        low, high = np.array(space.low), np.array(space.high)
        here = ARM.forward(self.robot.commanded)[0]
        at = self.rng.uniform(low, high)
        kind = self.rng.integers(6)
        if kind < 3:
            # Through the side that is nearest, straight or askew.
            to_low, to_high = here - low, high - here
            axis = int(np.minimum(to_low, to_high).argmin())
            at = here + self.rng.normal(0.0, 0.01 * kind, 3)
            beyond = self.rng.uniform(-0.01, 0.05)
            at[axis] = low[axis] - beyond if to_low[axis] < to_high[axis] else high[axis] + beyond
        elif kind == 3:
            at[2] = space.fingers_above + FINGER_TIP + self.rng.uniform(-0.03, 0.01)
        elif kind == 4:
            at = here + self.rng.normal(0.0, 0.02, 3)
        turned = HAND_DOWN @ rotation_about(int(self.rng.integers(3)), self.rng.normal(0.0, 0.4))
        near = self.robot.commanded[None]
        found: Array = ARM.inverse(at[None], turned, near, max_iterations=30).q[0]
        return found

    def send(self) -> None:
        robot, controller = self.robot, self.robot.controller
        due = robot.due + int(self.rng.integers(0, 40))
        present = controller.arm_motion.plan.at(due * 4_000_000)
        speed = 0.004 if controller.lease.workspace == TOUCH else self.rng.choice([0.05, 0.2])
        motion = toward(present, self.goal(), float(speed))
        # As far as splices are tolerated, each time: they must not add up.
        push = self.rng.choice([0.0, 0.99e-9]) * self.rng.choice([-1.0, 1.0], 7)
        motion = JointTrajectory(motion.q + push, motion.v, motion.a)
        self.sequence += 1
        held = controller.lease.workspace
        good = controller.receive(robot.payload(motion, due), OURS, self.sequence, 0)
        counts = self.accepted if good else self.refused
        counts[held] = counts.get(held, 0) + 1

    def run(self, cycles: int, now_ns: int = 0) -> None:
        for _ in range(cycles):
            held = self.robot.controller.lease.workspace
            self.robot.run(1, now_ns)
            lost = self.robot.controller.state in (ServerState.STOPPING, ServerState.DISARMED)
            self.where.append(self.where[-1] if lost and self.where else held)

    def end(self) -> None:
        """Stop, give back, go silent, or be followed by somebody else who may not come in."""
        match int(self.rng.integers(3)):
            case 0:
                self.robot.requests.stop("a test")
            case 1 if self.robot.controller.lease.holder == OURS:
                self.robot.requests.disarm(OURS)
            case _:
                self.run(1, now_ns=LEASE_NS + 1)
        self.run(600)
        assert self.robot.controller.state is ServerState.DISARMED
        assert self.robot.controller.at_rest
        assert self.robot.controller.lease.workspace == TASK


def make_robot() -> LoneRobot:
    """One that follows at once, before the task's scene, at the task's start."""
    robot = LoneRobot(HoldBackend(START, lock_step=True), LAB)
    validator = robot.controller._validator
    others = space_checks(LAB, SPACES)
    robot.controller._validator = ChunkValidator(validator.rules, validator._checks[TASK], others)
    return robot


def judge(robot: LoneRobot, where: list[str]) -> None:
    """No executed motion leaves what it was in."""
    q = np.array([target.q for target in robot.targets])
    assert_within_limits(q)
    position, rotation = ARM.forward(q)
    lowest = lowest_of_hand(position, rotation)
    tips = position + FINGER_TIP * rotation[..., 2]
    names = np.array(where)
    for name, space in SPACES.items():
        here = names == name
        outside = excess(space, position)
        assert outside[here].max(initial=-1.0) <= ROOM, "it began inside"
        if space.fingers_above:
            # Between two leases a hand may be lower: the other workspace lets it down.
            begins = np.flatnonzero(here & ~np.roll(here, 1))
            for begin in begins:
                end = begin + int(np.argmin(np.append(here[begin:], False)))
                floor = space.fingers_above - ROOM
                up = np.logical_or.accumulate(lowest[begin:end] >= floor + 2e-6)
                assert lowest[begin:end][up].min(initial=1.0) >= floor - 1e-6
        if space.speed < 0.25:
            both = here[1:] & here[:-1]
            for point in (position, tips):
                speed = np.linalg.norm(np.diff(point, axis=0), axis=1)[both] / GRID_S
                assert speed.max(initial=0.0) <= space.speed * (1 + 1e-6)


def play(seeds: range) -> tuple[dict[str, int], dict[str, int]]:
    """Accepted and refused chunks of a commander for each seed, by workspace; all is judged."""
    accepted: dict[str, int] = {}
    refused: dict[str, int] = {}
    for seed in seeds:
        commander = Commander(make_robot(), np.random.default_rng([seed, 3]))
        for _ in range(3):
            commander.arm()
            for _ in range(25):
                commander.send()
                commander.run(int(commander.rng.integers(1, 60)))
            commander.end()
        judge(commander.robot, commander.where)
        for total, counts in ((accepted, commander.accepted), (refused, commander.refused)):
            for name, count in counts.items():
                total[name] = total.get(name, 0) + count
    return accepted, refused


def test_no_sequence_of_chunks_leaves_a_workspace() -> None:
    accepted, refused = play(range(3))
    assert min(accepted[CALIBRATION], refused[CALIBRATION], accepted[TOUCH]) > 20
    assert refused[TOUCH] > 0


@pytest.mark.slow
def test_none_of_very_many_leaves_a_workspace() -> None:
    accepted, _ = play(range(100, 160))
    assert min(accepted[CALIBRATION], accepted[TOUCH]) > 500
