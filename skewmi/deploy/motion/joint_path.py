"""A path of the joints with a length, and motions along it from rest to rest.

q(s), 0 <= s <= length, is a Chebyshev polynomial in each joint: a straight line in joint space has
two coefficients, a straight line of the hand as many as inverse kinematics at as many Chebyshev
points give. The hand's path is smooth enough for ten to leave less than a micrometre. With the
arc s(t) from ruckig,

    v = q'(s) ds/dt,    a = q''(s) (ds/dt)^2 + q'(s) d2s/dt2

Whoever stops on the way (`path_motion.PathMotion`) is still on the path, and goes on from there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ruckig
from numpy.polynomial import chebyshev

from skewmi.errors import ConfigurationError
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_S, Array, JointTrajectory

SHARE = 0.9
"""Part of the limit of joint velocities that a motion along a path uses; of accelerations a half,
of jerks a third: what bends the path comes on top, and stops need some."""
_ACCELERATION_SHARE, _JERK_SHARE = 0.5, 0.3
_LOOKED_AT = 41
"""Places of a path at which its derivatives are bounded."""
_NO_LENGTH = 1e-12


def chebyshev_places(length: float, count: int) -> Array:
    """Where on [0, length] a path is to be known for `JointPath.through`. Shape (count,)."""
    return np.asarray((1.0 + chebyshev.chebpts2(count)) * (length / 2.0))


@dataclass(frozen=True, eq=False)
class JointPath:
    """Configurations by the way along a path.

    Attributes:
        coefficients: Of Chebyshev polynomials on [0, length], rad. Shape (k, 7).
        length: m for a path of the hand, 1 for a line in joint space.
    """

    coefficients: Array
    length: float

    @staticmethod
    def line(q_start: Array, q_end: Array) -> JointPath:
        """A straight line in joint space, of length 1."""
        ends: Array = np.array([0.5 * (q_start + q_end), 0.5 * (q_end - q_start)])
        return JointPath(ends, 1.0)

    @staticmethod
    def through(q: Array, length: float) -> JointPath:
        """The path through configurations at `chebyshev_places`. Shape (k, 7)."""
        if not length > 0.0:
            raise ConfigurationError(f"a path's length is {length}; it must be positive")
        places = chebyshev.chebpts2(len(q))
        coefficients = np.asarray(chebyshev.chebfit(places, q, len(q) - 1), dtype=np.float64)
        return JointPath(coefficients, length)

    def reversed(self) -> JointPath:
        """The same way back."""
        mirrored = self.coefficients.copy()
        mirrored[1::2] *= -1.0
        return JointPath(mirrored, self.length)

    def at(self, s: Array | float, derivative: int = 0) -> Array:
        """q or a derivative by s. Shape (..., 7)."""
        scale = 2.0 / self.length
        coefficients = chebyshev.chebder(self.coefficients, derivative, scl=scale)
        values = chebyshev.chebval(np.asarray(s) * scale - 1.0, coefficients)
        return np.asarray(np.moveaxis(values, 0, -1))

    def nearest(self, q: Array) -> float:
        """Where on the path a configuration of it is: exact to a billionth of its length."""
        low, high = 0.0, self.length
        for _ in range(12):
            s = np.linspace(low, high, 33)
            best = int(np.argmin(((self.at(s) - q) ** 2).sum(axis=1)))
            low, high = float(s[max(best - 1, 0)]), float(s[min(best + 1, 32)])
        return (low + high) / 2.0

    def motion(
        self,
        s_start: float,
        s_end: float,
        limits: JointLimits,
        speed: float,
        tool_z: float = 0.0,
        q_start: Array | None = None,
    ) -> JointTrajectory:
        """From rest to rest on the path.

        Args:
            s_start, s_end: From where to where.
            q_start: Where the arm rests, rad, shape (7,), if that is not exactly on the path: what
                is left between fades out on the way.
            limits: Of the joints.
            speed: Of the flange, and of a point on its axis, m/s.
            tool_z: Where on the axis that point is, m.
        """
        off = np.zeros(7) if q_start is None else q_start - self.at(s_start)
        if abs(s_end - s_start) < _NO_LENGTH or not np.abs(self.at(s_end) - self.at(s_start)).any():
            return JointTrajectory.resting(self.at(s_start) + off, 2)
        places = np.linspace(s_start, s_end, _LOOKED_AT)
        rate = np.abs(self.at(places, 1)).max(axis=0).clip(min=1e-9)
        request = ruckig.InputParameter(1)
        request.current_position, request.target_position = [s_start], [s_end]
        fastest = min(
            SHARE * float((limits.velocity / rate).min()), self._pace(places, speed, tool_z)
        )
        request.max_velocity = [fastest]
        request.max_acceleration = [_ACCELERATION_SHARE * float((limits.acceleration / rate).min())]
        request.max_jerk = [_JERK_SHARE * float((limits.jerk / rate).min())]
        found = ruckig.Trajectory(1)
        ruckig.Ruckig(1).calculate(request, found)
        count = int(np.ceil(found.duration / GRID_S - 1e-9)) + 1
        s, v, a = np.array([found.at_time(k * GRID_S) for k in range(count)])[..., 0].T
        s[-1], v[-1], a[-1], v[0], a[0] = s_end, 0.0, 0.0, 0.0, 0.0
        first = self.at(s, 1)
        q = self.at(s) + ((s_end - s) / (s_end - s_start))[:, None] * off
        q[0] = self.at(s_start) + off
        return JointTrajectory(
            q, first * v[:, None], self.at(s, 2) * (v * v)[:, None] + first * a[:, None]
        )

    def _pace(self, places: Array, speed: float, tool_z: float) -> float:
        """Largest ds/dt at which flange and tool keep a speed, m/s."""
        arm, q = ArmKinematics("right"), self.at(places)
        twist = np.einsum("nij,nj->ni", arm.jacobian(q), self.at(places, 1))
        axis = arm.forward(q)[1][..., 2]
        tool = twist[:, :3] + np.cross(twist[:, 3:], tool_z * axis)
        fastest = max(np.linalg.norm(part, axis=1).max() for part in (twist[:, :3], tool))
        return speed / max(float(fastest), 1e-9)
