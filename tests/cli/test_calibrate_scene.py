"""`skewmi calibrate scene`: what it refuses, what it makes of files, and one box found by touch."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrations import full_calibration

from skewmi.calibration.calibration_file import read_calibration, write_calibration
from skewmi.calibration.scene_fit import SceneFit
from skewmi.calibration.scene_section import scene_warnings
from skewmi.cli.calibrate_scene_result import SCENE_WARNINGS
from skewmi.cli.main import main
from skewmi.cli.scene_shapes import nominal_box

POINTS = (
    "face,x,y,z\nnear,0.283,-0.12,0.05\nnear,0.283,-0.02,0.05\n"
    "left,0.31,0.001,0.05\nleft,0.48,0.001,0.05\n"
)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--force-limit", "16"], "--force-limit"),
        (["--force-limit", "nan"], "--force-limit"),
        (["--points", "a.csv", "--marker", "b.yaml"], "give one of them"),
        (["--connect", "tcp/127.0.0.1:1", "--variation", "x"], "give it to the skewmi robot"),
        (["--lead-ms", "9"], "multiple of 4"),
        (["--calibration", "none.yaml"], "no calibration file"),
        (["--points", "none.csv"], "no points file"),
        (["--limits", "wild"], "wild"),
    ],
)
def test_bad_options_are_told(
    flags: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.yaml"
    assert main(["calibrate", "scene", *flags, "--out", str(out)]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_points_tell_the_box_and_the_servos_stay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, out, points = (tmp_path / name for name in ("before.yaml", "out.yaml", "points.csv"))
    write_calibration(before, full_calibration())
    points.write_text(POINTS)
    flags = ["--points", str(points), "--calibration", str(before), "--out", str(out), "--json"]
    assert main(["calibrate", "scene", *flags]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    # The near side is 1 mm too far, the left one 2 mm too near; nothing is turned.
    assert told["box_pose"]["x"]["value"] == pytest.approx(0.001, abs=1e-9)
    assert told["box_pose"]["y"]["value"] == pytest.approx(-0.002, abs=1e-9)
    assert told["box_pose"]["yaw_deg"]["value"] == pytest.approx(0.0, abs=1e-6)
    assert len(told["touches"]) == 4
    assert told["lid_bias_deg"]["assumed"]
    written = read_calibration(out)
    assert written.servo == full_calibration().servo
    assert written.scene is not None
    assert written.scene.x.low[0] < 0.001 < written.scene.x.high[0]
    # It is not replaced unasked.
    assert main(["calibrate", "scene", *flags]) != 0


def test_a_new_scene_leaves_nothing_of_the_one_before(tmp_path: Path) -> None:
    first, second, points = (tmp_path / name for name in ("1.yaml", "2.yaml", "points.csv"))
    others = ("kp of yumi_joint_6_r is not identified: 3 to 400 N m/rad",)
    unknown = scene_warnings(SceneFit(*(np.zeros(3),) * 4, 0.0), (), known_servo=False)
    write_calibration(first, replace(full_calibration(), warnings=(*others, *unknown)))
    # The last point is 3 mm off the side that the others tell.
    points.write_text(POINTS + "left,0.40,0.004,0.05\n")
    flags = ["--points", str(points), "--calibration"]
    assert main(["calibrate", "scene", *flags, str(first), "--out", str(second)]) == 0
    told = read_calibration(second).warnings
    assert told[:-1] == others
    assert "do not fit one box" in told[-1]
    points.write_text(POINTS)
    third = tmp_path / "3.yaml"
    assert main(["calibrate", "scene", *flags, str(second), "--out", str(third)]) == 0
    assert read_calibration(third).warnings == others


def test_every_warning_of_a_scene_is_known_as_one() -> None:
    fit = SceneFit(np.zeros(3), np.eye(3), np.zeros(4), np.zeros((4, 3)), 9.0)
    told = scene_warnings(fit, ("near",) * 4, known_servo=False)
    assert len(told) == len(SCENE_WARNINGS)
    assert all(text.startswith(SCENE_WARNINGS) for text in told)


def test_a_lid_that_was_not_measured_is_not_said_to_read_anything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points, out = tmp_path / "points.csv", tmp_path / "out.yaml"
    points.write_text(POINTS)
    assert main(["calibrate", "scene", "--points", str(points), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "what the shut lid reads was not measured" in printed
    assert "(0.00 to 0.00)" not in printed


@pytest.mark.parametrize("number", ["1e308", "-1e200", "1e5"])
def test_points_beyond_any_scene_are_refused(
    number: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points, out = tmp_path / "points.csv", tmp_path / "out.yaml"
    points.write_text(POINTS.replace("0.283,-0.12", f"{number},-0.12"))
    assert main(["calibrate", "scene", "--points", str(points), "--out", str(out)]) == 2
    told = capsys.readouterr().err
    assert "line 2" in told
    assert "must be in m, at most 10" in told
    assert not out.exists()


def test_the_nominal_box_is_the_tasks() -> None:
    box = nominal_box()
    assert box.lid == "lid_hinge"
    assert box.faces["near"].middle == pytest.approx((0.391, -0.0735))
    assert {part.name for part in box.standing} == {
        f"box_wall_{name}" for name in ("near", "far", "front", "hinge")
    }


@pytest.mark.slow
def test_touching_finds_the_box(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    variation, out = tmp_path / "robot.json", tmp_path / "out.yaml"
    true = {"x": 0.0042, "y": -0.0033, "yaw_deg": 2.5}
    variation.write_text(
        json.dumps(
            {
                "seed": 3,
                "box_pose": true,
                "sensors": {"joint_noise": 1e-4, "lid_bias_deg": 3.0},
            }
        )
    )
    flags = ["--lock-step", "--variation", str(variation), "--out", str(out), "--json"]
    assert main(["calibrate", "scene", *flags]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    for name, error in (("x", 2e-4), ("y", 2e-4), ("yaw_deg", 0.05)):
        found = told["box_pose"][name]
        assert found["value"] == pytest.approx(true[name], abs=error)
        assert found["low"] < true[name] < found["high"]
    assert told["lid_bias_deg"]["value"] == pytest.approx(3.0, abs=0.1)
    assert [touch["face"] for touch in told["touches"]] == ["near"] * 2 + ["far"] * 2 + ["left"] * 2
    assert told["contact"]["hand_force_peak_n"] < 15.0
    assert told["contact"]["arm_force_peak_n"] == 0.0
    assert max(value for name, value in told["usage"].items() if name != "workspace") <= 1.0
    assert read_calibration(out).scene is not None
