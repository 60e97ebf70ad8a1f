"""Films of recordings: what the robot reported is what is drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skewmi.cli.main import main
from skewmi.deploy.recording.reader import METADATA_NAME, run_metadata
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.session.states import STATUS_NAME
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates, Status
from skewmi.robot_models import yumi
from skewmi.sim import tasks

START_NS = 5_000_000_000
LAYOUT = tasks.layout("open_press_close")
NOTHING = np.zeros(0)


def joints(stamp_ns: int, names: tuple[str, ...], values: np.ndarray) -> bytes:
    return messages.encode_joint_states(JointStates(stamp_ns, names, values, NOTHING, NOTHING))


def write_recording(path: Path, episodes: int = 2, seconds: float = 1.0) -> None:
    """Episodes that follow each other closely; the lid opens in each, the arm stands still."""
    arm = (*yumi.joint_names("right"), yumi.finger_names("right")[0])
    assert LAYOUT.workspace is not None
    q = np.array([*LAYOUT.workspace.start_configuration, 0.014])
    with RecordingWriter(path) as writer:
        writer.add_metadata(METADATA_NAME, run_metadata(layout_json=LAYOUT.to_json()))
        for episode in range(episodes):
            begin = START_NS + round(episode * (seconds + 0.2) * 1e9)
            values = {"state": "running", "reason": "", "from": "to start", "event": "at start"}
            status = Status(begin, STATUS_NAME, messages.OK, "running", values)
            writer.write(topics.YUMI_STATUS, messages.encode_status(status))
            for cycle in range(round(seconds * 50)):
                stamp = begin + cycle * 20_000_000
                lid = 2.0 * cycle / (seconds * 50)
                writer.write(topics.YUMI_JOINT_STATES, joints(stamp, arm, q))
                scene = np.array([lid, 0.0])
                writer.write(
                    topics.YUMI_SCENE_STATES, joints(stamp, ("lid_hinge", "button_slide"), scene)
                )
                if cycle % 5 == 0:
                    seen = np.array([0.0, 0.0, 0.27, 0.014, lid, 0.0])
                    writer.write(
                        topics.POLICY_OBSERVATION, joints(stamp, LAYOUT.observation_names, seen)
                    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "run.mcap"
    write_recording(path)
    return path


def test_film_and_strip_show_one_episode(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    film, strip = tmp_path / "a.gif", tmp_path / "a.png"
    arguments = ["film", str(recording), "--out", str(film), "--strip", str(strip), "--json"]
    sizes = ["--width", "160", "--height", "120", "--frames", "4", "--episode", "2"]
    assert main([*arguments, *sizes]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["episodes"] == 2
    assert report["duration_s"] == pytest.approx(0.9)
    with Image.open(film) as image:
        assert image.size == (160, 120)
        assert image.n_frames == report["frames"] == 5
        image.seek(0)
        first = np.asarray(image.convert("RGB"), dtype=float)
        image.seek(4)
        last = np.asarray(image.convert("RGB"), dtype=float)
    # The lid swings through a good part of the picture; below the caption nothing else moves.
    assert np.abs(first - last)[20:].mean() > 0.3
    with Image.open(strip) as image:
        assert image.size == (640, 120)


@pytest.mark.parametrize(
    ("extra", "complaint"),
    [
        (["--episode", "3"], "holds 2 episodes"),
        (["--rate", "0"], "--rate is 0"),
        (["--frames", "0"], "--frames is 0"),
        (["--camera", "nowhere"], "cameras are"),
        (["--out", "film.xyz"], "suffix"),
    ],
)
def test_bad_options_are_one_line(
    extra: list[str],
    complaint: str,
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["film", str(recording), "--width", "64", "--height", "48", *extra]) == 2
    captured = capsys.readouterr()
    assert complaint in captured.err
    assert captured.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
