"""Batched forward kinematics, Jacobian and inverse kinematics of one YuMi arm, in numpy.

Everything is computed from the Denavit-Hartenberg rows of `yumi` (the MJCF and URDF use the link
frames instead; a test compares them). Arrays are kept as (components, n) inside: numpy then loops
over the batch in C, and a call costs nearly the same for 1 and for 50 configurations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skewmi.errors import KinematicsError
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.frames import rotation_about, rotation_vector
from skewmi.robot_models.yumi import Array, Side


@dataclass(frozen=True)
class InverseResult:
    """What inverse kinematics found.

    Attributes:
        q: Configurations inside the position limits, rad. Shape (..., 7).
        position_error: |target - tool0|, m. Shape (...).
        rotation_error: Angle between target and tool0 orientation, rad. Shape (...).
    """

    q: Array
    position_error: Array
    rotation_error: Array


class ArmKinematics:
    """Kinematics of tool0 (the flange, z out of it) in the robot base frame.

    Configurations are (..., 7), rad, chain order 1, 2, 7, 3, 4, 5, 6.
    """

    def __init__(self, side: Side = "right") -> None:
        """Args: side: Which arm. Raises NotFoundError if there is no such arm."""
        yumi.suffix(side)
        self.side: Side = side
        self.position_lower: Array = yumi.POSITION_LOWER + limits.POSITION_MARGIN
        self.position_upper: Array = yumi.POSITION_UPPER - limits.POSITION_MARGIN
        a, b, c = yumi.ARM_BASE_XYZ_ANGLES[side]
        self._base_rotation = rotation_about(0, a) @ rotation_about(1, b) @ rotation_about(2, c)
        self._base_position = np.array(yumi.ARM_BASE_POSITION[side])
        self._offsets = np.array([row.offset for row in yumi.DH_ROWS])[:, None]
        self._steps = [
            (row.d, row.a, round(np.sin(row.alpha)), round(np.cos(row.alpha)))
            for row in yumi.DH_ROWS
        ]

    def forward(self, q: ArrayLike) -> tuple[Array, Array]:
        """Pose of tool0.

        Returns:
            Position, m, shape (..., 3), and rotation tool0 to base, shape (..., 3, 3).
        """
        q, shape = _as_columns(q)
        position, rotation, _, _ = self._chain(q)
        return (
            np.ascontiguousarray(position.T).reshape(*shape, 3),
            np.ascontiguousarray(rotation.transpose(2, 1, 0)).reshape(*shape, 3, 3),
        )

    def jacobian(self, q: ArrayLike) -> Array:
        """Geometric Jacobian of tool0: twist = J v, linear velocity first, in base axes.

        The linear part is the velocity of tool0's origin, m/s. Shape (..., 6, 7).
        """
        q, shape = _as_columns(q)
        position, _, axes, origins = self._chain(q)
        jacobian = np.empty((6, 7, q.shape[1]))
        _fill_jacobian(jacobian, position, axes, origins)
        return np.ascontiguousarray(jacobian.transpose(2, 0, 1)).reshape(*shape, 6, 7)

    def inverse(
        self,
        position: ArrayLike,
        rotation: ArrayLike,
        q_start: ArrayLike,
        *,
        posture: ArrayLike | None = None,
        posture_gain: float = 0.1,
        posture_iterations: int = 1,
        max_iterations: int = 6,
        position_tolerance: float = 1e-6,
        rotation_tolerance: float = 1e-6,
        max_step: float = 0.3,
    ) -> InverseResult:
        """Damped least squares from `q_start`, with a posture in the null space.

        Each iteration solves, with e the pose error (linear first; the angular part in rad is
        weighted as it is in metres per radian, that is 1) and r = gain (posture - q):

            dq = r + J^T (J J^T + lambda^2 I)^-1 (e - J r),   lambda^2 = |e|^2 / 2 + 1e-10

        The damping vanishes with the error (Sugihara, IEEE Trans. Robotics 27(5), 2011), so the
        last iterations converge quadratically. Steps are shortened to `max_step` and clipped to
        the position limits (the controller's less `limits.POSITION_MARGIN`). Configurations
        that have converged stay put, so a result does not depend on its neighbours in the batch.

        Args:
            position: Target of tool0 in the base frame, m. Shape (..., 3).
            rotation: Target orientation, tool0 to base. Shape (3, 3) or (..., 3, 3).
            q_start: Where to start, rad. Shape (7,) or (..., 7).
            posture: Preferred configuration, rad. Shape (7,) or (..., 7). None: no preference.
            posture_gain: Part of the way to the posture taken per posture iteration.
            posture_iterations: The posture acts in this many first iterations only, so that
                the later ones meet the target exactly.
            max_iterations: Upper bound of iterations; a warm start needs 2 to 4.
            position_tolerance: Converged below this error, m.
            rotation_tolerance: Converged below this error, rad.
            max_step: Largest joint step per iteration, rad.

        Returns:
            The best effort; the caller judges the errors (or calls `require_converged`).
        """
        position = np.asarray(position, dtype=np.float64)
        q_start = np.asarray(q_start, dtype=np.float64)
        shape = np.broadcast_shapes(position.shape[:-1], q_start.shape[:-1])
        n = int(np.prod(shape, dtype=int))
        target = np.broadcast_to(position, (*shape, 3)).reshape(n, 3).T
        target_rotation = np.broadcast_to(
            np.asarray(rotation, dtype=np.float64), (*shape, 3, 3)
        ).reshape(n, 3, 3)
        q = np.array(np.broadcast_to(q_start, (*shape, 7)).reshape(n, 7).T)
        rest = None
        if posture is not None and posture_gain > 0.0:
            rest = np.broadcast_to(np.asarray(posture, np.float64), (*shape, 7)).reshape(n, 7).T
        lower, upper = self.position_lower[:, None], self.position_upper[:, None]
        np.clip(q, lower, upper, out=q)

        target_columns = np.ascontiguousarray(target_rotation.transpose(2, 1, 0))
        jacobian = np.empty((6, 7, n))
        error = np.empty((6, n))
        identity = np.eye(6)
        iteration = 0
        while True:
            tool, columns, axes, origins = self._chain(q)
            np.subtract(target, tool, out=error[:3])
            error[3:] = _rotation_error(target_columns, columns)
            position_error = np.sqrt(np.einsum("in,in->n", error[:3], error[:3]))
            rotation_error = np.sqrt(np.einsum("in,in->n", error[3:], error[3:]))
            active = (position_error > position_tolerance) | (rotation_error > rotation_tolerance)
            relaxing = rest is not None and iteration < posture_iterations
            if iteration >= max_iterations or not (relaxing or active.any()):
                break
            _fill_jacobian(jacobian, tool, axes, origins)
            J = jacobian.transpose(2, 0, 1)
            damping = 0.5 * (position_error**2 + rotation_error**2) + 1e-10
            gram = J @ J.transpose(0, 2, 1) + damping[:, None, None] * identity
            if relaxing and rest is not None:
                relax = posture_gain * (rest - q)
                demand = error - np.einsum("ijn,jn->in", jacobian, relax)
                step = relax + _transpose_solve(jacobian, gram, demand)
            else:
                step = _transpose_solve(jacobian, gram, error) * active
            largest = np.abs(step).max(axis=0)
            step *= np.minimum(1.0, max_step / np.maximum(largest, 1e-12))
            q += step
            np.clip(q, lower, upper, out=q)
            iteration += 1
        return InverseResult(
            q=np.ascontiguousarray(q.T).reshape(*shape, 7),
            position_error=position_error.reshape(shape),
            rotation_error=rotation_error.reshape(shape),
        )

    def _chain(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """Frames along the chain for q of shape (7, n).

        Returns tool0's position (3, n), its three axes (3 axes, 3, n), and of every joint the
        axis (7, 3, n) and a point on it (7, 3, n).
        """
        n = q.shape[1]
        angle = q + self._offsets
        cosine, sine = np.cos(angle), np.sin(angle)
        axes, origins = np.empty((7, 3, n)), np.empty((7, 3, n))
        base = self._base_rotation
        x, y, z = base[:, 0:1], base[:, 1:2], base[:, 2:3]
        p = self._base_position[:, None]
        for i, (d, a, sin_alpha, cos_alpha) in enumerate(self._steps):
            axes[i], origins[i] = z, p
            x_new = cosine[i] * x + sine[i] * y
            y_new = cosine[i] * y - sine[i] * x
            if d != 0.0:
                p = p + d * z
            if a != 0.0:
                p = p + a * x_new
            # alpha is 0 or ±90 degrees: the new axes are the old ones, exchanged.
            x = x_new
            y, z = (y_new, z) if cos_alpha else (sin_alpha * z, -sin_alpha * y_new)
        return p, np.stack([x, y, z]), axes, origins


def require_converged(
    result: InverseResult, *, position_tolerance: float = 1e-4, rotation_tolerance: float = 1e-3
) -> None:
    """Check that every target was met.

    Raises:
        KinematicsError: One was not; the message gives the worst errors.
    """
    worst_position = float(np.max(result.position_error, initial=0.0))
    worst_rotation = float(np.max(result.rotation_error, initial=0.0))
    if worst_position > position_tolerance or worst_rotation > rotation_tolerance:
        raise KinematicsError(
            f"a hand pose cannot be reached: off by {1e3 * worst_position:.3g} mm and "
            f"{np.degrees(worst_rotation):.3g} deg, allowed are {1e3 * position_tolerance:.3g} mm "
            f"and {np.degrees(rotation_tolerance):.3g} deg; move the target or the start"
        )


def _as_columns(q: ArrayLike) -> tuple[Array, tuple[int, ...]]:
    q = np.asarray(q, dtype=np.float64)
    if q.ndim == 0 or q.shape[-1] != 7:
        raise KinematicsError(f"an arm has 7 joints; got an array of shape {q.shape}")
    return np.ascontiguousarray(q.reshape(-1, 7).T), q.shape[:-1]


def _cross(a: Array, b: Array, out: Array) -> None:
    """Cross product over the second to last axis: (..., 3, n)."""
    a0, a1, a2 = a[..., 0, :], a[..., 1, :], a[..., 2, :]
    b0, b1, b2 = b[..., 0, :], b[..., 1, :], b[..., 2, :]
    out[..., 0, :] = a1 * b2 - a2 * b1
    out[..., 1, :] = a2 * b0 - a0 * b2
    out[..., 2, :] = a0 * b1 - a1 * b0


def _fill_jacobian(jacobian: Array, tool: Array, axes: Array, origins: Array) -> None:
    _cross(axes, tool - origins, out=jacobian[:3].transpose(1, 0, 2))
    jacobian[3:] = axes.transpose(1, 0, 2)


def _rotation_error(target: Array, actual: Array) -> Array:
    """Rotation vector that turns `actual` into `target`, both (3 axes, 3, n). Shape (3, n)."""
    # sin(angle) times the axis is half the sum of the cross products of the axes.
    crossed = np.empty_like(actual)
    _cross(actual, target, out=crossed)
    vector: Array = 0.5 * crossed.sum(axis=0)
    cosine = 0.5 * (np.einsum("kin,kin->n", actual, target) - 1.0)
    sine = np.sqrt(np.einsum("in,in->n", vector, vector))
    if cosine.min(initial=1.0) > -0.99:
        # angle / sin(angle), whose limit at zero is 1.
        scale = np.where(sine > 1e-9, np.arctan2(sine, cosine) / np.maximum(sine, 1e-9), 1.0)
        return vector * scale
    # Near half a turn the sine says little about the axis.
    difference = np.einsum("kin,kjn->nij", target, actual)
    return np.ascontiguousarray(rotation_vector(difference).T)


def _transpose_solve(jacobian: Array, gram: Array, error: Array) -> Array:
    """J^T gram^-1 e for J (6, 7, n), gram (n, 6, 6), e (6, n). Shape (7, n)."""
    solved = np.linalg.solve(gram, error.T[:, :, None])[:, :, 0]
    step: Array = np.einsum("ijn,ni->jn", jacobian, solved)
    return step
