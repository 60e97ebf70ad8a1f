"""A task of another package, by the commands a user would type: from installing to a film."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "press_button_task"
MOST_LINES = 150


def test_the_task_is_one_short_file() -> None:
    (module,) = EXAMPLE.glob("*.py")
    assert len(module.read_text().splitlines()) <= MOST_LINES


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with nothing but the example's package in it, as pip installs it."""
    folder = tmp_path_factory.mktemp("outside")
    source = shutil.copytree(EXAMPLE, folder / "source")  # a build leaves files in its source
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    target = folder / "site"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(source)],
        check=True,
        capture_output=True,
    )
    shutil.rmtree(source)
    return target


def skewmi(site: Path | None, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command with the package installed, in a process of its own."""
    paths = [str(site)] if site is not None else []
    paths += [path for path in [os.environ.get("PYTHONPATH")] if path]
    return subprocess.run(
        [sys.executable, "-m", "skewmi.cli.main", *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=False,
    )


def answer(site: Path, *arguments: object) -> dict[str, Any]:
    """What a command that must succeed says with --json."""
    result = skewmi(site, *arguments, "--json")
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def policy(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trained for a few iterations, and exported."""
    folder = tmp_path_factory.mktemp("runs")
    run, onnx = folder / "run", folder / "press.onnx"
    trained = answer(site, "train", "--task", "press_button", "--run-dir", run, "--steps", 7500)
    assert trained["steps"] == 7500
    written = answer(site, "export-onnx", run, "--out", onnx, "--episodes", 5)
    assert written["max_difference"] <= 1e-5
    return onnx


@pytest.mark.slow
def test_a_task_from_outside_trains_exports_and_deploys_on_its_own_scene(
    site: Path, policy: Path, tmp_path: Path
) -> None:
    recording, film = tmp_path / "press.mcap", tmp_path / "press.gif"
    report = answer(site, "deploy", policy, "--lock-step", "--episodes", 2, "--record", recording)
    assert report["episodes"] == 2
    assert report["stops"] == []
    assert all(episode["steps"] > 0 for episode in report["per_episode"])

    messages = read_recording(recording).messages
    scene = [decode_joint_states(m.payload) for m in messages[topics.YUMI_SCENE_STATES.name]]
    seen = [decode_joint_states(m.payload) for m in messages[topics.POLICY_OBSERVATION.name]]
    assert {s.names for s in scene} == {("knob_slide",)}
    assert {s.names[:5] for s in seen} == {("hand_x", "hand_y", "hand_z", "gripper", "knob_depth")}
    depth = {s.stamp_ns: s.position[0] for s in scene}
    known = [(s.position[4], depth[s.stamp_ns]) for s in seen if s.stamp_ns in depth]
    assert len(known) > 10
    np.testing.assert_array_equal(*np.array(known).T)

    drawn = answer(site, "film", recording, "--out", film, "--rate", 1)
    assert film.stat().st_size > 0
    assert drawn["episodes"] == 2


@pytest.mark.slow
def test_commands_know_the_task_and_what_varies_in_it(site: Path, policy: Path) -> None:
    assert "press_button" in skewmi(site, "robot", "--help").stdout
    for variation in ("randomised", '{"knob": {"frictionloss": [1, 5]}}'):
        figures = answer(site, "evaluate", policy, "--episodes", 2, "--variation", variation)
        assert (figures["task"], figures["variation"]) == ("press_button", variation)
    refused = skewmi(site, "evaluate", policy, "--variation", '{"lid": {"mass": 1}}')
    assert refused.returncode == 2
    assert "no section 'lid'" in refused.stderr


@pytest.mark.slow
def test_without_its_package_the_task_is_unknown(policy: Path) -> None:
    result = skewmi(None, "evaluate", policy)
    assert result.returncode == 2
    assert "no task 'press_button'" in result.stderr
    assert result.stderr.count("\n") == 1
