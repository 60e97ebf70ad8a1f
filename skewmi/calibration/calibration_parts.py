"""The sections of a calibration file: constants with intervals, servo, scene, recordings."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from skewmi.calibration.calibration_values import (
    checked_keys,
    flag_of,
    mapping_of,
    number_of,
    sequence_of,
    text_of,
)
from skewmi.errors import ConfigurationError
from skewmi.robot_models import yumi

_JOINTS = 7
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Constant:
    """One number or one per joint, with the ends of its 95 % interval: low <= value <= high.

    Attributes:
        value, low, high: In the unit that the field's description says; one entry, or seven in
            chain order.
        assumed: Which were not measured but taken from the nominal model.
    """

    value: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    assumed: tuple[bool, ...]

    def __post_init__(self) -> None:
        if not len(self.value) == len(self.low) == len(self.high) == len(self.assumed):
            raise ConfigurationError(
                f"value, low, high and assumed have {len(self.value)}, {len(self.low)}, "
                f"{len(self.high)} and {len(self.assumed)} entries; they must be as many"
            )
        for low, value, high in zip(self.low, self.value, self.high, strict=True):
            if not (low <= value <= high and math.isfinite(high - low)):
                raise ConfigurationError(
                    f"low, value, high are {low}, {value}, {high}; they must be finite and rise"
                )

    @staticmethod
    def known(value: float) -> Constant:
        """One number that is assumed."""
        return Constant((value,), (value,), (value,), (True,))

    def as_mapping(self) -> dict[str, object]:
        parts = {"value": self.value, "low": self.low, "high": self.high}
        one = len(self.value) == 1
        found: dict[str, object] = {
            name: float(part[0]) if one else [float(x) for x in part]
            for name, part in parts.items()
        }
        found["assumed"] = bool(self.assumed[0]) if one else [bool(x) for x in self.assumed]
        return found

    @staticmethod
    def of_mapping(content: object, where: str, size: int, least: float = -math.inf) -> Constant:
        """Back from `as_mapping`.

        Args:
            content: Of the file.
            where: It stands, for messages.
            size: Entries: 1 or 7.
            least: Allowed.
        """
        entries = mapping_of(content, where)
        checked_keys(entries, where, ("value", "low", "high", "assumed"))

        def items(name: str) -> list[object]:
            place, given = f"{where}.{name}", entries[name]
            return [given] if size == 1 else sequence_of(given, place, size)

        numbers = {
            name: tuple(number_of(item, f"{where}.{name}") for item in items(name))
            for name in ("value", "low", "high")
        }
        if min(numbers["low"]) < least:
            raise ConfigurationError(
                f"{where}.low is {min(numbers['low'])}; it must be {least:g} at least"
            )
        assumed = tuple(flag_of(item, f"{where}.assumed") for item in items("assumed"))
        try:
            return Constant(**numbers, assumed=assumed)
        except ConfigurationError as error:
            raise ConfigurationError(f"{where}: {error}") from error


@dataclass(frozen=True)
class ServoCalibration:
    """The servos of the right arm, seven numbers each but the delay.

    Attributes:
        kp: Stiffness, N m/rad.
        kd: Damping, N m s/rad.
        frictionloss: Dry friction, N m; in motion, if joints stick.
        armature: Rotor inertia at the joint, kg m^2.
        kd_over_kp: How far an arm without feed-forward is behind its command, s.
        frictionloss_over_kp: How far friction holds a joint off its command, rad.
        delay_ms: From when a command is due until it is the servos' target, ms.
        stiction: How much more friction joints have at rest, N m; None if none was found.
        stribeck_velocity: At which that has mostly gone, rad/s; None with it.

    Where the motion did not tell stiffness and damping (of a wrist whose armature is unknown, say)
    their intervals are wide, and the ratios, which are what feed-forward needs, stay narrow.
    """

    kp: Constant
    kd: Constant
    frictionloss: Constant
    armature: Constant
    kd_over_kp: Constant
    frictionloss_over_kp: Constant
    delay_ms: Constant
    stiction: Constant | None = None
    stribeck_velocity: Constant | None = None

    def __post_init__(self) -> None:
        if (self.stiction is None) != (self.stribeck_velocity is None):
            raise ConfigurationError(
                "servo has one of stiction and stribeck_velocity; give both or neither"
            )
        for name, (size, least) in (SERVO_CONSTANTS | STICTION_CONSTANTS).items():
            constant: Constant | None = getattr(self, name)
            if constant is None:
                continue
            if len(constant.value) != size or min(constant.low) < least:
                raise ConfigurationError(
                    f"servo.{name} has {len(constant.value)} entries from {min(constant.low)}; "
                    f"it must have {size}, none below {least:g}"
                )

    def as_mapping(self) -> dict[str, object]:
        found: dict[str, object] = {"joints": list(yumi.joint_names("right"))}
        constants = {name: getattr(self, name) for name in SERVO_CONSTANTS | STICTION_CONSTANTS}
        return found | {n: c.as_mapping() for n, c in constants.items() if c is not None}

    @staticmethod
    def of_mapping(content: object) -> ServoCalibration:
        entries = mapping_of(content, "servo")
        checked_keys(entries, "servo", ("joints", *SERVO_CONSTANTS), tuple(STICTION_CONSTANTS))
        expected = list(yumi.joint_names("right"))
        if sequence_of(entries["joints"], "servo.joints") != expected:
            raise ConfigurationError(
                f"servo.joints is {entries['joints']!r}; it must be {expected!r}"
            )
        return ServoCalibration(
            **{
                name: Constant.of_mapping(entries[name], f"servo.{name}", size, least)
                for name, (size, least) in (SERVO_CONSTANTS | STICTION_CONSTANTS).items()
                if name in entries
            }
        )


SERVO_CONSTANTS: dict[str, tuple[int, float]] = {
    "kp": (_JOINTS, 0.0),
    "kd": (_JOINTS, 0.0),
    "frictionloss": (_JOINTS, 0.0),
    "armature": (_JOINTS, 0.0),
    "kd_over_kp": (_JOINTS, 0.0),
    "frictionloss_over_kp": (_JOINTS, 0.0),
    "delay_ms": (1, 0.0),
}
"""Name -> entries, and the smallest that is allowed."""
STICTION_CONSTANTS: dict[str, tuple[int, float]] = {
    "stiction": (_JOINTS, 0.0),
    "stribeck_velocity": (_JOINTS, 1e-6),
}
"""The same of those that are there if joints stick."""


@dataclass(frozen=True)
class SceneCalibration:
    """Where the scene's box stands, less where it is believed to stand, and the lid's bias.

    Attributes:
        x, y: m, task world.
        yaw_deg: About the vertical, degrees.
        lid_bias_deg: Reading of the lid's sensor where it is shut, degrees.
        covariance: Of x (m), y (m) and yaw (deg). 3 by 3, symmetric.
    """

    x: Constant
    y: Constant
    yaw_deg: Constant
    lid_bias_deg: Constant
    covariance: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        rows = self.covariance
        if len(rows) != 3 or any(len(row) != 3 for row in rows):
            raise ConfigurationError("scene.covariance must be 3 lists of 3 numbers")
        if any(rows[i][j] != rows[j][i] or rows[i][i] < 0.0 for i in range(3) for j in range(3)):
            raise ConfigurationError(
                f"scene.covariance is {rows}; it must be symmetric, its diagonal not negative"
            )

    def as_mapping(self) -> dict[str, object]:
        found: dict[str, object] = {n: getattr(self, n).as_mapping() for n in _SCENE_CONSTANTS}
        found["covariance"] = [[float(x) for x in row] for row in self.covariance]
        return found

    @staticmethod
    def of_mapping(content: object) -> SceneCalibration:
        entries = mapping_of(content, "scene")
        checked_keys(entries, "scene", (*_SCENE_CONSTANTS, "covariance"))
        rows = sequence_of(entries["covariance"], "scene.covariance", 3)
        return SceneCalibration(
            **{
                name: Constant.of_mapping(entries[name], f"scene.{name}", 1)
                for name in _SCENE_CONSTANTS
            },
            covariance=tuple(
                tuple(
                    number_of(item, "scene.covariance")
                    for item in sequence_of(row, "scene.covariance", 3)
                )
                for row in rows
            ),
        )


_SCENE_CONSTANTS = ("x", "y", "yaw_deg", "lid_bias_deg")


@dataclass(frozen=True)
class RecordingReference:
    """A recording that a calibration was made from."""

    file: str
    """Its name, without folder."""
    sha256: str
    """Of its content, hexadecimal."""

    def __post_init__(self) -> None:
        if not _SHA256.fullmatch(self.sha256):
            raise ConfigurationError(
                f"sha256 of recording {self.file!r} is {self.sha256!r}; it must be 64 hexadecimal "
                "digits"
            )

    def as_mapping(self) -> dict[str, object]:
        return {"file": self.file, "sha256": self.sha256}

    @staticmethod
    def of_mapping(content: object, where: str) -> RecordingReference:
        entries = mapping_of(content, where)
        checked_keys(entries, where, ("file", "sha256"))
        return RecordingReference(
            text_of(entries["file"], f"{where}.file"), text_of(entries["sha256"], f"{where}.sha256")
        )
