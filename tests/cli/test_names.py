"""`skewmi list`, `info`, `model`, and what is told of names that do not exist."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import pytest
from calibrations import full_calibration

from skewmi import policies
from skewmi.calibration.calibration_file import write_calibration
from skewmi.cli.main import main
from skewmi.deploy.robot.backends import BACKENDS
from skewmi.robot_models import yumi
from skewmi.sim import tasks


def test_list_names_all_that_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told["tasks"]) == set(tasks.names())
    assert set(told["policies"]) == set(policies.bundled())
    assert set(told["robots"]) >= set(BACKENDS)
    assert "improved" in told["tasks"]["open_press_close"]["presets"]
    assert told["tasks"]["open_press_close"]["variations"] == ["deployed", "randomised"]
    assert main(["list"]) == 0
    shown = capsys.readouterr().out
    assert [name for name in (*tasks.names(), *policies.bundled()) if name not in shown] == []


def test_info_of_a_bundled_policy(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "open_press_close", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["kind"], told["task"]) == ("policy", "open_press_close")
    assert told["control_hz"] == pytest.approx(10.0)
    assert main(["info", "open_press_close"]) == 0
    assert "observation: " in capsys.readouterr().out


def test_info_of_a_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "own.yaml"
    write_calibration(path, full_calibration())
    assert main(["info", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["sections"] == ["servo", "scene"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("nothing.onnx", None, "does not exist"),
        ("a.txt", b"words", "neither a policy"),
        ("a.onnx", b"no policy", "not a whole policy file"),
        ("a.yaml", b"schema: x", "schema"),
        ("a.mcap", b"\x89MCAP0\r\n", "holds no message"),
    ],
)
def test_info_says_what_is_none_of_ours(
    name: str,
    content: bytes | None,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert main(["info", str(path)]) == 2
    assert message in capsys.readouterr().err


def test_the_model_is_what_others_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["model"]) == 0
    urdf = ElementTree.fromstring(capsys.readouterr().out)
    names = {joint.get("name") for joint in urdf.iter("joint")}
    assert names >= set(yumi.joint_names("right")) | set(yumi.joint_names("left"))
    out = tmp_path / "new" / "yumi.xml"
    flags = ["model", "--format", "mjcf", "--left-arm", "parked", "--out", str(out)]
    assert main(flags) == 0
    model = mujoco.MjModel.from_xml_path(str(out))
    assert [model.joint(i).name for i in range(7)] == list(yumi.joint_names("right"))
    assert main(flags) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*flags, "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["depoly"], "deploy"),
        (["deploy", "open_pres_close"], "open_press_close"),
        (["evaluate", "open_pres_close"], "open_press_close"),
        (["info", "open_pres_close"], "open_press_close"),
        (["train", "--task", "door_opn", "--run-dir", "none"], "door_open"),
        (["train", "--task", "door_open", "--preset", "papre", "--run-dir", "none"], "paper"),
        (["deploy", "open_press_close", "--variation", "randomized"], "randomised"),
    ],
)
def test_what_was_meant_is_guessed(
    arguments: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert f"did you mean '{meant}'?" in capsys.readouterr().err


def test_help_of_deploy_names_the_bundled_policies(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["deploy", "--help"])
    told = capsys.readouterr().out
    assert [name for name in policies.bundled() if name not in told] == []
