"""`skewmi calibrate`: steps, what they refuse, and a robot found through the deployed chain."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrations import full_calibration

from skewmi.calibration.calibration_file import Constant, read_calibration, write_calibration
from skewmi.cli.main import main
from skewmi.deploy.recording.joint_series import executed_reference
from skewmi.deploy.recording.reader import read_recording
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.sim import tasks

KP_SCALE = [0.5, 1.4, 0.8, 0.6, 1.2, 0.7, 1.5]
FRICTION = [0.5, 1.2, 0.9, 0.3, 0.2, 0.4, 0.3]
DELAY_MS = 13.0


def robot(folder: Path) -> Path:
    path = folder / "robot.yaml"
    path.write_text(
        f"servo: {{kp_scale: {KP_SCALE}, frictionloss: {FRICTION}, delay_ms: {DELAY_MS}}}\n"
        "sensors: {joint_noise: 0.0001}\n"
    )
    return path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["excite", "--joints", "1,2,8"], "ABB's numbers"),
        (["excite", "--joints", "1,1"], "each once"),
        (["excite", "--seconds", "3"], "--seconds is 3"),
        (["excite", "--limits", "careful", "--seconds", "15"], "20..600"),
        (["excite", "--limits", "fast"], "no limit profile"),
        (["excite", "--seed", "-1"], "--seed is -1"),
        (["servo", "missing.mcap", "--out", "c.yaml"], "no recording missing.mcap"),
        (["report", "missing.yaml"], "no calibration file missing.yaml"),
        (["ranges", "missing.yaml", "--out", "v.yaml"], "no calibration file"),
    ],
)
def test_bad_input_is_named_before_anything_moves(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_existing_recording_is_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "excitation.mcap"
    there.write_text("mine")
    assert main(["calibrate", "excite", "--out", str(there)]) == 2
    assert "exists" in capsys.readouterr().err
    assert there.read_text() == "mine"


def test_ranges_are_a_variation_file(tmp_path: Path) -> None:
    calibration = write_calibration(tmp_path / "c.yaml", full_calibration())
    out = tmp_path / "v.yaml"
    assert main(["calibrate", "ranges", str(calibration), "--out", str(out)]) == 0
    variation = tasks.find(tasks.default()).variations.load(out)
    assert variation.has("servo.kp_scale", "servo.delay_ms", "box_pose.x")


def test_ranges_that_cannot_hold_the_robot_say_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = full_calibration()
    assert whole.servo is not None
    late = replace(whole.servo, delay_ms=Constant((140.0,), (137.0,), (143.0,), (False,)))
    calibration = write_calibration(tmp_path / "c.yaml", replace(whole, servo=late))
    out = tmp_path / "v.yaml"
    assert main(["calibrate", "ranges", str(calibration), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "warning: servo.delay_ms is 140 (137 to 143)" in printed
    assert "allows 0 to 100" in printed


def test_a_report_of_tables_needs_no_recording(tmp_path: Path) -> None:
    calibration = write_calibration(tmp_path / "c.yaml", full_calibration())
    out = tmp_path / "c.html"
    assert main(["calibrate", "report", str(calibration), "--out", str(out)]) == 0
    page = out.read_text()
    content = read_calibration(calibration)
    assert content.servo is not None
    for value in content.servo.kp.value:
        assert f"{value:.4g}" in page
    for warning in content.warnings:
        assert warning in page
    assert 'src="data:image/png' in page
    assert "http" not in page


@pytest.mark.slow
def test_a_robot_is_excited_identified_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, out = tmp_path / "r.mcap", tmp_path / "c.yaml"
    command = ["calibrate", "excite", "--variation", str(robot(tmp_path)), "--lock-step"]
    assert main([*command, "--seconds", "15", "--out", str(recording), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert max(told["usage"].values()) <= 1.0
    assert told["stops"] == []
    assert told["missed_cycles"] == 0
    profile = limits.profile("lab")
    executed = executed_reference(read_recording(recording)).on_grid()[1]
    assert (np.abs(executed.v) <= profile.velocity * (1.0 + 1e-6)).all()
    assert (np.abs(executed.a) <= profile.acceleration * (1.0 + 1e-6)).all()
    assert np.abs(executed.q[0] - executed.q[-1]).max() < 1e-6
    page = tmp_path / "c.html"
    command = ["calibrate", "servo", str(recording), "--out", str(out), "--report", str(page)]
    assert main([*command, "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    servo = told["servo"]
    true = {
        "kp": np.multiply(KP_SCALE, CONTACT_SERVO.kp),
        "kd_over_kp": CONTACT_SERVO.kd / CONTACT_SERVO.kp / KP_SCALE,
        "frictionloss": np.array(FRICTION),
    }
    for name, allowed in (("kp", 0.1), ("kd_over_kp", 0.03), ("frictionloss", 0.1)):
        np.testing.assert_allclose(servo[name]["value"], true[name], rtol=allowed, err_msg=name)
    assert abs(servo["delay_ms"]["value"] - DELAY_MS) < 0.3
    assert page.read_text().count("data:image/png") == 4
