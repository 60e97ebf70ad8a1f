"""What program and configuration ask of the controller: the same numbers on both sides.

`rapid/` sets these; the bridge reckons with them and the emulator obeys them. A test keeps the
texts there and the defaults here equal. "Manual" is ABB's 3HAC073318 of RobotWare 7.16.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, pi

from skewmi.errors import ConfigurationError

CYCLE_S = 0.004032
"""Of a real controller."""

_STEP_S = 1e-4
"""Of the integration."""

_RANGES = {
    "gain": (0.0, 20.0),
    "low_pass_hz": (0.1, 100.0),
    "ramp_in_s": (0.005, 10.0),
    "ramp_out_s": (0.005, 10.0),
    "comm_timeout_s": (0.02, 60.0),
    "cond_time_s": (0.0, 1e9),
    "convergence_deg": (0.0, 360.0),
    "max_speed_deviation_deg_s": (0.1, 1e6),
    "max_position_deviation_deg": (0.1, 1e6),
}


@dataclass(frozen=True)
class ProgramSettings:
    """Arguments of EGMSetupUC, EGMActJoint and EGMRunJoint, and system parameters.

    Raises:
        ConfigurationError: A value is outside of what ABB allows.
    """

    gain: float = 20.0
    """Default Proportional Position Gain, 1/s, 0..20 (ABB's default: 5), times `\\PosCorrGain`
    (0..1, default 1): k in speed = k * error + speed reference (manual, p. 26)."""
    low_pass_hz: float = 20.0
    """`\\LpFilter`, Hz, up to 100 (ABB's default: 20): of the speed that comes of it (p. 29)."""
    ramp_in_s: float = 0.1
    """`\\RampInTime`, s, 0.005..10: from the start of a session to full tracking (p. 72)."""
    ramp_out_s: float = 0.1
    """Default Ramp Time, s, 0.005..10 (ABB's default: 0.5): in which the speed goes to zero when
    a session ends (p. 46)."""
    comm_timeout_s: float = 0.1
    """`\\CommTimeout`, s (usual: 1): so long without an answer ends the session."""
    cond_time_s: float = 3600.0
    """`\\CondTime`, s (ABB's default: 1): so long within the convergence limits ends it, too."""
    convergence_deg: float = 0.001
    """Half-width of `egm_minmax`, deg (ABB's default: 0.5)."""
    max_speed_deviation_deg_s: float = 90.0
    """`\\MaxSpeedDeviation`, deg/s (ABB's default: 1): beyond it all joints are slowed down by one
    factor (p. 52). ABB's own programs keep it below the slowest axis, 180 deg/s."""
    max_position_deviation_deg: float = 1000.0
    """`\\MaxPosDeviation`, deg (ABB's default: 1000): from where the session began."""
    do_not_restart_after_motors_off: bool = True
    """The system parameter of that name (ABB's default: False): with False, corrections go on in
    the same session when motors that went off come on again (p. 44)."""

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not (isfinite(value) and low <= value <= high):
                raise ConfigurationError(
                    f"EGM {name} is {value:g}; it must be in {low:g}..{high:g}"
                )

    def runs_on_s(self, feed_forward: float) -> float:
        """How far the arm runs on if no reference comes any more, as time at its present speed.

        The controller keeps both parts of the last reference. With e the desired position less
        that reference, s the speed, tau the low-pass' time constant and f the fraction of the
        speed v that was sent as speed reference,

            e' = s,   tau s' = f v - k e - s

        until `\\CommTimeout` T (and a cycle: it is counted in those) ends the session; then what
        is left of s goes to zero in the ramp-out time R. It begins between a motion's first
        moments (e = 0, s = f v) and a steady one (e = -(1 - f) v / k, s = v); the worse counts.
        With f = 1, and but for the low-pass, this is v ((1 - exp(-k T)) / k + exp(-k T) R / 2).

        Args:
            feed_forward: f, 0..1.

        Returns:
            s, not negative; times the speed of a joint or of the flange it is the distance.
        """
        steady = -(1.0 - feed_forward) / self.gain if self.gain > 0.0 else 0.0
        return max(
            self._runs_on_from(0.0, feed_forward, feed_forward),
            self._runs_on_from(steady, 1.0, feed_forward),
        )

    def _runs_on_from(self, error: float, speed: float, feed_forward: float) -> float:
        """The farthest that e becomes from where it is now, at v = 1."""
        tau = 1.0 / (2.0 * pi * self.low_pass_hz)
        farthest = 0.0
        for _ in range(round((self.comm_timeout_s + CYCLE_S) / _STEP_S)):
            # Semi-implicit Euler: stable at these steps for all that ABB allows.
            speed += _STEP_S / tau * (feed_forward - self.gain * error - speed)
            error += _STEP_S * speed
            farthest = max(farthest, error)
        return max(farthest, error + speed * self.ramp_out_s / 2.0)
