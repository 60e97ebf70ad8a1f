"""Against a blocked hand the command stops: in a deployment as in training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scripted_runs import give_up
from unknown_robots import exact_calibration, exactly

from skewmi.calibration.calibration_file import Calibration, write_calibration
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.controller_state import decode_controller_state
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.sim.arm import definition
from skewmi.sim.tasks.open_press_close.definition import make_layout

STEPS_ASIDE = 5
STEPS = 100
"""Contact, a second to come back from it, and six seconds on the lid."""


class LeanOnTheLid:
    """Moves off the handle, then down with all it may command, until it has had enough."""

    def __init__(self, layout: PolicyLayout) -> None:
        self.layout = layout

    def reset(self) -> None:
        self.count = 0

    def act(self, observation: Array) -> Array:
        self.count += 1
        if self.count > STEPS:
            give_up()
        return np.array([0.0, 1.0, 0.0] if self.count <= STEPS_ASIDE else [0.0, 0.0, -1.0])


def hands(path: Path) -> tuple[Array, Array, Array]:
    """Times in s, (n,), and hands as measured and as the robot was told to have them, m, (n, 3).

    Both are of one message of the robot: one that a busy computer loses leaves no false pair.
    """
    recording, arm = read_recording(path), ArmKinematics("right")
    payloads = recording.messages[topics.YUMI_CONTROLLER_STATE.name]
    states = [decode_controller_state(message.payload) for message in payloads]
    times = np.array([state.stamp_ns for state in states]) / 1e9
    measured = np.array([state.position for state in states])
    wanted = np.array([state.reference.q for state in states])
    return times, arm.forward(measured)[0], arm.forward(wanted)[0]


def test_the_following_error_of_a_deployed_hand_on_the_lid_is_that_of_a_blocked_one(
    lock_step_robot: str, tmp_path: Path
) -> None:
    layout = make_layout()
    assert layout.workspace is not None
    path = tmp_path / "lean.mcap"
    options = DeployOptions(connect=lock_step_robot, lock_step=True, record=path, start_spread=0.0)
    report = run_deploy(LeanOnTheLid(layout), options)
    assert report.episodes[0].reason == "enough", report.as_dict()
    times, measured, commanded = hands(path)
    error = np.linalg.norm(commanded - measured, axis=1)
    # At 150 mm/s, 24 ms of chunks under way and the limits on braking: at most this, once.
    contact_s = times[np.argmax(error > 5e-3)]
    assert error.max() < 0.024
    # A second later the command has come back to what it may be of a blocked hand, on average: a
    # policy that goes on pushing makes it swing, by the delay between command and contact.
    standing = error[(times > contact_s + 1.0) & (times < contact_s + 7.0)]
    assert len(standing) > 1000
    held = layout.workspace.held_following_error * definition.HAND_STEP
    assert 0.5 * held < standing.mean() < 2.5 * held


SOFT, FRICTION = 0.4, [2.0, 2.0, 2.0, 2.0, 0.5, 0.5, 0.5]
"""Of an arm: stiffness and damping relative to training's, N m."""


def standing_error(folder: Path, calibration: Calibration) -> float:
    """Mean following error of a soft arm that leans on the lid, m."""
    robot = folder / "robot.yaml"
    robot.write_text(f"servo: {{kp_scale: {SOFT}, kd_scale: {SOFT}, frictionloss: {FRICTION}}}")
    path = folder / "lean.mcap"
    options = DeployOptions(
        variation=str(robot),
        calibration=write_calibration(folder / "calibration.yaml", calibration, overwrite=True),
        lock_step=True,
        record=path,
        overwrite=True,
        start_spread=0.0,
    )
    report = run_deploy(LeanOnTheLid(make_layout()), options)
    assert report.episodes[0].reason == "enough", report.as_dict()
    times, measured, commanded = hands(path)
    error = np.linalg.norm(commanded - measured, axis=1)
    contact_s = times[np.argmax(error > 5e-3)]
    return float(error[(times > contact_s + 2.0) & (times < contact_s + 7.0)].mean())


def test_a_blocked_hand_that_is_known_to_be_soft_is_led_further(tmp_path: Path) -> None:
    """3 mm of a soft arm do not overcome its friction. Two calibrations ask for the same
    feed-forward, which is of ratios; one of them does not know how soft the arm is."""
    known = exact_calibration(SOFT, SOFT, FRICTION)
    assert known.servo is not None
    servo = replace(known.servo, kp=exactly(CONTACT_SERVO.kp))
    unknown = replace(known, servo=servo)
    assert standing_error(tmp_path, known) > 1.3 * standing_error(tmp_path, unknown)
