"""Where the box stands, told otherwise than by touching: points of its faces, or a marker on it.

Both files are described in `docs/calibration-scene.md`.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from math import cos, sin
from pathlib import Path

import numpy as np

from skewmi.calibration.calibration_values import (
    checked_keys,
    mapping_of,
    number_of,
    sequence_of,
)
from skewmi.calibration.scene_faces import FACES, Face
from skewmi.calibration.scene_fit import SceneFit, Touch, require_credible
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.robot_models.yumi import Array
from skewmi.yaml_text import parse_yaml

POINT_SIGMA = 0.1e-3
"""Of a point that was touched with a hand-guided arm, by itself, m."""
POINTS_SIGMA = 0.1e-3
"""Of what all of them have in common along each axis, m: the probe, the arm's kinematics."""
COLUMNS = ("face", "x", "y", "z")
LARGEST_FILE = 100_000
MOST_POINTS = 1000
LARGEST = 10.0
"""Of a coordinate, m: no arm reaches so far, and arithmetic with much larger ones breaks down."""
LARGEST_YAW_DEG = 3600.0
"""Of a marker: some turns more or less are the same yaw."""
ASYMMETRY = 1e-6
"""Of a covariance, as a part of what its two deviations allow: digits that were rounded off."""


def read_points(path: str | Path, faces: Mapping[str, Face]) -> list[Touch]:
    """Points of faces from a CSV file.

    Args:
        path: Of the file: a line `face,x,y,z`, then one per point, in m, robot base frame.
        faces: By name, where the box is believed to stand.

    Raises:
        NotFoundError: There is no such file.
        ConfigurationError: A line is not as above; the message names it.
    """
    lines = _text(path, "points file").splitlines()
    rows = csv.reader(lines)
    header = next(rows, [])
    if tuple(cell.strip() for cell in header) != COLUMNS:
        raise ConfigurationError(
            f"points file {path}: its first line is {','.join(header)!r}; it must be "
            f"{','.join(COLUMNS)!r}"
        )
    touches = []
    for row in rows:
        if not any(cell.strip() for cell in row):
            continue
        where = f"points file {path}, line {rows.line_num}"
        if len(row) != len(COLUMNS):
            raise ConfigurationError(f"{where}: {len(row)} values; there must be {len(COLUMNS)}")
        name = row[0].strip()
        if name not in faces:
            raise ConfigurationError(
                f"{where}: face {name!r}; it must be one of {', '.join(FACES)}"
            )
        try:
            point = np.array([float(cell) for cell in row[1:]])
        except ValueError as error:
            raise ConfigurationError(f"{where}: {error}") from error
        if not np.isfinite(point).all():
            raise ConfigurationError(f"{where}: {row[1:]} must be finite numbers")
        if np.abs(point).max() > LARGEST:
            raise ConfigurationError(
                f"{where}: {row[1:]} must be in m, at most {LARGEST:g} either way"
            )
        touches.append(_point(faces[name], point))
    if len(touches) > MOST_POINTS:
        raise ConfigurationError(
            f"points file {path} has {len(touches)} points; {MOST_POINTS} at most are read"
        )
    return touches


def read_marker(path: str | Path, middle: tuple[float, float]) -> SceneFit:
    """Where the box stands, from a marker on it.

    Args:
        path: Of a YAML file: `measured` and `nominal`, each x, y (m) and yaw_deg in the robot base
            frame, and the `covariance` of the first.
        middle: Of the box's footprint, which it turns about, m.

    Raises:
        NotFoundError: There is no such file.
        ConfigurationError: It is not as above, or the box would be beyond belief.
    """
    content = parse_yaml(_text(path, "marker file"), f"marker file {path}")
    try:
        entries = mapping_of(content, "the file")
        checked_keys(entries, "the file", ("measured", "nominal", "covariance"))
        measured, nominal = (_planar(entries[name], name) for name in ("measured", "nominal"))
        covariance = _covariance(entries["covariance"])
        fit = _from_marker(measured, nominal, covariance, np.array(middle))
        require_credible(fit.pose)
    except ConfigurationError as error:
        raise ConfigurationError(f"marker file {path}: {error}") from error
    return fit


def _from_marker(measured: Array, nominal: Array, covariance: Array, middle: Array) -> SceneFit:
    """p = m + t + R(yaw) (p_nominal - m), solved for t."""
    yaw = float((measured[2] - nominal[2] + np.pi) % (2.0 * np.pi) - np.pi)
    arm = nominal[:2] - middle
    turned = np.array(
        [cos(yaw) * arm[0] - sin(yaw) * arm[1], sin(yaw) * arm[0] + cos(yaw) * arm[1]]
    )
    slope = np.eye(3)
    slope[:2, 2] = turned[1], -turned[0]
    pose = np.array([*(measured[:2] - middle - turned), yaw])
    return SceneFit(pose, slope @ covariance @ slope.T, np.zeros(0), np.zeros((0, 3)), 0.0)


def _point(face: Face, point: Array) -> Touch:
    common = -POINTS_SIGMA * face.normal
    return Touch(face, point[None], common, POINT_SIGMA)


def _planar(content: object, where: str) -> Array:
    entries = mapping_of(content, where)
    checked_keys(entries, where, ("x", "y", "yaw_deg"))
    x, y, yaw_deg = (number_of(entries[name], f"{where}.{name}") for name in ("x", "y", "yaw_deg"))
    if max(abs(x), abs(y)) > LARGEST or abs(yaw_deg) > LARGEST_YAW_DEG:
        raise ConfigurationError(
            f"{where} is x {x:g}, y {y:g}, yaw_deg {yaw_deg:g}; within {LARGEST:g} m and "
            f"{LARGEST_YAW_DEG:g} degrees are allowed"
        )
    return np.array([x, y, np.radians(yaw_deg)])


def _covariance(content: object) -> Array:
    """Of x (m), y (m), yaw: degrees in the file, radians here."""
    rows = np.array(
        [
            [number_of(item, "covariance") for item in sequence_of(row, "covariance", 3)]
            for row in sequence_of(content, "covariance", 3)
        ]
    )
    most = np.array([LARGEST, LARGEST, LARGEST_YAW_DEG])
    if (np.abs(rows) > np.outer(most, most)).any():
        raise ConfigurationError(
            f"covariance is {rows.tolist()}; standard deviations of at most {LARGEST:g} m and "
            f"{LARGEST_YAW_DEG:g} degrees are allowed"
        )
    # Covariances are tiny numbers: what is a small difference depends on the variances alone.
    deviations = np.sqrt(np.diag(rows).clip(min=0.0))
    allowed = ASYMMETRY * np.outer(deviations, deviations)
    if (np.abs(rows - rows.T) > allowed).any() or np.linalg.eigvalsh(rows).min() <= 0.0:
        raise ConfigurationError(
            "covariance must be symmetric and positive: of x (m), y (m) and yaw (degrees)"
        )
    scale = np.array([1.0, 1.0, np.pi / 180.0])
    return np.asarray(rows * np.outer(scale, scale))


def _text(path: str | Path, what: str) -> str:
    try:
        with Path(path).open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
        if len(raw) > LARGEST_FILE:
            raise ConfigurationError(f"{what} {path} is larger than {LARGEST_FILE} bytes")
        return raw.decode("utf-8-sig")
    except FileNotFoundError as error:
        raise NotFoundError(f"no {what} {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{what} {path} cannot be read: {error}") from error
