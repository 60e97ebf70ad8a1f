"""`calibration.yaml`: what is known of one robot and its scene, with how well it is known.

Imports numpy, the errors and the table of the robot alone, so that whoever uses a calibration needs
nothing of what makes one. Each constant is a value with the ends of its 95 % interval, in absolute
units; what was not measured is marked as assumed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from skewmi.calibration.calibration_parts import (
    Constant,
    RecordingReference,
    SceneCalibration,
    ServoCalibration,
)
from skewmi.calibration.calibration_values import (
    checked_keys,
    mapping_of,
    number_of,
    sequence_of,
    text_of,
)
from skewmi.calibration.egm_part import EgmCalibration
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.outputs import check_output, written_aside
from skewmi.robot_models import yumi
from skewmi.yaml_text import parse_yaml

SCHEMA = "skewmi-calibration-1"
LARGEST_FILE = 100_000
"""Bytes; a calibration has some thousand."""

_KEYS = ("schema", "robot_model", "created", "version", "recordings", "checks", "warnings")
_SECTIONS = ("servo", "egm", "scene")

__all__ = [
    "Calibration",
    "Constant",
    "EgmCalibration",
    "RecordingReference",
    "SceneCalibration",
    "ServoCalibration",
    "read_calibration",
    "write_calibration",
]


@dataclass(frozen=True)
class Calibration:
    """The content of a calibration file.

    Attributes:
        created: When, UTC, ISO 8601.
        version: Of skewmi that made it.
        servo: Of the right arm, whose commands are the servos' targets; None if it was not
            calibrated.
        egm: Of the right arm of a robot whose controller is guided by EGM; None if it is not, or
            was not calibrated. A robot is one or the other.
        scene: Where it stands; None if it was not calibrated.
        recordings: It was made from.
        checks: Figures by name, such as residuals.
        warnings: For whoever uses it, a sentence each.
        robot_model: Hash of the robot's table; that of this skewmi.
    """

    created: str
    version: str
    servo: ServoCalibration | None = None
    scene: SceneCalibration | None = None
    recordings: tuple[RecordingReference, ...] = ()
    checks: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    robot_model: str = yumi.MODEL_HASH
    egm: EgmCalibration | None = None

    def __post_init__(self) -> None:
        if self.robot_model != yumi.MODEL_HASH:
            raise ConfigurationError(
                f"robot_model is {self.robot_model!r}, another robot model than this skewmi's "
                f"{yumi.MODEL_HASH!r}; calibrate again"
            )
        if self.servo is None and self.egm is None and self.scene is None:
            raise ConfigurationError(
                f"it has neither of the sections {', '.join(_SECTIONS)}; one at least must be there"
            )
        if self.servo is not None and self.egm is not None:
            raise ConfigurationError(
                "it has both of the sections servo and egm; a robot's servos follow commands "
                "themselves, or a controller guided by EGM does"
            )
        for name, value in (("created", self.created), ("version", self.version)):
            text_of(value, name)
        for name, figure in self.checks.items():
            number_of(figure, f"checks.{name}")
        for number, warning in enumerate(self.warnings):
            text_of(warning, f"warnings[{number}]")

    def as_mapping(self) -> dict[str, object]:
        """What a file has: mappings, lists, numbers and texts."""
        content: dict[str, object] = {
            "schema": SCHEMA,
            "robot_model": self.robot_model,
            "created": self.created,
            "version": self.version,
            "recordings": [recording.as_mapping() for recording in self.recordings],
        }
        if self.servo is not None:
            content["servo"] = self.servo.as_mapping()
        if self.egm is not None:
            content["egm"] = self.egm.as_mapping()
        if self.scene is not None:
            content["scene"] = self.scene.as_mapping()
        content["checks"] = {name: float(value) for name, value in self.checks.items()}
        content["warnings"] = list(self.warnings)
        return content

    @staticmethod
    def of_mapping(content: object) -> Calibration:
        """Back from `as_mapping`.

        Raises:
            ConfigurationError: A key is unknown or missing, or a value is not allowed.
        """
        entries = mapping_of(content, "the file")
        schema = entries.get("schema")
        if schema != SCHEMA:
            raise ConfigurationError(f"schema is {schema!r}; this skewmi reads {SCHEMA!r}")
        checked_keys(entries, "the file", _KEYS, _SECTIONS)
        checks = mapping_of(entries["checks"], "checks")
        servo, egm, scene = (entries.get(name) for name in _SECTIONS)
        return Calibration(
            created=text_of(entries["created"], "created"),
            version=text_of(entries["version"], "version"),
            robot_model=text_of(entries["robot_model"], "robot_model"),
            servo=None if servo is None else ServoCalibration.of_mapping(servo),
            scene=None if scene is None else SceneCalibration.of_mapping(scene),
            egm=None if egm is None else EgmCalibration.of_mapping(egm),
            recordings=tuple(
                RecordingReference.of_mapping(item, f"recordings[{number}]")
                for number, item in enumerate(sequence_of(entries["recordings"], "recordings"))
            ),
            checks={name: number_of(value, f"checks.{name}") for name, value in checks.items()},
            warnings=tuple(
                text_of(item, f"warnings[{number}]")
                for number, item in enumerate(sequence_of(entries["warnings"], "warnings"))
            ),
        )


def read_calibration(path: str | Path) -> Calibration:
    """Read and check a calibration file.

    Raises:
        NotFoundError: There is no such file.
        ConfigurationError: It cannot be read, is not YAML, is of another schema or robot model,
            or has a key or a value that is not allowed; the message names it.
    """
    try:
        with Path(path).open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
        if len(raw) > LARGEST_FILE:
            raise ConfigurationError(
                f"calibration file {path} is larger than {LARGEST_FILE} bytes: it is none"
            )
        text = raw.decode("utf-8")
    except FileNotFoundError as error:
        raise NotFoundError(f"no calibration file {path}; `skewmi calibrate` makes one") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"calibration file {path} cannot be read: {error}") from error
    content = parse_yaml(text, f"calibration file {path}")
    try:
        return Calibration.of_mapping(content)
    except ConfigurationError as error:
        raise ConfigurationError(f"calibration file {path}: {error}") from error


def write_calibration(path: Path, calibration: Calibration, *, overwrite: bool = False) -> Path:
    """Write a calibration file; it appears when it is whole.

    Returns:
        Where.

    Raises:
        OutputError: It exists and must not be replaced, or cannot be written.
    """
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 100
    target = check_output(path, overwrite=overwrite)
    with written_aside(target) as draft, draft.open("w", encoding="utf-8") as file:
        yaml.dump(calibration.as_mapping(), file)
    return target
