"""Points and markers in files tell the same box as touches do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skewmi.calibration.scene_faces import SHIFT, TURN, Part, faces_of
from skewmi.calibration.scene_fit import fit_scene
from skewmi.calibration.scene_sources import LARGEST_FILE, read_marker, read_points
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.robot_models.frames import rotation_about

FACES = faces_of([Part("box", (0.28, -0.15, 0.0), (0.50, 0.003, 0.083))])
MIDDLE = FACES["near"].middle
GOOD = "face,x,y,z\nnear,0.28,-0.1,0.05\nnear,0.28,0,0.05\nleft,0.3,0.003,0.05\n"


@pytest.mark.parametrize("seed", range(3))
def test_points_of_a_displaced_box_tell_its_place(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(-SHIFT, SHIFT, 2), rng.uniform(-TURN, TURN)])
    lines = ["face, x, y, z"]
    for number in range(8):
        face = FACES[list(FACES)[number % 4]]
        point = face.place(float(rng.uniform(-0.8, 0.8)) * face.reach, 0.05) - (*MIDDLE, 0.0)
        x, y, z = rotation_about(2, pose[2]) @ point + (*MIDDLE, 0.0) + (pose[0], pose[1], 0.0)
        lines.append(f"{face.name},{x!r},{y!r},{z!r}".replace("np.float64(", "").replace(")", ""))
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines) + "\n\n")
    np.testing.assert_allclose(fit_scene(read_points(path, FACES)).pose, pose, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "its first line is ''"),
        ("x,y,z\n", "its first line is 'x,y,z'"),
        (GOOD + "top,0,0,0\n", "line 5: face 'top'; it must be one of near, far, right, left"),
        (GOOD + "near,0,0\n", "line 5: 3 values; there must be 4"),
        (GOOD + "near,0,zero,0\n", "line 5: could not convert"),
        (GOOD + "near,0,nan,0\n", "line 5: .* must be finite"),
        (GOOD + "near,0.28,1e308,0.05\n", "line 5: .* must be in m, at most 10 either way"),
        (GOOD + "near,-1e200,0,0.05\n", "line 5: .* must be in m"),
        (GOOD + "near,283.4,-18.2,50\n", "line 5: .* must be in m"),
        (GOOD + "near,0,0,0\n" * 1000, "1000 at most"),
        ("#" * (LARGEST_FILE + 1), "is larger than"),
    ],
)
def test_bad_points_are_told(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        read_points(path, FACES)
    with pytest.raises(NotFoundError):
        read_points(tmp_path / "none.csv", FACES)


MARKER = """
measured: {{x: {x!r}, y: {y!r}, yaw_deg: {yaw!r}}}
nominal: {{x: 0.33, y: -0.02, yaw_deg: {nominal!r}}}
covariance:
- [1.0e-8, 0.0, 0.0]
- [0.0, 4.0e-8, 1.0e-6]
- [0.0, 1.0e-6, 1.0e-2]
"""


@pytest.mark.parametrize("seed", range(3))
def test_a_marker_tells_the_box_and_how_well(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(-SHIFT, SHIFT, 2), rng.uniform(-TURN, TURN)])
    nominal_deg = float(rng.uniform(-180.0, 180.0))
    arm = np.array([0.33, -0.02, 0.0]) - (*MIDDLE, 0.0)

    def marker(of: np.ndarray) -> np.ndarray:
        place = rotation_about(2, of[2]) @ arm + (*MIDDLE, 0.0)
        return np.array([place[0] + of[0], place[1] + of[1], of[2]])

    x, y, yaw = marker(pose)
    path = tmp_path / "marker.yaml"
    turned_deg = nominal_deg + float(np.degrees(yaw))
    path.write_text(
        MARKER.format(x=float(x), y=float(y), yaw=turned_deg - 360.0, nominal=nominal_deg)
    )
    fit = read_marker(path, MIDDLE)
    np.testing.assert_allclose(fit.pose, pose, atol=1e-9)
    # The covariance by finite differences of the inverse.
    forward = np.array([(marker(pose + d) - marker(pose - d)) / 2e-6 for d in 1e-6 * np.eye(3)]).T
    unit = np.array([1.0, 1.0, np.pi / 180.0])
    told = np.array([[1e-8, 0.0, 0.0], [0.0, 4e-8, 1e-6], [0.0, 1e-6, 1e-2]]) * np.outer(unit, unit)
    expected = np.linalg.inv(forward) @ told @ np.linalg.inv(forward).T
    np.testing.assert_allclose(fit.covariance, expected, rtol=1e-5, atol=1e-14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("0.33", "nan"), "measured.x"),
        (("nominal", "nominel"), "nominel"),
        (("x: 0.33", "x: 1e308"), "measured is x 1e\\+308.*; within 10 m"),
        (("yaw_deg: 0.0", "yaw_deg: -1e308"), "measured .*3600 degrees are allowed"),
        (("1.0e-2", "1e308"), "covariance is .*at most 10 m and 3600 degrees"),
        (("[0.0, 4.0e-8, 1.0e-6]", "[5.0e-9, 4.0e-8, 1.0e-6]"), "covariance must be symmetric"),
        (("[0.0, 4.0e-8, 1.0e-6]", "[0.0, 4.0e-8, 1.1e-6]"), "covariance must be symmetric"),
        (("1.0e-2", "-1.0"), "covariance must be symmetric and positive"),
        (("[0.0, 1.0e-6, 1.0e-2]", "[0.0, 1.0e-6]"), "covariance"),
        (("measured:", "measured: ["), "is not YAML"),
        (("measured: {x: 0.33", "measured: {x: 0.43"), "are credible"),
    ],
)
def test_a_bad_marker_is_told(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    path = tmp_path / "marker.yaml"
    text = MARKER.format(x=0.33, y=-0.02, yaw=0.0, nominal=0.0)
    path.write_text(text.replace(*change))
    with pytest.raises(ConfigurationError, match=message):
        read_marker(path, MIDDLE)
    with pytest.raises(NotFoundError):
        read_marker(tmp_path / "none.yaml", MIDDLE)


def test_digits_that_were_rounded_off_a_covariance_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "marker.yaml"
    text = MARKER.format(x=0.33, y=-0.02, yaw=0.0, nominal=0.0)
    exact = read_marker(_written(path, text), MIDDLE).covariance
    rounded = text.replace("[0.0, 4.0e-8, 1.0e-6]", "[1.0e-20, 4.0e-8, 1.000001e-6]")
    assert rounded != text
    np.testing.assert_allclose(
        read_marker(_written(path, rounded), MIDDLE).covariance, exact, rtol=1e-5, atol=1e-16
    )


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path
