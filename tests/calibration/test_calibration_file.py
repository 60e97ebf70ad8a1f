"""What is written is read back; every key and value that is not allowed is refused by its name."""

from __future__ import annotations

import copy
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from calibrations import full_calibration
from ruamel.yaml import YAML

from skewmi.calibration.calibration_file import (
    LARGEST_FILE,
    Calibration,
    Constant,
    read_calibration,
    write_calibration,
)
from skewmi.errors import ConfigurationError, NotFoundError, OutputError
from skewmi.robot_models import yumi

CONTENT = dict(full_calibration().as_mapping())


def content() -> dict[str, Any]:
    return copy.deepcopy(CONTENT)


def places(value: object, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Ways to every mapping, list and leaf."""
    yield path
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from places(item, (*path, index))


def at(value: Any, path: tuple[Any, ...]) -> Any:
    for step in path:
        value = value[step]
    return value


def refused(changed: object, match: str = ".") -> None:
    with pytest.raises(ConfigurationError, match=match):
        Calibration.of_mapping(changed)


def test_a_written_calibration_is_read_back_to_the_last_bit(tmp_path: Path) -> None:
    calibration = full_calibration()
    path = write_calibration(tmp_path / "new" / "cal.yaml", calibration)
    assert read_calibration(path) == calibration
    before = path.read_bytes()
    with pytest.raises(OutputError, match="exists"):
        write_calibration(path, calibration)
    write_calibration(path, calibration, overwrite=True)
    assert path.read_bytes() == before


@pytest.mark.parametrize("section", ["servo", "scene"])
def test_one_section_is_enough_and_none_is_not(section: str) -> None:
    one = content()
    del one[section]
    assert Calibration.of_mapping(one).as_mapping() == one
    refused({key: value for key, value in one.items() if key not in ("servo", "scene")}, "neither")


def test_an_unknown_key_is_refused_in_every_mapping() -> None:
    mappings = [path for path in places(CONTENT) if isinstance(at(CONTENT, path), dict)]
    for path in mappings:
        if path == ("checks",):
            continue  # Figures have names of their own.
        changed = content()
        at(changed, path)["stiffness"] = 1.0
        refused(changed, "unknown key 'stiffness'; allowed: ")
    assert len(mappings) > 12


def test_every_key_is_needed_but_the_sections() -> None:
    count = 0
    for path in places(CONTENT):
        if path and isinstance(path[-1], str) and path not in (("servo",), ("scene",)):
            if path[0] == "checks" and len(path) == 2:
                continue
            changed = content()
            del at(changed, path[:-1])[path[-1]]
            refused(changed)
            count += 1
    assert count > 50


@pytest.mark.parametrize("bad", [None, "x" * 200, math.nan, math.inf, [], {}, {1: 2}, [[1.0]]])
def test_no_number_may_be_anything_else(bad: object) -> None:
    for path in places(CONTENT):
        if isinstance(at(CONTENT, path), float):
            changed = content()
            at(changed, path[:-1])[path[-1]] = bad
            refused(changed)


@pytest.mark.parametrize("bad", [None, 0, 1.5, "", "  ", True, []])
def test_no_text_may_be_anything_else(bad: object) -> None:
    for path in places(CONTENT):
        if isinstance(at(CONTENT, path), str):
            changed = content()
            at(changed, path[:-1])[path[-1]] = bad
            refused(changed)


def test_values_must_lie_in_their_intervals_and_may_not_be_negative() -> None:
    for path in places(CONTENT):
        if path and path[-1] in ("low", "high") and path[0] == "servo":
            many = isinstance(at(CONTENT, path), list)
            for bad in (-1.0, 99.0):
                changed = content()
                holder, key = (at(changed, path), 3) if many else (at(changed, path[:-1]), path[-1])
                if (path[-1] == "low" and bad == 99.0) or bad == -1.0:
                    holder[key] = bad
                    refused(changed, f"{path[0]}.{path[1]}")
    with pytest.raises(ConfigurationError, match="must be as many"):
        Constant((1.0,), (1.0, 2.0), (1.0,), (False,))


def test_another_robot_schema_or_arm_is_refused() -> None:
    for key, value, word in (
        ("schema", "skewmi-calibration-2", "skewmi-calibration-1"),
        ("robot_model", "0" * 64, yumi.MODEL_HASH),
    ):
        refused(content() | {key: value}, word)
    changed = content()
    changed["servo"]["joints"] = changed["servo"]["joints"][::-1]
    refused(changed, "servo.joints")
    changed = content()
    changed["recordings"][0]["sha256"] = "0" * 63
    refused(changed, "64 hexadecimal")
    for covariance in ([[1.0, 0, 0]], [[1.0, 2, 0], [0, 1, 0], [0, 0, 1]], [[-1.0, 0, 0]] * 3):
        changed = content()
        changed["scene"]["covariance"] = covariance
        refused(changed, "covariance")


@pytest.mark.parametrize(
    ("raw", "match"),
    [
        (b"schema: [", "is not YAML"),
        (b"\xff\xfe\x00", "cannot be read"),
        (b"", "must map names"),
        (b"- 1\n", "must map names"),
        (b"schema: a\nschema: b\n", "is not YAML"),
        (b"!!python/object/apply:os.system ['false']", "is not YAML"),
        (b"#" * (LARGEST_FILE + 1), "larger than"),
        (b"schema: [&a [1], [*a, *a]]", "aliases"),
        (b"schema: 0x" + b"f" * 5000, "a number of more than"),
    ],
)
def test_what_is_no_calibration_is_refused_by_its_path(
    raw: bytes, match: str, tmp_path: Path
) -> None:
    path = tmp_path / "cal.yaml"
    path.write_bytes(raw)
    with pytest.raises(ConfigurationError, match=match) as raised:
        read_calibration(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_missing_file_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="skewmi calibrate"):
        read_calibration(tmp_path / "none.yaml")
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_calibration(tmp_path)


def test_the_file_is_plain_yaml_of_absolute_units(tmp_path: Path) -> None:
    path = write_calibration(tmp_path / "cal.yaml", full_calibration())
    assert YAML(typ="safe").load(path.read_text("utf-8")) == full_calibration().as_mapping()


def test_reading_a_calibration_needs_nothing_of_making_one() -> None:
    program = (
        "import sys, skewmi.calibration.calibration_file; "
        "print(sorted({'mujoco', 'scipy', 'torch', 'zenoh'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
