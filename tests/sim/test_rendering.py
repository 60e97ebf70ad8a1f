"""Pictures, films and contact sheets."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sim.arm.scene import ArmScene
from skewmi.sim.rendering import Renderer, contact_sheet, label, write_film, write_picture
from skewmi.sim.tasks.open_press_close.definition import ARM

RED = np.full((30, 40, 3), (200, 0, 0), dtype=np.uint8)
BLUE = np.full((30, 40, 3), (0, 0, 200), dtype=np.uint8)


def test_every_camera_shows_what_moves() -> None:
    scene = ArmScene(ARM)
    data = mujoco.MjData(scene.model)
    try:
        renderer = Renderer(scene.model, width=160, height=120)
    except ConfigurationError as error:
        pytest.skip(str(error))
    with renderer:
        for camera in ("overview", "side", "front", "close"):
            scene.reset(data)
            shut = renderer.draw(data, camera)
            data.qpos[scene.scene_qpos[0]] = 1.5
            opened = renderer.draw(data, camera)
            assert shut.shape == (120, 160, 3)
            assert np.mean(np.any(shut != opened, axis=-1)) > 0.002, camera
        with pytest.raises(NotFoundError, match="overview"):
            renderer.draw(data, "moon")


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_film_keeps_its_frames_and_its_pace(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"film{suffix}"
    write_film(path, [RED, BLUE, RED], frames_per_second=10.0)
    with Image.open(path) as film:
        assert film.n_frames == 3
        film.seek(1)
        film.load()
        assert film.info["duration"] == 100
        pixel = np.asarray(film.convert("RGB"))[15, 20]
    assert pixel[2] > 150
    assert pixel[0] < 50


@pytest.mark.parametrize(
    ("name", "frames", "rate"),
    [("film.avi", [RED], 10.0), ("film.gif", [], 10.0), ("film.gif", [RED], 0.0)],
)
def test_impossible_films_are_refused(tmp_path: Path, name: str, frames: list, rate: float) -> None:
    with pytest.raises(ConfigurationError):
        write_film(tmp_path / name, frames, frames_per_second=rate)


def test_a_contact_sheet_lays_frames_out_row_by_row() -> None:
    sheet = contact_sheet([RED, BLUE, RED], ["a", "b", "c"], columns=2)
    assert sheet.shape == (60, 80, 3)
    assert tuple(sheet[25, 35]) == (200, 0, 0)
    assert tuple(sheet[25, 75]) == (0, 0, 200)
    assert tuple(sheet[55, 35]) == (200, 0, 0)
    assert tuple(sheet[55, 75]) == (255, 255, 255)


@pytest.mark.parametrize(
    ("frames", "labels"), [([], []), ([RED], ["a", "b"]), ([RED, RED[:5]], ["a", "b"])]
)
def test_impossible_contact_sheets_are_refused(frames: list, labels: list) -> None:
    with pytest.raises(ConfigurationError):
        contact_sheet(frames, labels)


def test_a_label_leaves_the_original_alone(tmp_path: Path) -> None:
    before = RED.copy()
    labelled = label(RED, "step 1")
    assert np.array_equal(RED, before)
    assert np.any(labelled != RED)
    write_picture(tmp_path / "a.png", labelled)
    with Image.open(tmp_path / "a.png") as picture:
        assert np.array_equal(np.asarray(picture), labelled)
    with pytest.raises(ConfigurationError):
        write_picture(tmp_path / "a.xyz", labelled)
