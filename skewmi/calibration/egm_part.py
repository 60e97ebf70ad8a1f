"""The section of a calibration file on a robot whose controller is guided by EGM."""

from __future__ import annotations

from dataclasses import dataclass

from skewmi.calibration.calibration_parts import Constant, ServoCalibration
from skewmi.calibration.calibration_values import checked_keys, mapping_of, number_of
from skewmi.errors import ConfigurationError

EGM_CONSTANTS: dict[str, tuple[int, float]] = {
    "gain": (1, 0.0),
    "low_pass_hz": (1, 0.0),
    "lag_ms": (7, -1e9),
}
"""Name -> entries, and the smallest that is allowed."""


@dataclass(frozen=True)
class EgmCalibration:
    """What a controller makes of its references, and the servos of the right arm behind it.

    Attributes:
        period_ms: Of its cycle, ms.
        speed_share: Part of the plan's speed that it was sent as speed reference, 0..1.
        gain: k in speed = low-pass(k (reference - desired) + speed reference), 1/s; of all joints.
        low_pass_hz: Corner of that low-pass, Hz; of all joints.
        lag_ms: How late each joint is behind its reference at a steady speed whose reference is
            sent whole, ms: network, reading, lag and servo together.
        servo: Behind the law. Its `delay_ms` is the lag that all joints share: from when a
            reference is for until what the law makes of it is the servos' target, ms. That is
            ahead by a cycle at a steady speed, which `lag_ms` is less by.
    """

    period_ms: float
    speed_share: float
    gain: Constant
    low_pass_hz: Constant
    lag_ms: Constant
    servo: ServoCalibration

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("period_ms", self.period_ms, 1.0, 50.0),
            ("speed_share", self.speed_share, 0.0, 1.0),
        ):
            if not low <= value <= high:
                raise ConfigurationError(f"egm.{name} is {value}; it must be in {low:g}..{high:g}")
        for name, (size, least) in EGM_CONSTANTS.items():
            constant: Constant = getattr(self, name)
            if len(constant.value) != size or min(constant.low) < least:
                raise ConfigurationError(
                    f"egm.{name} has {len(constant.value)} entries from {min(constant.low)}; "
                    f"it must have {size}, none below {least:g}"
                )

    def as_mapping(self) -> dict[str, object]:
        found: dict[str, object] = {
            "period_ms": float(self.period_ms),
            "speed_share": float(self.speed_share),
        }
        found |= {name: getattr(self, name).as_mapping() for name in EGM_CONSTANTS}
        return found | {"servo": self.servo.as_mapping()}

    @staticmethod
    def of_mapping(content: object) -> EgmCalibration:
        entries = mapping_of(content, "egm")
        checked_keys(entries, "egm", ("period_ms", "speed_share", *EGM_CONSTANTS, "servo"))
        try:
            servo = ServoCalibration.of_mapping(entries["servo"])
        except ConfigurationError as error:
            raise ConfigurationError(f"in egm, {error}") from error
        return EgmCalibration(
            period_ms=number_of(entries["period_ms"], "egm.period_ms"),
            speed_share=number_of(entries["speed_share"], "egm.speed_share"),
            **{
                name: Constant.of_mapping(entries[name], f"egm.{name}", size, least)
                for name, (size, least) in EGM_CONSTANTS.items()
            },
            servo=servo,
        )
