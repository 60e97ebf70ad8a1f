"""What program and configuration ask of the controller: the same numbers on both sides.

`rapid/` sets these; the bridge reckons with them and the emulator obeys them. A test keeps the
texts there and the defaults here equal. "Manual" is ABB's 3HAC073318 of RobotWare 7.16.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from skewmi.deploy.robot.backends.egm.run_on import bound, remembered_cycles
from skewmi.errors import ConfigurationError

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
        """Bound on how far the arm runs on if no reference comes any more: s, see `run_on`."""
        return bound(self, feed_forward)

    @property
    def remembered_cycles(self) -> int:
        """How far back references have a say in the controller's speed: five time constants."""
        return remembered_cycles(self)
