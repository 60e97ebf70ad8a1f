"""No sequence of chunks and stops breaks a limit: by linear programming, and on the robot server.

The program (`splice_program`) knows the rules, and not the code; the robot server knows the code.
What the program finds to break a limit once a rule is left out, the server must not execute; what
it finds with all rules, the server must accept.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from lone_robot import LoneRobot
from splice_program import BEFORE, Motion, Rules, Worst
from splice_sequences import (
    ONCE,
    over_ends,
    sequences,
    stop,
    stop_and_go_on,
    stops,
    stops_and_chunks,
    three_chunks,
    two_chunks,
)

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.deploy.robot.states import ServerState
from skewmi.errors import CommandRefusedError
from skewmi.policy_io import Array
from skewmi.robot_models import limits, yumi
from skewmi.trajectory import GRID_S, JointTrajectory

LAB = limits.profile("lab")
START = np.array(yumi.HOME["right"])
JOINT = 5
UNITS = LAB.jerk[JOINT] * GRID_S ** np.array([3.0, 2.0, 1.0])
"""Of q, v, a in the program."""
JUST_BELOW = 1 - 1e-4
OURS = b"a" * 16
ROUNDING = 1e-6


def worst(motions: Iterable[Motion]) -> Worst:
    """The largest jerk of any of them."""
    found = [motion.worst(over_ends(motion), (3,)) for motion in motions]
    return max(found, key=lambda one: one.share)


@pytest.mark.parametrize("points", range(1, 13))
def test_no_chunk_breaks_a_limit_with_others(points: int) -> None:
    motions = list(sequences(points))
    assert worst([motions[1], motions[-2]]).share == pytest.approx(1.0, abs=ROUNDING), (
        "the limit itself can be reached"
    )


@pytest.mark.slow
@pytest.mark.parametrize("points", range(1, 13))
def test_no_difference_of_any_order_breaks_a_limit(points: int) -> None:
    for motion in sequences(points):
        assert motion.worst().share <= 1.0 + ROUNDING


def test_no_stop_breaks_a_limit() -> None:
    assert worst(stops(first=10)).share == pytest.approx(1.0, abs=ROUNDING)
    few = [stop_and_go_on(tick, later, 3) for tick in (5, 10) for later in (0, 1)]
    assert worst(few).share == pytest.approx(1.0, abs=ROUNDING)


@pytest.mark.slow
def test_no_stop_of_a_longer_motion_breaks_a_limit() -> None:
    for motion in (*stops(), *stops_and_chunks()):
        assert motion.worst().share <= 1.0 + ROUNDING


@pytest.mark.parametrize(
    ("motion", "share"),
    [
        (two_chunks(12, 2, Rules(joined=False)), 3 / 2),
        (stop(10, Rules(rested=1)), 7 / 6),
        (stop_and_go_on(10, 0, 2, ONCE), 4 / 3),
    ],
)
def test_every_rule_is_needed(motion: Motion, share: float) -> None:
    assert worst([motion]).share == pytest.approx(share, abs=1e-6)


@pytest.fixture
def robot() -> LoneRobot:
    robot = LoneRobot(HoldBackend(START, lock_step=True), LAB)
    robot.requests.arm(OURS, 0)
    return robot


class Replay:
    """Sends a solution of the program to a robot server.

    Args:
        robot: Armed.
        motion: Of which it is one.
        solution: Values of its variables.
        scale: What they are multiplied with.
    """

    def __init__(
        self, robot: LoneRobot, motion: Motion, solution: Array, scale: float = JUST_BELOW
    ) -> None:
        self.robot = robot
        self._begin = robot.due
        self._chunks = []
        for number, (tick, points, _) in enumerate(motion.chunks):
            samples = np.zeros((3, points, len(START)))
            samples[:, :, JOINT] = scale * motion.samples(number, solution) * UNITS[:, None]
            samples[1:, -1] = 0.0
            samples[0] += START
            if number == 0:
                # Equal exactly, not to the solver's tolerance.
                for held in motion.held:
                    samples[0, held - motion.rules.rested : held] = samples[0, held]
                    samples[1:, held] = 0.0
            self._chunks.append((tick, JointTrajectory(*samples)))

    def send(self, number: int) -> bool:
        """Whether a chunk is accepted."""
        tick, samples = self._chunks[number]
        data = self.robot.payload(samples, self._begin + tick)
        return self.robot.controller.receive(data, OURS, number + 1, 0)

    def run_to(self, tick: int) -> None:
        """Until a tick is due."""
        self.robot.run(self._begin + tick - self.robot.due)


def armed_robot() -> LoneRobot:
    robot = LoneRobot(HoldBackend(START, lock_step=True), LAB)
    robot.requests.arm(OURS, 0)
    return robot


def executed_fraction(robot: LoneRobot, order: int = 3) -> float:
    """Largest velocity, acceleration or jerk of what was executed, from rest on."""
    q = np.array([START] * BEFORE + [target.q for target in robot.targets])
    bound = (LAB.velocity, LAB.acceleration, LAB.jerk)[order - 1]
    return float((np.abs(np.diff(q, n=order, axis=0)) / GRID_S**order / bound).max())


def assert_within_limits(robot: LoneRobot) -> None:
    for order in (1, 2, 3):
        assert executed_fraction(robot, order) <= 1.0 + ROUNDING


@pytest.mark.parametrize("in_time", [False, True])
@pytest.mark.parametrize("points", [2, 3, 7])
def test_the_worst_that_is_allowed_is_executed(points: int, in_time: bool) -> None:
    motion = two_chunks(12, points)
    robot = armed_robot()
    replay = Replay(robot, motion, worst([motion]).solution)
    assert replay.send(0)
    if in_time:
        replay.run_to(12)
    assert replay.send(1), robot.refusals()
    robot.run(40)
    assert_within_limits(robot)
    assert executed_fraction(robot) > 0.999, "the limit was not reached"


@pytest.mark.parametrize(
    ("scale", "accepted"), [(1.0, False), (1.0005 / 1.5, False), (0.9995 / 1.5, True)]
)
def test_two_points_may_not_reach_over_both_ends(scale: float, accepted: bool) -> None:
    motion = two_chunks(12, 2, Rules(joined=False))
    robot = armed_robot()
    replay = Replay(robot, motion, worst([motion]).solution, JUST_BELOW * scale)
    assert replay.send(0)
    assert replay.send(1) is accepted
    if not accepted:
        (refusal,) = robot.refusals()
        assert "position step of jerk over an end" in refusal.reason
        assert not refusal.out_of_step
    robot.run(40)
    assert_within_limits(robot)


@pytest.mark.parametrize("motion", [stop(10, Rules(rested=1)), stop_and_go_on(10, 0, 2, ONCE)])
def test_an_arm_that_stands_for_a_moment_does_not_rest(motion: Motion) -> None:
    """It follows the rest of its plan, and nobody can arm it meanwhile."""
    robot = armed_robot()
    replay = Replay(robot, motion, worst([motion]).solution)
    assert replay.send(0)
    replay.run_to(10)
    robot.requests.stop("test")
    assert robot.controller.state is ServerState.STOPPING
    with pytest.raises(CommandRefusedError, match="stopping"):
        robot.requests.arm(OURS, 0)
    robot.run(40)
    assert robot.controller.state is ServerState.DISARMED
    assert_within_limits(robot)


@pytest.mark.parametrize("later", [0, 1, 2])
def test_an_arm_that_rests_is_held_and_goes_on_from_there(later: int) -> None:
    motion = stop_and_go_on(10, 1 + later, 3)
    robot = armed_robot()
    replay = Replay(robot, motion, worst([motion]).solution)
    assert replay.send(0)
    replay.run_to(11)
    robot.requests.stop("test")
    assert robot.controller.state is ServerState.DISARMED
    robot.requests.arm(OURS, 0)
    assert replay.send(1), robot.refusals()
    robot.run(40)
    assert_within_limits(robot)
    assert executed_fraction(robot) > 0.999, "the limit was not reached"


@pytest.mark.parametrize("seed", range(4))
def test_whatever_is_allowed_is_accepted_and_may_be_stopped_at_any_sample(seed: int) -> None:
    """Random corners of all that three chunks may be; a stop, and at once somebody else's start."""
    rng = np.random.default_rng(seed)
    points = tuple(int(n) for n in rng.integers(2, 13, 2))
    second = int(rng.integers(1, points[0] + 2))
    motion = three_chunks((6, 6 + second), points)
    solution = motion.any_of(rng)
    for tick in range(1, 6 + second + points[1] + 3):
        robot = armed_robot()
        replay = Replay(robot, motion, solution)
        for number in range(3):
            assert replay.send(number), robot.refusals()
        replay.run_to(tick)
        robot.requests.stop("test")
        while robot.controller.state is not ServerState.DISARMED:
            robot.run(1)
        start_at_once(robot)
        robot.run(40)
        assert_within_limits(robot)


def start_at_once(robot: LoneRobot) -> None:
    """A motion with the whole jerk, as soon as it is let; three samples later it must be."""
    robot.requests.arm(OURS, 0)
    goal = robot.commanded + 0.01 * np.eye(len(START))[JOINT]
    motion = StartMotion(robot.commanded, goal, LAB).trajectory
    for _ in range(4):
        if robot.controller.receive(robot.payload(motion, robot.due), OURS, 9, 0):
            return
        robot.run(1)
    raise AssertionError(robot.refusals())
