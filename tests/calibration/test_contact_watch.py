"""A creeping finger that stands still is noticed, and one that creeps on never is."""

from __future__ import annotations

import numpy as np
import pytest
from calibrations import DrawnRobot, known_servo

from skewmi.calibration.contact_watch import FREE_WAY, ContactWatch, stiffest, tip_jacobian
from skewmi.calibration.finger_contact import TIP
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_prediction import ServoPrediction
from skewmi.calibration.servo_section import servo_start
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import CYCLE_TICKS, Array, JointTrajectory

SPEED = 0.005
NOISE = 1e-4
MODEL = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
ARM = ArmKinematics("right")


def creeping(rng: np.random.Generator) -> tuple[JointTrajectory, Array]:
    """A straight way of the finger of 40 mm at constant speed, and its direction."""
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    q = np.array(yumi.TABLE_CONFIGURATION)
    rows = [q]
    rate = []
    twist = np.concatenate((SPEED * direction, np.zeros(3)))
    for tick in range(round(0.040 / SPEED / 0.004)):
        if tick % 50 == 0:
            inverse = np.linalg.pinv(ARM.jacobian(rows[-1]))
        rate.append(inverse @ twist)
        rows.append(rows[-1] + 0.004 * rate[-1])
    v = np.array([np.zeros(7), *rate])
    return JointTrajectory(np.array(rows), v, np.zeros_like(v)), direction


def watched(rng: np.random.Generator, error: float) -> tuple[DelayedServo, ContactWatch]:
    """A robot of the documented ranges, and a watch that knows it as well as calibration does."""
    drawn = DrawnRobot.draw(rng)
    parameters = drawn.parameters(CONTACT_SERVO)
    friction = parameters.frictionloss * np.array([1.0] * 4 + [0.25] * 3)
    parameters = parameters.with_changes(frictionloss=friction)
    known = servo_start(known_servo(parameters, drawn.delay_ms, error, rng), CONTACT_SERVO)
    watch = ContactWatch(ServoPrediction(known, MODEL))
    return DelayedServo(parameters, drawn.delay_ms / 1e3), watch


@pytest.mark.parametrize("seed", range(4))
def test_a_finger_that_stands_still_is_noticed_and_no_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    servo, watch = watched(rng, 0.015)
    commands, direction = creeping(rng)
    start = commands.q[0]
    robot = ServoPrediction(servo, MODEL)
    robot.begin(start, start)
    firsts = range(0, len(commands) - CYCLE_TICKS, CYCLE_TICKS)
    free = [start]
    free += [robot.step(commands.part(slice(first, first + CYCLE_TICKS))) for first in firsts]
    noise = rng.normal(0.0, NOISE, (len(free), 7))

    row = direction @ tip_jacobian(ARM, start)
    way = np.array(free - start) @ row
    wall = float(rng.uniform(FREE_WAY + 0.004, way[-1] - 0.004))
    for met in (False, True):
        watch.begin(start, start, direction)
        noticed = None
        for cycle, q in enumerate(free[1:], 1):
            stopped = met and way[cycle] > wall
            seen = free[int(np.argmax(way > wall))] if stopped else q
            rows = slice((cycle - 1) * CYCLE_TICKS, cycle * CYCLE_TICKS)
            watch.look(commands.part(rows), seen + noise[cycle])
            assert watch.force >= 0.0
            if watch.touched:
                noticed = way[cycle]
                break
        if met:
            assert noticed is not None
            assert 0.0 < noticed - wall < 1.2e-3
            # No less than of a finger that slips, of joints that are all springs.
            compliance = float(row**2 @ (1.0 / servo.parameters.kp))
            assert watch.force > 0.7 * (noticed - wall) / compliance
        else:
            assert noticed is None, f"taken for contact after {1e3 * noticed:.1f} mm"


def test_a_state_without_commands_makes_no_contact_usual() -> None:
    rng = np.random.default_rng(0)
    servo, watch = watched(rng, 0.0)
    commands, direction = creeping(rng)
    robot = ServoPrediction(servo, MODEL)
    robot.begin(commands.q[0], commands.q[0])
    watch.begin(commands.q[0], commands.q[0], direction)
    first = 0
    while SPEED * 0.004 * first < FREE_WAY + 0.004:
        rows = slice(first, first + CYCLE_TICKS)
        first += CYCLE_TICKS
        watch.look(commands.part(rows), q := robot.step(commands.part(rows)))
    # The finger stands still from here on, and is seen twice at each time.
    forces = []
    for _ in range(12):
        watch.look(commands.part(slice(first, first + CYCLE_TICKS)), q)
        watch.look(commands.part(slice(0, 0)), q)
        first += CYCLE_TICKS
        forces.append(watch.force)
    assert watch.touched
    assert forces[-1] > 1.0


@pytest.mark.parametrize("seed", range(5))
def test_the_stiffest_finger_sticks_or_has_a_joint_held(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stiffness = rng.uniform(50.0, 500.0, 7)
    jacobian = tip_jacobian(ARM, np.array(yumi.TABLE_CONFIGURATION) + rng.uniform(-0.3, 0.3, 7))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    # A tip that is pushed along the direction and held sideways: the springs' least energy.
    both = np.block([[np.diag(stiffness), jacobian.T], [jacobian, np.zeros((3, 3))]])
    moved = np.linalg.solve(both, np.concatenate((np.zeros(7), direction)))[:7]
    sticking = float(moved @ (stiffness * moved))
    held = max(
        1.0 / sum((direction @ jacobian[:, j]) ** 2 / stiffness[j] for j in range(7) if j != k)
        for k in range(7)
    )
    assert stiffest(direction, jacobian, stiffness) == pytest.approx(max(sticking, held))


def test_the_jacobian_of_the_tips_is_that_of_their_position() -> None:
    rng = np.random.default_rng(0)
    profile = limits.profile("lab")
    for q in rng.uniform(profile.position_lower, profile.position_upper, (5, 7)):
        numeric = np.empty((3, 7))
        for joint, step in enumerate(1e-6 * np.eye(7)):
            ends = [
                position + TIP * rotation[:, 2]
                for position, rotation in (ARM.forward(q + step), ARM.forward(q - step))
            ]
            numeric[:, joint] = (ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(tip_jacobian(ARM, q), numeric, atol=1e-8)
