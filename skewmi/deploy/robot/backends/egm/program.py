"""What the RAPID program asks of the controller: the same numbers on both sides.

`rapid/SkewmiEgm.mod` sets these; the bridge reckons with them and the emulator obeys them. A test
keeps the module's text and the defaults here equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite

from skewmi.errors import ConfigurationError

_RANGES = {
    "gain": (0.0, 20.0),
    "low_pass_hz": (0.1, 100.0),
    "ramp_in_s": (0.005, 10.0),
    "comm_timeout_s": (0.02, 60.0),
    "cond_time_s": (0.0, 1e9),
    "convergence_deg": (0.0, 360.0),
    "max_speed_deviation_deg_s": (0.1, 1e6),
    "max_position_deviation_deg": (0.1, 1e6),
}


@dataclass(frozen=True)
class ProgramSettings:
    """Arguments of EGMSetupUC, EGMActJoint and EGMRunJoint, and a system parameter.

    Raises:
        ConfigurationError: A value is outside of what ABB allows.
    """

    gain: float = 20.0
    """`\\PosCorrGain`, 1/s, 0..20 (ABB's default: 5): speed = gain * error + speed reference."""
    low_pass_hz: float = 20.0
    """`\\LpFilter`, Hz, up to 100 (ABB's default: 20): of what comes in."""
    ramp_in_s: float = 0.1
    """`\\RampInTime`, s, 0.005..10 (ABB's default: 0.5): from the start to full tracking."""
    comm_timeout_s: float = 0.1
    """`\\CommTimeout`, s (ABB's default: 1): so long without an answer ends the session."""
    cond_time_s: float = 3600.0
    """`\\CondTime`, s (ABB's default: 1): so long within the convergence limits ends it, too."""
    convergence_deg: float = 0.001
    """Half-width of `egm_minmax`, deg (ABB's default: 0.5)."""
    max_speed_deviation_deg_s: float = 90.0
    """`\\MaxSpeedDeviation`, deg/s (ABB's default: 1): beyond it all joints are slowed down by one
    factor. It must not exceed the slowest axis (180 deg/s)."""
    max_position_deviation_deg: float = 1000.0
    """`\\MaxPosDeviation`, deg (ABB's default: 1000): from where the session began."""
    do_not_restart_after_motors_off: bool = True
    """The system parameter of that name (ABB's default: False): with False, corrections go on in
    the same session when motors that went off come on again."""

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not (isfinite(value) and low <= value <= high):
                raise ConfigurationError(
                    f"EGM {name} is {value:g}; it must be in {low:g}..{high:g}"
                )

    def runs_on_s(self, feed_forward: float) -> float:
        """How far the arm runs on if no reference comes any more, as time at its present speed.

        The controller keeps both parts of the last reference: its desired position approaches
        ref + speed_ref / k, until `\\CommTimeout` ends the session:

            d(t) - ref = f v / k (1 - exp(-k t)),   at k = 0: f v t

        with f the fraction of the speed that was sent as speed reference. Beyond this the arm
        only needs what it takes to stop.

        Args:
            feed_forward: f, 0..1.

        Returns:
            s; times the speed of a joint or of the flange it is the distance.
        """
        if self.gain == 0.0:
            return feed_forward * self.comm_timeout_s
        return feed_forward / self.gain * (1.0 - exp(-self.gain * self.comm_timeout_s))
