"""The whole chain before a box that stands elsewhere: known to both sides, to one, to none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from moved_boxes import Displacement, base_in_box, calibration_at, hand_by_mujoco
from rerun.chunk import RrdReader
from robot_servers import describe, robot_in_a_thread
from scripted_runs import FewSteps, Scripted, give_up

from skewmi.calibration.calibration_file import write_calibration
from skewmi.cli.main import main
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.replay.assembler import understand
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.robot import server as server_module
from skewmi.deploy.robot.process import spawn_robot
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.robot_models.base_frame import BoxPose
from skewmi.robot_models.frames import HAND_DOWN

AT: Displacement = (0.02, -0.012, 8.0)


@pytest.fixture
def known(tmp_path: Path) -> Path:
    return write_calibration(tmp_path / "known.yaml", calibration_at(*AT))


def varied(displacement: Displacement) -> str:
    return json.dumps({"box_pose": dict(zip(("x", "y", "yaw_deg"), displacement, strict=True))})


def drawn_base(recording: Path, out: Path) -> Array:
    """Where a replay draws the measured robot. Shape (4, 4)."""
    write_replay(recording, out)
    for chunk in RrdReader(out).stream().to_chunks():
        if str(chunk.entity_path) == "/robot_measured/base":
            table = chunk.to_record_batch().to_pydict()
            found = np.eye(4)
            for name, value in table.items():
                if name.endswith("mat3x3"):
                    found[:3, :3] = np.reshape(value, (3, 3)).T  # column by column
                if name.endswith("translation"):
                    found[:3, 3] = np.ravel(value)
            return found
    raise AssertionError("no robot is drawn")


def test_a_known_displaced_box_works_as_one_in_place(known: Path, tmp_path: Path) -> None:
    """And the recording shows where the hand really was before it."""
    path = tmp_path / "run.mcap"
    options = DeployOptions(
        seed=3, lock_step=True, variation=varied(AT), calibration=known, record=path
    )
    report = run_deploy(Scripted(), options)
    assert report.success_rate == 1.0, report.as_dict()
    assert report.stops == []
    assert report.missed_cycles == 0

    recording = read_recording(path)
    assert BoxPose.of_mapping(json.loads(recording.metadata["box_pose"])) is not None
    run = understand(recording)
    for k in range(0, len(run.measured.time_s), 50):
        hand, turn = hand_by_mujoco(run.measured.q[k], AT)
        np.testing.assert_allclose(run.measured.hand_w[k], hand, atol=1e-9)
        assert turn[2, 2] < -0.99
    workspace = Scripted().layout.workspace
    assert workspace is not None
    tilt = run.measured.tilt_deg(workspace.hand_quaternion_wxyz)
    assert np.median(tilt) < 2.0
    observed = recording.messages[topics.POLICY_OBSERVATION.name]
    seen = [decode_joint_states(message.payload) for message in observed]
    measured = run.measured.hand_w
    for state in seen:
        hand = np.array([state.position[state.names.index(f"hand_{a}")] for a in "xyz"])
        assert np.linalg.norm(measured - hand, axis=1).min() < 1e-9, "of some measured state"
    # Described where it is known to stand, and it stands there: nothing is drawn elsewhere.
    assert all(not placement.poses for placement in run.placements)
    assert run.subject.geometry is not None
    walls = {part.name: part for part in run.subject.geometry.parts}
    np.testing.assert_allclose(walls["box_wall_near"].position, (-0.1135, -0.0735, 0.0415))
    drawn = drawn_base(path, tmp_path / "run.rrd")
    np.testing.assert_allclose(drawn, base_in_box(AT), atol=1e-6)
    table = walls["work_surface"]
    base = run.subject.base
    np.testing.assert_allclose(base.to_base(table.position), (0.45, 0.0, -0.05), atol=1e-9)


def test_both_sides_have_to_know_of_the_box_before_the_arm_is_armed(
    known: Path, tmp_path: Path
) -> None:
    other = write_calibration(tmp_path / "other.yaml", calibration_at(0.021, -0.012, 8.0))
    policy = FewSteps(3, give_up)
    with spawn_robot("sim", "open_press_close", "lab", lock_step=True, calibration=known) as robot:
        before = describe(robot)
        assert before.box == BoxPose(*AT, -0.009, -0.0735)
        assert before.calibration == "", "no servos are known"
        for calibration, why in ((None, "this session with none"), (other, r"at \+20.000 mm")):
            options = DeployOptions(connect=robot, lock_step=True, calibration=calibration)
            with pytest.raises(ConfigurationError, match=why):
                run_deploy(policy, options)
        assert describe(robot).state == "disarmed"
        assert policy.count == 0
        np.testing.assert_array_equal(describe(robot).commanded_position, before.commanded_position)
        options = DeployOptions(connect=robot, lock_step=True, calibration=known)
        assert run_deploy(policy, options).stops == ["enough"]


def test_a_robot_server_that_knows_of_no_box_refuses_who_does(
    known: Path, lock_step_robot: str
) -> None:
    options = DeployOptions(connect=lock_step_robot, lock_step=True, calibration=known)
    with pytest.raises(ConfigurationError, match="as if it stood at its place"):
        run_deploy(FewSteps(3, give_up), options)
    assert describe(lock_step_robot).box_pose == {}
    assert "yaw" not in describe(lock_step_robot).workspaces["task"]


def test_the_arm_is_led_to_the_start_before_the_known_box(
    known: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with spawn_robot(
        "sim",
        "open_press_close",
        "lab",
        lock_step=True,
        variation=varied(AT),
        calibration=known,
    ) as robot:
        run_deploy(
            FewSteps(12, give_up),
            DeployOptions(connect=robot, lock_step=True, calibration=known, start_spread=0.0),
        )
        where = ["--connect", robot, "--lock-step", "--json"]
        assert main(["home", *where]) == 0
        told = json.loads(capsys.readouterr().out.splitlines()[-1])
        hand, turn = hand_by_mujoco(np.array(told["joints_rad"]), AT)
        np.testing.assert_allclose(hand, (-0.009, -0.1345, 0.270), atol=2e-3)
        np.testing.assert_allclose(turn, HAND_DOWN, atol=0.02)
        commanded = np.array(describe(robot).commanded_position)
        np.testing.assert_allclose(hand_by_mujoco(commanded, AT)[0], (-0.009, -0.1345, 0.270))
        # Steps in the task's workspace end where the displaced box ends.
        assert main(["jog", "--x", "40", "--workspace", "task", *where]) == 2
        assert "outside" in capsys.readouterr().err


def test_to_touch_a_box_that_is_known_is_refused_before_anything_moves(
    known: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found.yaml"
    with spawn_robot("sim", "open_press_close", "lab", lock_step=True, calibration=known) as robot:
        before = describe(robot).commanded_position
        where = ["--connect", robot, "--lock-step", "--json", "--out", str(out)]
        assert main(["calibrate", "scene", *where]) == 2
        assert "has no section scene" in capsys.readouterr().err
        assert describe(robot).commanded_position == before
    assert not out.exists()


def test_a_box_that_is_elsewhere_before_the_next_episode_ends_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As of a robot server that was started again with another calibration."""

    def on_event(text: str) -> None:
        if text.startswith("episode 1"):
            moved = BoxPose(0.01, 0.0, 0.0, -0.009, -0.0735)
            monkeypatch.setattr(server_module, "told_box", lambda _: moved)

    with robot_in_a_thread(lock_step=True) as robot:
        policy = FewSteps(5, give_up)
        options = DeployOptions(episodes=2, connect=robot, lock_step=True)
        report = run_deploy(policy, options, on_event=on_event)
    assert policy.count == 5, "the second episode has begun"
    assert "elsewhere than before" in report.episodes[1].reason
