"""Joint motion that shows what the servos are: sines of many frequencies at once, within limits.

Each joint moves as

    q_j(t) = c_j + s_j w(t) sum_k sin(W_jk t + phi_jk) / ((1 + W_jk X_j / V_j) (1 + W_jk V_j / A_j))

around a centre c. The window w rises from 0 to 1 and falls again with three derivatives that vanish
at its ends, so that the motion begins and ends at rest. X_j, V_j, A_j are how far, how fast and how
suddenly the joint may move: the tones' positions are equal at low frequencies W, their velocities
at middle ones and their accelerations at high ones, so that all three limits are used. All
derivatives are exact, and linear in the scales s_j: the scales are what the limits allow.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, pi

import numpy as np

from skewmi.calibration.clear_space import ClearSpace
from skewmi.errors import ConfigurationError
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_TICKS, GRID_S, Array, JointTrajectory

TONES = 8
"""Sines per joint; joints have different frequencies, so that their motions do not look alike."""
BAND_HZ = (0.15, 7.0)
"""Lowest and highest frequency. Friction shows where a joint turns round, stiffness and damping
where it accelerates."""
REST_S = 0.3
"""Standing still before and after the motion, s."""
RAMP_S = 1.5
"""Rise and fall of the window, s."""
SHORTEST_S = 4.0
LONGEST_S = 600.0
TCP_SPEED = 0.25
"""Largest speed of the flange, m/s: what robot servers allow (reduced speed of ISO 10218-1)."""
EXCURSION = 0.3
"""Default of how far a joint goes from the centre, rad."""
MARGIN = 0.97
"""Part of each limit that is used. Between two samples a sine of 7 Hz rises 0.4 % above them."""
_SHRINK, _SHRINKINGS = 0.8, 12


@dataclass(frozen=True)
class Excitation:
    """What a motion is asked to be.

    Attributes:
        seconds: Length, standing still at both ends included, s.
        seed: Of frequencies and phases.
        joints: Which joints move. Shape (7,), chain order.
        excursion: Largest distance of a joint from the centre, rad.
        tcp_speed: Largest speed of the flange, m/s.
    """

    seconds: float = 60.0
    seed: int = 0
    joints: tuple[bool, ...] = (True,) * 7
    excursion: float = EXCURSION
    tcp_speed: float = TCP_SPEED

    def __post_init__(self) -> None:
        if not SHORTEST_S <= self.seconds <= LONGEST_S:
            raise ConfigurationError(
                f"an excitation of {self.seconds} s; it must be {SHORTEST_S:g} to {LONGEST_S:g} s"
            )
        if self.seed < 0:
            raise ConfigurationError(f"seed is {self.seed}; it must be a whole number from 0")
        if len(self.joints) != 7 or not any(self.joints):
            raise ConfigurationError(
                f"joints that move: {self.joints}; give seven, at least one of them true"
            )
        for name in ("excursion", "tcp_speed"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0.0):
                raise ConfigurationError(f"{name} is {value}; it must be positive")

    def motion(
        self, centre: Array, limits: JointLimits, space: ClearSpace | None = None
    ) -> JointTrajectory:
        """The motion around a configuration.

        Args:
            centre: Where it begins and ends, rad. Shape (7,).
            limits: Kept by every sample and between samples.
            space: What the arm stays clear of; the robot itself and the table if not given.

        Returns:
            Samples 4 ms apart.

        Raises:
            ConfigurationError: The centre is outside the limits or not clear, or there is no
                room to move around it.
        """
        centre = np.array(centre, dtype=np.float64)
        room = np.minimum(centre - limits.position_lower, limits.position_upper - centre)
        if centre.shape != (7,) or not (room > 0.0).all():
            raise ConfigurationError(
                f"the centre {centre.tolist()} must be 7 angles inside the limits "
                f"{limits.position_lower.tolist()} to {limits.position_upper.tolist()}"
            )
        space = ClearSpace() if space is None else space
        touch = space.first_touch(centre[None])
        if touch is not None:
            raise ConfigurationError(
                f"the centre of the excitation is not clear: {touch[1]}; give another"
            )
        shapes = _shapes(self, limits, _reach(centre))
        scale = _joint_scales(shapes, limits, np.minimum(room, self.excursion))
        scale = _slowed(shapes, scale, centre, self.tcp_speed)
        for _ in range(_SHRINKINGS):
            q, v, a, _ = scale * shapes
            q += centre
            touch = space.first_touch(q[::CYCLE_TICKS])
            if touch is None:
                return JointTrajectory(q, v, a)
            scale = scale * _SHRINK
        raise ConfigurationError(
            f"no room for an excitation around {centre.round(3).tolist()}: {touch[1]}; "  # type: ignore[index]
            "give another centre or a smaller excursion"
        )


def _shapes(options: Excitation, limits: JointLimits, reach: Array) -> Array:
    """Window times sines of every joint, and three derivatives. Shape (4, n, 7)."""
    rng = np.random.default_rng([options.seed, 7])
    n = round(options.seconds / GRID_S) + 1
    rest = round(REST_S / GRID_S)
    moving = n - 2 * rest
    window = np.zeros((4, n))
    window[:, rest : n - rest] = _window(moving, min(RAMP_S, moving * GRID_S / 4.0))
    t = np.arange(n) * GRID_S
    low, high = BAND_HZ
    shapes = np.zeros((4, n, 7))
    for joint in range(7):
        # Drawn for joints that rest, too: the others then move as they would beside them.
        place = (np.arange(TONES) + rng.uniform(0.0, 1.0, TONES)) / TONES
        omega = 2.0 * pi * low * (high / low) ** place
        phase = rng.uniform(0.0, 2.0 * pi, TONES)
        if not options.joints[joint]:
            continue
        speed = min(limits.velocity[joint], options.tcp_speed / max(reach[joint], 1e-3))
        slow, sudden = options.excursion / speed, speed / limits.acceleration[joint]
        amplitude = 1.0 / ((1.0 + omega * slow) * (1.0 + omega * sudden))
        tones = np.zeros((4, n))
        for w, p, size in zip(omega, phase, amplitude, strict=True):
            sine, cosine = size * np.sin(w * t + p), size * w * np.cos(w * t + p)
            tones += sine, cosine, -w * w * sine, -w * w * cosine
        # Leibniz' rule for the product of window and tones.
        for order, row in enumerate(((1,), (1, 1), (1, 2, 1), (1, 3, 3, 1))):
            for k, binomial in enumerate(row):
                shapes[order, :, joint] += binomial * window[k] * tones[order - k]
    return shapes


def _window(n: int, ramp_s: float) -> Array:
    """Rise, plateau and fall, and three derivatives that vanish at both ends. Shape (4, n)."""
    t = np.arange(n) * GRID_S
    end = t[-1]
    u = np.minimum(np.minimum(t, end - t) / ramp_s, 1.0)
    sign = np.where(t <= end / 2.0, 1.0, -1.0)
    rise = u**4 * (35.0 - 84.0 * u + 70.0 * u**2 - 20.0 * u**3)
    first = 140.0 * u**3 * (1.0 - u) ** 3
    second = 420.0 * u**2 * (1.0 - u) ** 2 * (1.0 - 2.0 * u)
    third = 840.0 * u * (1.0 - u) * (1.0 - 5.0 * u + 5.0 * u**2)
    return np.array((rise, sign * first / ramp_s, second / ramp_s**2, sign * third / ramp_s**3))


def _reach(centre: Array) -> Array:
    """Speed of the flange per speed of each joint at a configuration, m. Shape (7,)."""
    jacobian = ArmKinematics("right").jacobian(centre)
    reach: Array = np.linalg.norm(jacobian[:3], axis=0)
    return reach


def _joint_scales(shapes: Array, limits: JointLimits, room: Array) -> Array:
    """The largest scale of each joint that its own limits allow. Shape (7,)."""
    peaks = np.abs(shapes).max(axis=1)
    bounds = np.array((room, limits.velocity, limits.acceleration, limits.jerk))
    with np.errstate(divide="ignore", invalid="ignore"):
        scale: Array = MARGIN * np.where(peaks > 0.0, bounds / peaks, inf).min(axis=0)
    return np.where(np.isfinite(scale), scale, 0.0)


def _slowed(shapes: Array, scale: Array, centre: Array, tcp_speed: float) -> Array:
    """Scales at which the flange is slow enough: every joint may move it by the same speed.

    A joint near the hand moves the flange little and keeps all that its own limits allow; those
    far from it share what there is.
    """
    kinematics = ArmKinematics("right")

    def speed(scale: Array) -> float:
        position, _ = kinematics.forward(centre + scale * shapes[0])
        return float(np.sqrt((np.diff(position, axis=0) ** 2).sum(axis=1).max())) / GRID_S

    limit = MARGIN * tcp_speed
    if speed(scale) <= limit:
        return scale
    share = np.maximum(scale * np.abs(shapes[1]).max(axis=0) * _reach(centre), 1e-12)
    low, high = 0.0, float(share.max())
    for _ in range(10):
        middle = (low + high) / 2.0
        if speed(scale * np.minimum(1.0, middle / share)) <= limit:
            low = middle
        else:
            high = middle
    slowed: Array = scale * np.minimum(1.0, low / share)
    return slowed
