"""How far simulated positions are from recorded ones, and the servos that bring them nearer.

What is minimised is the sum over joints of log(squared residual) by the residual's autocorrelation
time: the likelihood of residuals whose size is each joint's own and unknown. A plain sum of squares
is another thing as soon as the model lacks something. Joints that carry a wrong mass are off by
milliradians; they would decide about the delay that all joints share, and a wrist, whose residual
is a tenth of theirs, would follow with a wrong stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from mujoco import minimize
from numpy.typing import NDArray

from skewmi.calibration.servo_model import ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.uncertainty import FitCovariance, autocorrelation_time, fit_covariance
from skewmi.robot_models.yumi import Array

SETTLE_S = 0.5
"""Left out after the motion begins, s: friction holds a resting joint anywhere around its command,
and it takes a movement until the simulated joint is where the real one is."""
RESOLUTION = 1e-5
"""Least standard deviation of a residual, rad: no encoder and no integrator is better."""
STEP = 1e-4
XTOL = 1e-4
"""Of the parameters, relative: a tenth of what the best recordings tell."""
HANG_TOGETHER_S = 1.0
"""Over which residuals may hang together, s."""
LONG_MEMORY = 1.5
"""Autocorrelation time, in samples, that residuals of the right model do not have."""
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-6, 1e6
DAMPINGS_TRIED = (0.1, 10.0)
"""Factors on a joint's damping that are tried at once."""
MORE_DAMPING = 30.0
"""Factor on it if neither was better."""


class ServoFit:
    """Residuals of servos on recordings, and least squares on them.

    Args:
        model: That candidates are simulated with.
        recordings: In free space.
        unknowns: What vectors mean.
    """

    def __init__(
        self, model: ServoModel, recordings: Sequence[ServoRecording], unknowns: ServoUnknowns
    ) -> None:
        self.unknowns = unknowns
        self._model, self._recordings = model, tuple(recordings)
        self._rows = [settled(recording) for recording in recordings]

    def residual(self, vectors: Array) -> Array:
        """Simulated less measured positions about their means, rad. (p, k) -> (m, 7, k)."""
        servos = [self.unknowns.servo(column) for column in vectors.T]
        parts = [
            (self._model.positions(servos, recording) - recording.positions)[:, rows]
            for recording, rows in zip(self._recordings, self._rows, strict=True)
        ]
        # A reading may be off by a constant, which no servo accounts for.
        parts = [part - part.mean(axis=1, keepdims=True) for part in parts]
        residual: Array = np.concatenate(parts, axis=1).transpose(1, 2, 0)
        return residual

    def squares(self, vectors: Array) -> Array:
        """Mean squares of the joints' residuals, rad^2. (p, k) -> (7, k)."""
        squares: Array = (self.residual(vectors) ** 2).mean(axis=0)
        return squares

    def sigma(self, residual: Array) -> Array:
        """Standard deviation of each joint's residual, rad. (m, 7) -> (7,)."""
        return joint_sigma(residual, self.unknowns.size)

    def weight(self, residual: Array) -> Array:
        """Weight of each joint: by its residual's size and how many samples tell as much as one.

        (m, 7) -> (7,), 1/rad.
        """
        weight: Array = 1.0 / (self.sigma(residual) * np.sqrt(autocorrelation_times(residual)))
        return weight

    def descended(self, vector: Array, iterations: int) -> Array:
        """The minimum next to a vector, its joints weighted as they deserve there. Shape (p,)."""
        return self.minimised(
            vector, self.weight(self.residual(vector[:, None])[..., 0]), iterations
        )

    def minimised(self, vector: Array, weight: Array, iterations: int) -> Array:
        """The minimum of the weighted squares next to a vector. Shape (p,)."""
        return minimised(self.residual, vector, weight, self.unknowns.bounds(), iterations)

    def jacobian(self, vector: Array) -> Array:
        """By central differences where the bounds leave room, rad. Shape (m, 7, p)."""
        low, high = self.unknowns.bounds()
        step = np.diag(STEP * np.maximum(1.0, np.abs(vector)))
        ahead = np.clip(vector[:, None] + step, low[:, None], high[:, None])
        behind = np.clip(vector[:, None] - step, low[:, None], high[:, None])
        width = np.diag(ahead) - np.diag(behind)
        return (self.residual(ahead) - self.residual(behind)) / width

    def covariance(self, vector: Array, residual: Array) -> FitCovariance:
        """How far a minimum may be off.

        Args:
            vector: That was descended to. Shape (p,).
            residual: There, rad. Shape (m, 7).
        """
        seconds = sum(float(np.ptp(recording.times_s)) for recording in self._recordings)
        return fit_covariance(
            residual,
            self.jacobian(vector),
            self.weight(residual),
            self.sigma(residual),
            round(HANG_TOGETHER_S * len(residual) / seconds),
        )

    def joints_fitted(self, vectors: Array, iterations: int) -> tuple[Array, Array]:
        """Several vectors at once, each joint by itself, with the delays as they are.

        Joints hardly move one another: what one of them needs is told by its own residual. So the
        numbers of a kind are changed at once in all joints, and each joint takes its step if its
        own residual becomes smaller by it (Levenberg and Marquardt, two dampings tried at once).

        Args:
            vectors: Shape (p, k).
            iterations: Of the descent.

        Returns:
            Vectors, shape (p, k), and the mean squares of their residuals, rad^2, shape (7, k).
        """
        kinds, delays = self.unknowns.size // 7, vectors[-1:]
        low, high = (bound[:-1].reshape(kinds, 7, 1) for bound in self.unknowns.bounds())
        x = vectors[:-1].reshape(kinds, 7, -1)
        damping = np.full(x.shape[1:], DAMPING)
        for _ in range(iterations):
            here, slope = self._slopes(x, delays, high)
            tried = np.stack(
                [
                    np.clip(x + joint_steps(x, here, slope, f * damping, low, high), low, high)
                    for f in DAMPINGS_TRIED
                ]
            )
            after = (self._residuals(tried, delays) ** 2).mean(axis=1)
            which = after.argmin(axis=0)
            better = after.min(axis=0) < (here**2).mean(axis=0)
            x = np.where(better, np.take_along_axis(tried, which[None, None], axis=0)[0], x)
            damping *= np.where(better, np.array(DAMPINGS_TRIED)[which], MORE_DAMPING)
            damping = np.clip(damping, LEAST_DAMPING, MOST_DAMPING)
        found = np.concatenate((x.reshape(len(vectors) - 1, -1), delays))
        return found, self.squares(found)

    def _slopes(self, x: Array, delays: Array, high: Array) -> tuple[Array, Array]:
        """Residuals, and each joint's by its own numbers. Shapes (m, 7, k), (kinds, m, 7, k)."""
        step = STEP * np.maximum(1.0, np.abs(x))
        step = np.where(x + step > high, -step, step)
        moved = np.repeat(x[None], len(x) + 1, axis=0)
        for kind, size in enumerate(step):
            moved[kind + 1, kind] += size
        residuals = self._residuals(moved, delays)
        return residuals[0], (residuals[1:] - residuals[0]) / step[:, None]

    def _residuals(self, sets: Array, delays: Array) -> Array:
        """Of sets of vectors with the same delays. (s, kinds, 7, k) -> (s, m, 7, k)."""
        many, count = len(sets), sets.shape[-1]
        rows = sets.reshape(many, -1, count).transpose(1, 0, 2).reshape(-1, many * count)
        residual = self.residual(np.concatenate((rows, np.tile(delays, (1, many)))))
        apart: Array = residual.reshape(*residual.shape[:2], many, count).transpose(2, 0, 1, 3)
        return apart


def joint_steps(
    x: Array, residual: Array, slope: Array, damping: Array, low: Array, high: Array
) -> Array:
    """A damped step of each joint of each vector. Shape (kinds, 7, k).

    Args:
        x: Where they are. Shape (kinds, 7, k).
        residual: There, rad. Shape (m, 7, k).
        slope: Of each joint's residual by its own numbers, rad. Shape (kinds, m, 7, k).
        damping: Relative to the squared slopes. Shape (7, k).
        low, high: Bounds of each number. Shape (kinds, 7, 1).
    """
    gradient = np.einsum("amjk,mjk->ajk", slope, residual)
    # What is at a bound and would leave stays there, and the others' step is made without it.
    free = ~(((x <= low) & (gradient > 0.0)) | ((x >= high) & (gradient < 0.0)))
    free &= (slope**2).sum(axis=1) > 0.0
    size = np.where(free, np.sqrt((slope**2).sum(axis=1)), 1.0)
    scaled = np.where(free, 1.0, 0.0)[:, None] * slope / size[:, None]
    matrix = np.einsum("amjk,bmjk->jkab", scaled, scaled)
    own = np.where(free, damping + 1e-9, 1.0).transpose(1, 2, 0)
    matrix += np.eye(len(x)) * own[..., None]
    right = np.where(free, -gradient / size, 0.0).transpose(1, 2, 0)
    step: Array = np.linalg.solve(matrix, right[..., None])[..., 0].transpose(2, 0, 1) / size
    return step


def autocorrelation_times(residual: Array) -> Array:
    """Of each joint's residual, in samples. (m, 7) -> (7,)."""
    return np.array([autocorrelation_time(column) for column in residual.T])


def hangs_together(residual: Array) -> bool:
    """Whether a residual, shape (m, 7), is more than noise: the model lacks something."""
    return bool(autocorrelation_times(residual).max() > LONG_MEMORY)


def minimised(
    residual: Callable[[Array], Array],
    vector: Array,
    weight: Array,
    bounds: tuple[Array, Array],
    iterations: int,
    jacobian: Callable[[Array], Array] | None = None,
) -> Array:
    """The minimum of weighted squares next to a vector. Shape (p,).

    Args:
        residual: Of each column, rad. (p, k) -> (m, 7, k).
        vector: Where to begin. Shape (p,).
        weight: Of each joint, 1/rad. Shape (7,).
        bounds: Of the vector, two of shape (p,).
        iterations: At most.
        jacobian: Of a vector's residual, rad, (p,) -> (m, 7, p); by differences without it.
    """

    low, high = bounds

    def weighted(vectors: Array) -> Array:
        # Rounding takes a step that ends on a bound past it, where a servo may be none.
        within = np.clip(vectors, low[:, None], high[:, None])
        found = residual(within) * weight[:, None]
        return found.reshape(-1, found.shape[-1])

    def slopes(at: Array, _: Array) -> Array:
        assert jacobian is not None
        rows = jacobian(np.clip(at.ravel(), low, high)) * weight[:, None]
        return rows.reshape(-1, rows.shape[-1])

    found, _ = minimize.least_squares(
        vector,
        weighted,
        bounds=bounds,
        jacobian=None if jacobian is None else slopes,
        eps=STEP,
        max_iter=iterations,
        xtol=XTOL,
        verbose=minimize.Verbosity.SILENT,
        x_scale="jac",
    )
    best: Array = np.clip(found.ravel(), low, high)
    return best


def settled(recording: ServoRecording) -> NDArray[np.bool_]:
    """Which samples count: not those in which friction still hides where a joint is. Shape (m,)."""
    rows: NDArray[np.bool_] = recording.times_s >= recording.motion_begins_s + SETTLE_S
    return rows


def joint_sigma(residual: Array, unknowns: int) -> Array:
    """Standard deviation of each joint's residual after a fit of so many unknowns, rad.

    (m, 7) -> (7,).
    """
    free = max(len(residual) - unknowns / 7.0, 1.0)
    sigma: Array = np.maximum(np.sqrt((residual**2).sum(axis=0) / free), RESOLUTION)
    return sigma


def joint_rms(residual: Array) -> Array:
    """Root mean square over all samples. (m, 7) -> (7,)."""
    rms: Array = np.sqrt((residual**2).mean(axis=0))
    return rms
