"""What the simulated robot tells about contact: the largest values, restated in numpy."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.contact import QUANTITIES
from skewmi.deploy.report import DeployReport, EpisodeReport
from skewmi.deploy.robot.backends.mujoco.contact_meter import ContactMeter
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.trajectory import JointPoint

LOW, HIGH = np.array([-0.1, -0.2, 0.0]), np.array([0.1, 0.2, 0.3])
HELD = np.diag([1.0, -1.0, -1.0])
FORCES = hnp.arrays(np.float64, st.tuples(st.integers(1, 300), st.just(9)),
                    elements=st.floats(-200.0, 200.0))  # fmt: skip


def turned(angle: float, axis: np.ndarray) -> np.ndarray:
    quaternion, matrix = np.empty(4), np.empty(9)
    mujoco.mju_axisAngle2Quat(quaternion, axis / np.linalg.norm(axis), angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return (matrix.reshape(3, 3) @ HELD).ravel()


@given(FORCES)
def test_forces_and_excess_are_the_largest_of_all_ticks(rows: np.ndarray) -> None:
    meter = ContactMeter(LOW, HIGH, HELD)
    meter.add(1e3 * np.ones(3), np.zeros(3), LOW - 1.0, HELD.ravel())
    meter.clear()
    assert meter.summary() == {}
    for row in rows:
        meter.add(row[:3], row[3:6], 1e-3 * row[6:], HELD.ravel())
    hand = np.linalg.norm(rows[:, :3], axis=1)
    # 125 ticks of 4 ms; before the first tick nothing touched.
    padded = np.concatenate([np.zeros(125), hand])
    standing = [padded[k : k + 125].mean() for k in range(1, len(hand) + 1)]
    place = 1e-3 * rows[:, 6:]
    expected = {
        "hand_force_peak_n": hand.max(),
        "hand_force_standing_n": max(standing),
        "arm_force_peak_n": np.linalg.norm(rows[:, 3:6] - rows[:, :3], axis=1).max(),
        "hand_tilt_deg": 0.0,
        "outside_box_mm": 1e3 * np.linalg.norm(place - place.clip(LOW, HIGH), axis=1).max(),
    }
    assert meter.summary() == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert set(expected) < set(QUANTITIES)


@given(st.lists(st.tuples(st.floats(0.0, 3.1), st.integers(0, 2)), min_size=1, max_size=20))
def test_tilt_is_the_largest_angle_from_the_held_orientation(
    turns: list[tuple[float, int]],
) -> None:
    meter = ContactMeter(LOW, HIGH, HELD)
    for angle, axis in turns:
        meter.add(np.zeros(3), np.zeros(3), np.zeros(3), turned(angle, np.eye(3)[axis] + 0.1))
    largest = np.degrees(max(angle for angle, _ in turns))
    assert meter.summary()["hand_tilt_deg"] == pytest.approx(largest, abs=2e-6 * 57.3)


def test_a_hand_that_leans_on_the_shut_lid_is_felt_and_a_free_one_is_not() -> None:
    robot = ArmSimulation()
    q0 = robot.reset(0)
    rest = np.zeros(7)
    assert robot.contact.summary() == {}
    for _ in range(25):
        robot.step()
    free = robot.contact.summary()
    assert free["hand_force_peak_n"] == free["arm_force_peak_n"] == 0.0
    assert free["outside_box_mm"] < 0.1
    assert free["hand_tilt_deg"] < 0.1

    # Straight down, 100 mm in 2 s: into the lid.
    kinematics = robot.scene.kinematics
    position, rotation = kinematics.forward(q0)
    goal = kinematics.inverse(position - [0.0, 0.0, 0.1], rotation, q0, posture=q0).q
    felt = np.zeros(25 + 750)
    for tick in range(750):
        share = min(1.0, tick / 500)
        speed = (goal - q0) / 2.0 if share < 1.0 else rest
        robot.command = JointPoint(q0 + share * (goal - q0), speed, rest)
        robot.step()
        felt[25 + tick] = np.linalg.norm(robot._data.sensordata[robot.scene.hand_force])
    leaning = robot.contact.summary()
    assert leaning["hand_force_peak_n"] == pytest.approx(felt.max())
    standing = max(felt[k : k + 125].mean() for k in range(len(felt) - 124))
    assert leaning["hand_force_standing_n"] == pytest.approx(standing)
    assert 10.0 < standing < felt.max()
    # Servos bend: what pushes up also turns the hand.
    assert leaning["hand_tilt_deg"] > 1.0

    robot.reset(0)
    assert robot.contact.summary() == {}


def test_a_report_counts_episodes_within_limits_and_leaves_out_what_nobody_measured() -> None:
    report = DeployReport("t", "sim", "lab", 1.0, lock_step=True)
    assert report.contact() == {}
    for index, peak in enumerate((20.0, 100.0, 100.5, 7.0)):
        contact = {"hand_force_peak_n": peak, "arm_force_peak_n": 3.0 * index}
        report.episodes.append(EpisodeReport(index, "success", "", 1, 0, {}, contact))
    report.episodes.append(EpisodeReport(4, "stopped", "no answer", 1, 0, {}))
    expected = {
        "hand_force_peak_n": {"max": 100.5, "limit": 100.0, "share_of_episodes_within": 0.75},
        "arm_force_peak_n": {"max": 9.0},
    }
    assert report.contact() == expected
    assert report.as_dict()["contact"] == expected
