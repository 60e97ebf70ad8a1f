"""Batched forward kinematics, Jacobian and inverse kinematics of one YuMi arm, in numpy.

Everything is computed from the Denavit-Hartenberg rows of `yumi` (the MJCF and URDF use the link
frames instead; a test compares them). Everything is done for the whole batch at once with few and
large numpy operations: a call costs nearly the same for 1 and for 50 configurations.
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
        base = np.eye(4)
        base[:3, :3] = rotation_about(0, a) @ rotation_about(1, b) @ rotation_about(2, c)
        base[:3, 3] = yumi.ARM_BASE_POSITION[side]
        self._base = base
        self._offsets = np.array([row.offset for row in yumi.DH_ROWS])
        # The transform of a joint is affine in cosine and sine of its angle, so that all joints
        # of all configurations take three operations. The base goes into the first joint.
        parts = np.array([_row_parts(row) for row in yumi.DH_ROWS])
        parts[0] = base @ parts[0]
        self._constant, self._cosine, self._sine = parts.transpose(1, 0, 2, 3)[:, :, None]

    def forward(self, q: ArrayLike) -> tuple[Array, Array]:
        """Pose of tool0.

        Returns:
            Position, m, shape (..., 3), and rotation tool0 to base, shape (..., 3, 3).
        """
        q, shape = _as_rows(q)
        tool = self._chain(q)[-1]
        return tool[:, :3, 3].reshape(*shape, 3), tool[:, :3, :3].reshape(*shape, 3, 3)

    def jacobian(self, q: ArrayLike) -> Array:
        """Geometric Jacobian of tool0: twist = J v, linear velocity first, in base axes.

        The linear part is the velocity of tool0's origin, m/s. Shape (..., 6, 7).
        """
        q, shape = _as_rows(q)
        jacobian = np.empty((len(q), 6, 7))
        _fill_jacobian(jacobian, self._chain(q))
        return jacobian.reshape(*shape, 6, 7)

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
        unchecked_iterations: int | None = None,
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
            unchecked_iterations: Return after this many iterations without evaluating the last
                one: the errors returned are those before it. For targets that are known to be
                near, where the evaluation costs as much as half an iteration.

        Returns:
            The best effort; the caller judges the errors (or calls `require_converged`).
        """
        position = np.asarray(position, dtype=np.float64)
        q_start = np.asarray(q_start, dtype=np.float64)
        shape = np.broadcast_shapes(position.shape[:-1], q_start.shape[:-1])
        n = int(np.prod(shape, dtype=int))
        # One row each, or one for all: they broadcast against the rows of q below.
        target = _rows(position, shape, (3,))
        target_rotation = _rows(np.asarray(rotation, dtype=np.float64), shape, (3, 3))
        q = np.empty((n, 7))
        q[:] = _rows(q_start, shape, (7,))
        rest = None
        if posture is not None and posture_gain > 0.0:
            rest = _rows(np.asarray(posture, dtype=np.float64), shape, (7,))
        lower, upper = self.position_lower, self.position_upper
        np.clip(q, lower, upper, out=q)

        jacobian = np.empty((n, 6, 7))
        transposed = jacobian.transpose(0, 2, 1)
        error = np.empty((n, 6, 1))
        iteration = 0
        while True:
            frames = self._chain(q)
            tool = frames[-1]
            np.subtract(target, tool[:, :3, 3], out=error[:, :3, 0])
            error[:, 3:, 0] = _rotation_error(target_rotation, tool[:, :3, :3])
            square = error * error
            position_square = square[:, :3, 0].sum(axis=1)
            rotation_square = square[:, 3:, 0].sum(axis=1)
            active = (position_square > position_tolerance**2) | (
                rotation_square > rotation_tolerance**2
            )
            relaxing = rest is not None and iteration < posture_iterations
            if iteration >= max_iterations or not (relaxing or active.any()):
                break
            _fill_jacobian(jacobian, frames)
            damping = 0.5 * (position_square + rotation_square) + 1e-10
            gram = jacobian @ transposed
            gram.reshape(n, 36)[:, ::7] += damping[:, None]
            if relaxing and rest is not None:
                relax = posture_gain * (rest - q)
                demand = error - jacobian @ relax[:, :, None]
                step = relax + (transposed @ np.linalg.solve(gram, demand))[:, :, 0]
            else:
                step = (transposed @ np.linalg.solve(gram, error))[:, :, 0] * active[:, None]
            largest = np.abs(step).max(axis=1, initial=0.0)
            if (largest > max_step).any():
                step *= np.minimum(1.0, max_step / np.maximum(largest, 1e-12))[:, None]
            q += step
            np.clip(q, lower, upper, out=q)
            iteration += 1
            if iteration == unchecked_iterations:
                break
        return InverseResult(
            q=q.reshape(*shape, 7),
            position_error=np.sqrt(position_square).reshape(shape),
            rotation_error=np.sqrt(rotation_square).reshape(shape),
        )

    def _chain(self, q: Array) -> Array:
        """Frames along the chain, as homogeneous transforms to the base frame.

        Args:
            q: Shape (n, 7).

        Returns:
            Shape (8, n, 4, 4): frame i carries the axis of joint i as its z; the last is tool0.
        """
        angle = (q + self._offsets).T[:, :, None, None]
        frames = np.empty((8, len(q), 4, 4))
        frames[0] = self._base
        joints = frames[1:]
        np.multiply(np.cos(angle), self._cosine, out=joints)
        joints += np.sin(angle) * self._sine
        joints += self._constant
        for i in range(1, 7):
            np.matmul(joints[i - 1], joints[i], out=joints[i])
        return frames


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


def _row_parts(row: yumi.DhRow) -> Array:
    """Parts C, K, S of a joint's transform C + cos(angle) K + sin(angle) S. Shape (3, 4, 4).

    The transform is Rz(angle) Tz(d) Tx(a) Rx(alpha); alpha is 0 or +-90 degrees.
    """
    sine, cosine = round(np.sin(row.alpha)), round(np.cos(row.alpha))
    parts = np.zeros((3, 4, 4))
    parts[0, 2:] = [[0.0, sine, cosine, row.d], [0.0, 0.0, 0.0, 1.0]]
    parts[1, :2] = [[1.0, 0.0, 0.0, row.a], [0.0, cosine, -sine, 0.0]]
    parts[2, :2] = [[0.0, -cosine, sine, 0.0], [1.0, 0.0, 0.0, row.a]]
    return parts


def _rows(values: Array, shape: tuple[int, ...], item: tuple[int, ...]) -> Array:
    """Items of a batch as rows (n, *item), or (1, *item) for one item that all share."""
    if values.shape != item and values.shape != (*shape, *item):
        values = np.broadcast_to(values, (*shape, *item))
    return values.reshape(-1, *item)


def _as_rows(q: ArrayLike) -> tuple[Array, tuple[int, ...]]:
    q = np.asarray(q, dtype=np.float64)
    if q.ndim == 0 or q.shape[-1] != 7:
        raise KinematicsError(f"an arm has 7 joints; got an array of shape {q.shape}")
    return q.reshape(-1, 7), q.shape[:-1]


def _fill_jacobian(jacobian: Array, frames: Array) -> None:
    """Write the Jacobian (n, 6, 7) of tool0 for frames as from `_chain`."""
    axis = frames[:7, :, :3, 2].transpose(2, 1, 0)
    lever = (frames[-1, :, :3, 3] - frames[:7, :, :3, 3]).transpose(2, 1, 0)
    for row, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.subtract(axis[i] * lever[j], axis[j] * lever[i], out=jacobian[:, row])
    jacobian[:, 3:] = axis.transpose(1, 0, 2)


def _rotation_error(target: Array, actual: Array) -> Array:
    """Rotation vector that turns `actual` into `target`, both (n, 3, 3). Shape (n, 3)."""
    difference = target @ actual.transpose(0, 2, 1)
    entry = difference.reshape(-1, 9)
    # The antisymmetric part is sin(angle) times the axis.
    vector: Array = 0.5 * (entry.take((7, 2, 3), axis=1) - entry.take((5, 6, 1), axis=1))
    cosine = 0.5 * (entry[:, 0] + entry[:, 4] + entry[:, 8] - 1.0)
    if cosine.min(initial=1.0) > -0.99:
        # angle / sin(angle), whose limit at zero is 1.
        sine = np.sqrt((vector * vector).sum(axis=1))
        scale = np.where(sine > 1e-9, np.arctan2(sine, cosine) / np.maximum(sine, 1e-9), 1.0)
        return vector * scale[:, None]
    # Near half a turn the sine says little about the axis.
    return rotation_vector(difference)
