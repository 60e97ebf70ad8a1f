"""An arm is excited through the bridge, and its controller's law found from the recording."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from skewmi.calibration.calibration_file import read_calibration
from skewmi.cli.main import main
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.robot.description import EGM
from skewmi.deploy.robot.process import spawn_robot


@pytest.fixture
def locator() -> Iterator[str]:
    """Of a bridge with an emulated controller, as `skewmi deploy --robot egm-emulator` has them."""
    with spawn_robot("egm-emulator", "open_press_close", "lab", lock_step=False) as where:
        yield where


@pytest.mark.slow
def test_a_recording_made_through_the_bridge_is_known_and_tells_the_law(
    locator: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, file = tmp_path / "e.mcap", tmp_path / "egm.yaml"
    excite = ["calibrate", "excite", "--connect", locator, "--seconds", "10", "--json"]
    assert main([*excite, "--out", str(recording)]) == 0, capsys.readouterr().err
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    # The bridge admits less speed of the flange than other robots do.
    assert told["stops"] == []
    metadata = read_recording(recording).metadata
    assert metadata["backend"] == "egm"
    assert json.loads(metadata[EGM]) == {"gain": 20.0, "low_pass_hz": 20.0, "speed_share": 1.0}
    report = tmp_path / "egm.html"
    servo = ["calibrate", "servo", str(recording), "--out", str(file), "--report", str(report)]
    assert main([*servo, "--json"]) in (0, 1)
    document = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert "servo" not in document
    egm = document["egm"]
    # On a busy computer answers wait for a cycle or two: that is part of the lag.
    assert egm["gain"]["value"] == pytest.approx(20.0, rel=0.25)
    assert egm["low_pass_hz"]["value"] == pytest.approx(20.0, rel=0.25)
    assert 18.0 < egm["servo"]["delay_ms"]["value"] < 45.0
    assert egm["period_ms"] == pytest.approx(4.032, abs=0.01)
    assert document["residual_rms_rad"]
    calibration = read_calibration(file)
    assert calibration.egm is not None
    assert calibration.servo is None
    assert "Controller guided by EGM" in report.read_text()
    assert main([*servo[:3], "--out", str(tmp_path / "o.yaml"), "--effort"]) == 2
    assert "tell no efforts" in " ".join(capsys.readouterr().err.split())
