"""Pictures, films and contact sheets."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from skewmi.child import child_command
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


DRAW = """
import mujoco
from skewmi.errors import ConfigurationError
from skewmi.sim.offscreen import make_renderer
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><light pos="0 0 3"/><geom type="sphere" size="0.1"/></worldbody></mujoco>'
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
try:
    for _ in range(2):
        renderer = make_renderer(model, 64, 48)
        renderer.update_scene(data)
        print(renderer.render().std() > 0.0)
        renderer.close()
except ConfigurationError as error:
    print(error)
"""


def drawn(**variables: str) -> list[str]:
    """What a fresh process prints that draws in an environment."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")
    environment = {k: v for k, v in os.environ.items() if k not in names} | variables
    done = subprocess.run(
        child_command("-c", DRAW), env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def test_a_display_that_is_gone_does_not_hinder_pictures() -> None:
    without = drawn()
    if without != ["True", "True"]:
        pytest.skip(f"no EGL here: {without}")
    for display in (":77", "localhost:10.0"):
        assert drawn(DISPLAY=display) == ["True", "True"]
    assert drawn(WAYLAND_DISPLAY="wayland-9") == ["True", "True"]


def test_a_platform_that_was_asked_for_and_fails_is_named() -> None:
    (line,) = drawn(MUJOCO_GL="glfw", DISPLAY=":77")
    assert "MUJOCO_GL=glfw" in line
    assert "unset it" in line


def test_commands_that_draw_nothing_need_no_opengl(tmp_path: Path) -> None:
    """`osmesa` without its library, and a word that MuJoCo does not know, fail its import."""
    arguments = ["evaluate", "--agent", "zero", "--task", "open_press_close", "--episodes", "1"]
    for chosen in ("osmesa", "nonsense"):
        done = subprocess.run(
            child_command("-m", "skewmi.cli.main", *arguments, "--json"),
            env={**os.environ, "MUJOCO_GL": chosen},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
