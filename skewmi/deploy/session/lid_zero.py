"""The zero of the scene's hinges: what a sensor reads where its lid is shut."""

from __future__ import annotations

from collections.abc import Mapping

from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.calibration_use import LARGEST_LID_BIAS, lid_bias
from skewmi.policy_io import PolicyLayout


class LidZero:
    """Takes the bias of a hinge's sensor off its readings.

    It is what the calibration says, or else the first reading of each episode: there the lid is
    shut. A lid that is more than 20 degrees open there is not: then nothing is taken off.

    Args:
        known: Of the scene, or of the servos alone.
        layout: Of the policy; its angles are those of hinges, shut at their lower end.
    """

    def __init__(self, known: Calibration, layout: PolicyLayout) -> None:
        self._bias = lid_bias(known)
        self._shut = {field.name: field.low for field in layout.observation if field.unit == "rad"}
        self._zero = dict.fromkeys(self._shut, self._bias or 0.0)

    def begin(self, values: Mapping[str, float]) -> None:
        """An episode begins with this reading, by observation field."""
        if self._bias is not None:
            return
        for name, shut in self._shut.items():
            off = values.get(name, shut) - shut
            self._zero[name] = off if abs(off) <= LARGEST_LID_BIAS else 0.0

    def taken_off(self, values: Mapping[str, float]) -> dict[str, float]:
        """The readings, from their zero."""
        return {name: value - self._zero.get(name, 0.0) for name, value in values.items()}
