"""Touches that are late never go on blindly: each attempt begins where the way ahead is free."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from robot_servers import LAB
from virtual_robot import VirtualRobot

from skewmi.calibration.contact_watch import FREE_WAY, ContactWatch, tip_jacobian
from skewmi.calibration.finger_contact import TIP
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_prediction import ServoPrediction
from skewmi.deploy.motion.hand_line import hand_line
from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.session.guarded_motion import SETTLING_NS, GuardedMotion, Watch
from skewmi.deploy.session.path_follower import ATTEMPTS
from skewmi.deploy.session.touch_run import AT_START, TouchRun
from skewmi.errors import CommandRefusedError, LimitViolationError
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import CYCLE_NS, GRID_NS, Array, JointTrajectory

ARM = ArmKinematics("right")
MODEL = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
Q = np.array(yumi.TABLE_CONFIGURATION)
FLANGE = ARM.forward(Q)[0]
WAY = np.array([1.0, 0.0, 0.0])
CREEP = hand_line(ARM, Q, FLANGE, FLANGE + 0.046 * WAY)
WALL = 0.020
"""How far the finger tips are from it at the start of the path, m."""
STIFFNESS = 20e3
"""Of the wall, N/m."""
GENTLE = 3.0
"""N; without lateness the wall is pressed with 1.6 N."""
FORCE_LIMIT = 10.0
LEAD_NS = 24_000_000


def tip_way(q: Array) -> float:
    """How far the finger tips are on their way, m."""
    (position, rotation), (start, down) = ARM.forward(q), ARM.forward(Q)
    return float(WAY @ (position + TIP * rotation[:, 2] - start - TIP * down[:, 2]))


class WalledRobot(VirtualRobot):
    """A robot server in virtual time whose arm is soft, and has a wall before it.

    Attributes:
        delays: What holds the session up, one in each attempt: where the command is then, past the
            wall, m, and whether it comes before a chunk is planned, or while one is on its way.
        presses: On the wall, of every 4 ms, N.
    """

    def __init__(self) -> None:
        super().__init__(Q, LEAD_NS)
        self.delays: list[tuple[float, bool]] = []
        self.presses: list[float] = [0.0]
        self._at_start = False
        self._arm = ServoPrediction(DelayedServo(CONTACT_SERVO, 0.0), MODEL)
        self._arm.begin(Q, Q)
        self._real, self._stepped_ns = Q, self.now_ns // CYCLE_NS * CYCLE_NS
        self._noise = np.random.default_rng(0)

    def put(self, payload: bytes) -> None:
        if self._is_held_up(on_its_way=True):
            self.now_ns += 2 * LEAD_NS
        super().put(payload)

    def check(self, *, late_is_final: bool) -> None:
        super().check(late_is_final=late_is_final)
        if self._is_held_up(on_its_way=False):
            self.now_ns += 2 * LEAD_NS

    def _is_held_up(self, *, on_its_way: bool) -> bool:
        way = tip_way(self._commanded(self._seen_ns).q[0])
        self._at_start = self._at_start or way < 1e-5
        if not self._at_start or not self.delays or self.delays[0][1] is not on_its_way:
            return False
        if way - WALL < self.delays[0][0]:
            return False
        self.delays.pop(0)
        self._at_start = False
        return True

    def _commanded(self, stamp_ns: int) -> JointTrajectory:
        """What is followed at a time, one sample."""
        for chunk in reversed(self.chunks):
            if chunk.stamp_ns <= stamp_ns:
                point = chunk.trajectory.at(stamp_ns - chunk.stamp_ns)
                return JointTrajectory(point.q[None], point.v[None], point.a[None])
        return JointTrajectory.resting(Q, 1)

    def _measured(self, stamp_ns: int) -> Array:
        while self._stepped_ns < stamp_ns:
            self._stepped_ns += GRID_NS
            press = max(STIFFNESS * (tip_way(self._real) - WALL), 0.0)
            self.presses.append(press)
            force = -(WAY @ tip_jacobian(ARM, self._real)) * press
            self._arm._data.qfrc_applied[self._arm._arm.dofs] = force
            self._real = self._arm.step(self._commanded(self._stepped_ns))
        return self._real + 1e-5 * self._noise.normal(size=7)


class Told:
    """A watch that tells, in each attempt, what a test wants at a place of the command's way.

    Args:
        forces: Largest one of each attempt, N.
        touches: Whether the attempt after them meets something.
    """

    def __init__(self, *forces: float, touches: bool = True) -> None:
        self._forces, self._touches = list(forces), touches
        self.begun: list[Array] = []

    def begin(self, q: Array, commanded: Array, direction: Array) -> None:
        del q, direction
        self.begun.append(commanded)
        self.touched, self.force = False, 0.0

    def look(self, commands: JointTrajectory, q: Array) -> None:
        del q
        if tip_way(commands.q[-1]) < FREE_WAY:
            return
        attempt = len(self.begun) - 1
        self.touched = self._touches and attempt >= len(self._forces) - 1
        self.force = self._forces[min(attempt, len(self._forces) - 1)]


class Noted(ContactWatch):
    """A real watch, and from where it was begun."""

    def __init__(self) -> None:
        super().__init__(ServoPrediction(DelayedServo(CONTACT_SERVO, 0.0), MODEL))
        self.begun: list[Array] = []

    def begin(self, q: Array, commanded: Array, direction: Array) -> None:
        self.begun.append(commanded)
        super().begin(q, commanded, direction)


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> WalledRobot:
    made = WalledRobot()
    made.keeps_time(monkeypatch)
    return made


def touch_run(robot: VirtualRobot, watch: Watch, told: list[str] | None = None) -> TouchRun:
    parts: Any = robot
    checks: Any = SimpleNamespace(speeds={"touch": 0.010}, now="touch")
    settings: Any = SimpleNamespace(limits=LAB, tool_z=TIP, force_limit=FORCE_LIMIT)
    run = TouchRun(
        *(parts, parts, robot.stream, robot.loop, checks, settings, watch),
        *(robot.status, robot.stop),  # type: ignore[arg-type]
        lock_step=False,
        tell=(told if told is not None else []).append,
    )
    run._way.q = Q
    return run


def creep(run: TouchRun, robot: VirtualRobot, path: JointPath = CREEP) -> GuardedMotion:
    return run._guarded(path, WAY, 0.005, robot.next_state())[1]


@pytest.mark.parametrize("on_its_way", [False, True])
@pytest.mark.parametrize(
    "places",
    [
        pytest.param([], id="never"),
        pytest.param([-WALL + 0.5 * FREE_WAY], id="where the watch learns"),
        pytest.param([-0.003], id="before contact"),
        pytest.param([0.0], id="at contact"),
        pytest.param([0.0004], id="in contact, not noticed"),
        pytest.param([0.0004, -0.002, 0.0004, 0.0, 0.0002], id="again and again"),
    ],
)
def test_a_late_finger_presses_gently_and_meets_the_wall_where_it_is(
    robot: WalledRobot, places: list[float], on_its_way: bool
) -> None:
    robot.delays = [(place, on_its_way) for place in places]
    watch = Noted()
    run = touch_run(robot, watch)
    met = creep(run, robot)
    assert not robot.delays, "each was in the way"
    assert met.touched
    assert max(robot.presses) < GENTLE
    # What it is told is an upper estimate, of all attempts.
    assert max(robot.presses) - 0.5 < met.peak_force == run.largest_force < FORCE_LIMIT
    measured = np.mean([state.q for state in met.held], axis=0)
    assert abs(tip_way(measured) - WALL) < 2e-4
    assert len(watch.begun) >= 1
    for begun in watch.begun:
        np.testing.assert_allclose(begun, CREEP.at(0.0), atol=AT_START)


def test_contact_that_is_noticed_while_the_arm_stops_is_a_touch(robot: WalledRobot) -> None:
    robot.delays = [(0.0007, False)]
    watch = Noted()
    met = creep(touch_run(robot, watch), robot)
    assert met.late
    assert met.touched
    assert len(watch.begun) == 1, "nothing has to be done again"
    assert len(met.held) >= 10
    assert max(robot.presses) < GENTLE


def test_lateness_after_the_touch_changes_nothing(robot: WalledRobot) -> None:
    delays = [(0.0, False)]

    class Delaying(Noted):
        def look(self, commands: JointTrajectory, q: Array) -> None:
            super().look(commands, q)
            if self.touched and delays:
                robot.delays.append(delays.pop())

    watch = Delaying()
    met = creep(touch_run(robot, watch), robot)
    assert not delays
    assert not robot.delays
    assert met.touched
    assert not met.late
    assert len(watch.begun) == 1


def test_the_way_back_is_slow_and_rests_before_the_next_attempt(robot: WalledRobot) -> None:
    robot.delays = [(-0.003, False)]
    told: list[str] = []
    creep(touch_run(robot, Noted(), told), robot)
    assert len(told) == 1
    assert "too late" in told[0]
    ticks = range(robot.chunks[0].stamp_ns, robot.chunks[-1].stamp_ns, GRID_NS)
    way = np.array([tip_way(robot._commanded(tick).q[0]) for tick in ticks])
    speed = np.diff(way) / (GRID_NS / 1e9)
    assert speed.min() < -0.005
    assert np.abs(speed).max() < 0.010, "as fast as the workspace admits"
    turned = int(np.argmax(way > 0.016))
    back = turned + int(np.argmax(np.abs(way[turned:]) < 1e-6))
    again = back + int(np.argmax(way[back:] > 1e-6))
    assert (again - back) * GRID_NS >= SETTLING_NS


@pytest.mark.parametrize("on_its_way", [False, True])
def test_the_peak_force_is_that_of_all_attempts(robot: WalledRobot, on_its_way: bool) -> None:
    robot.delays = [(-0.008, on_its_way), (-0.008, on_its_way)]
    run = touch_run(robot, Told(7.0, 3.0, 2.0))
    assert creep(run, robot).peak_force == run.largest_force == 7.0
    robot.delays = [(-0.008, on_its_way)]
    # The next touch is not charged with it.
    run._watch = Told(4.0, 2.0)
    state = run._way.move(CREEP, CREEP.nearest(run._way.q), 0.0, robot.next_state())
    assert run._guarded(CREEP, WAY, 0.005, state)[1].peak_force == 4.0
    assert run.largest_force == 7.0


def test_too_much_force_in_a_late_stop_ends_it(robot: WalledRobot) -> None:
    """The last commands of a stop may be those that press too hard."""
    robot.delays = [(-0.008, False)]

    class Stopping(Told):
        def look(self, commands: JointTrajectory, q: Array) -> None:
            super().look(commands, q)
            if robot.stream.missed_cycles:
                self.force = FORCE_LIMIT + 1.0

    run = touch_run(robot, Stopping(1.0, touches=False))
    with pytest.raises(LimitViolationError, match="force of the finger tips"):
        creep(run, robot)
    assert run.largest_force == FORCE_LIMIT + 1.0


def test_an_arm_that_is_always_late_is_given_up_on(robot: WalledRobot) -> None:
    short = hand_line(ARM, Q, FLANGE, FLANGE + 0.002 * WAY)
    robot.delays = [(-WALL + 0.001, False)] * ATTEMPTS
    watch = Told(0.0, touches=False)
    with pytest.raises(CommandRefusedError, match=f"{ATTEMPTS} motions came too late"):
        creep(touch_run(robot, watch), robot, short)
    assert len(watch.begun) == ATTEMPTS
    for begun in watch.begun:
        np.testing.assert_allclose(begun, Q, atol=AT_START)
