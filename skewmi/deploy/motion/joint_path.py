"""A path of the joints with a length, and motions along it from rest to rest.

q(s), 0 <= s <= length, is a Chebyshev polynomial in each joint: a straight line in joint space has
two coefficients, a straight line of the hand as many as inverse kinematics at as many Chebyshev
points give. The hand's path is smooth enough for ten to leave less than a micrometre. With the
part of the way u(t) from ruckig,

    v = q'(u) du/dt,    a = q''(u) (du/dt)^2 + q'(u) d2u/dt2

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
            s_start, s_end: From where to where; the same place, if only what `q_start` is off is
                to be moved.
            limits: Of the joints.
            speed: Of the flange, and of a point on its axis, m/s.
            tool_z: Where on the axis that point is, m.
            q_start: Where the arm rests, rad, shape (7,), if that is not exactly on the path: what
                is left between fades out on the way, within limits and speed.
        """
        way = s_end - s_start
        off = np.zeros(7) if q_start is None else q_start - self.at(s_start)
        # By u, the part of the way that is done: q = path(s_start + u way) + (1 - u) off.
        places = s_start + np.linspace(0.0, 1.0, _LOOKED_AT) * way
        first = self.at(places, 1) * way - off
        if not first.any():
            return JointTrajectory.resting(self.at(s_start), 2)
        rate = np.abs(first).max(axis=0).clip(min=1e-9)
        request = ruckig.InputParameter(1)
        request.current_position, request.target_position = [0.0], [1.0]
        fastest = min(
            SHARE * float((limits.velocity / rate).min()),
            self._pace(self.at(places), first, speed, tool_z),
        )
        request.max_velocity = [fastest]
        request.max_acceleration = [_ACCELERATION_SHARE * float((limits.acceleration / rate).min())]
        request.max_jerk = [_JERK_SHARE * float((limits.jerk / rate).min())]
        found = ruckig.Trajectory(1)
        ruckig.Ruckig(1).calculate(request, found)
        count = int(np.ceil(found.duration / GRID_S - 1e-9)) + 1
        u, v, a = np.array([found.at_time(k * GRID_S) for k in range(count)])[..., 0].T
        u[0], u[-1], v[-1], a[-1], v[0], a[0] = 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
        s = s_start + u * way
        first = self.at(s, 1) * way - off
        second = self.at(s, 2) * way**2
        q = self.at(s) + (1.0 - u)[:, None] * off
        if q_start is not None:
            q[0] = q_start
        return JointTrajectory(
            q, first * v[:, None], second * (v * v)[:, None] + first * a[:, None]
        )

    @staticmethod
    def _pace(q: Array, first: Array, speed: float, tool_z: float) -> float:
        """Largest du/dt at which flange and tool keep a speed, 1/s, from q(u) and dq/du."""
        arm = ArmKinematics("right")
        twist = np.einsum("nij,nj->ni", arm.jacobian(q), first)
        axis = arm.forward(q)[1][..., 2]
        tool = twist[:, :3] + np.cross(twist[:, 3:], tool_z * axis)
        fastest = max(np.linalg.norm(part, axis=1).max() for part in (twist[:, :3], tool))
        return speed / max(float(fastest), 1e-9)
