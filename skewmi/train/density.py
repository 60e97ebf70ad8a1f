"""Gaussian and kernel densities."""

from __future__ import annotations

import math

import numpy as np
import torch

from skewmi.policy_io import Array

_LOG_TWO_PI = math.log(2.0 * math.pi)

_NEGLIGIBLE = -80.0
"""Exponents are clipped here, relative to the largest: exp(-80) is 1e-35 of it. Below float32's
normal numbers (-87) exp takes a slow path, fifteen times slower than the rest together."""


def gaussian_log_density(x: Array, center: Array, sigma: float) -> Array:
    """log N(x; center, sigma^2 I).

    Args:
        x: Shape (..., d).
        center: Broadcasts with x.
        sigma: Standard deviation, same unit as x.

    Returns:
        Shape (...).
    """
    d = x.shape[-1]
    squared = np.square(x - center).sum(-1)
    density: Array = -0.5 * squared / sigma**2 - d * math.log(sigma) - 0.5 * d * _LOG_TWO_PI
    return density


def kernel_log_density(
    query: Array,
    points: Array,
    bandwidth: float,
    *,
    self_count: float = 0.0,
    leave_one_out: bool = False,
    single: bool = True,
    chunk: int = 1 << 18,
) -> Array:
    """Log of a Gaussian kernel density estimate, in chunks that stay in cache.

    p(x) = (sum_i K(x - y_i) + self_count K(0)) / (n + self_count), K = N(0, bandwidth^2 I).
    With `self_count` every query counts as visited that often itself: no density is below
    self_count K(0) / (n + self_count), so that a weight p^alpha cannot explode on an outlier.

    Args:
        query: Shape (m, d).
        points: Shape (n, d).
        bandwidth: Standard deviation of the kernel, same unit.
        self_count: See above.
        leave_one_out: The queries are the points, and none counts for itself.
        single: Compute in float32: relative error of the density about 1e-3 at worst (at
            coordinates of 100 bandwidths), five times faster than float64.
        chunk: Pairs per chunk.

    Returns:
        Shape (m,).
    """
    n, d = points.shape
    dtype = torch.float32 if single else torch.float64
    # |x - y|^2 = |x|^2 + |y|^2 - 2 x.y loses digits far from the origin, so center first.
    center = points.mean(0)
    x = torch.as_tensor((query - center) / bandwidth, dtype=dtype)
    y = torch.as_tensor((points - center) / bandwidth, dtype=dtype)
    half_y = 0.5 * y.square().sum(1)
    rows = max(1, chunk // n)
    result = torch.empty(len(x), dtype=dtype)
    for start in range(0, len(x), rows):
        part = x[start : start + rows]
        # log K up to its constant: x.y - |y|^2/2 - |x|^2/2, never above 0 but for rounding.
        exponent = torch.addmm(half_y.neg(), part, y.T)
        exponent.sub_(0.5 * part.square().sum(1, keepdim=True))
        if leave_one_out:
            index = torch.arange(len(part))
            exponent[index, start + index] = -torch.inf
        largest = exponent.amax(1, keepdim=True)
        total = exponent.sub_(largest).clamp_(min=_NEGLIGIBLE).exp_().sum(1)
        result[start : start + rows] = total.log_().add_(largest[:, 0])
    if self_count > 0.0:
        result = torch.logaddexp(result, torch.tensor(math.log(self_count), dtype=dtype))
    count = n + self_count - (1.0 if leave_one_out else 0.0)
    constant = math.log(count) + d * math.log(bandwidth) + 0.5 * d * _LOG_TWO_PI
    log_density: Array = result.double().numpy() - constant
    return log_density


def trajectory_log_density(states: Array, bandwidth: float, *, causal: bool = True) -> Array:
    """log p_tau at every state of trajectories (Eqs. 3-4 of Skew-Explore).

    Args:
        states: Shape (episodes, steps, d), in density units.
        bandwidth: Of the Gaussian kernels, same unit.
        causal: Kernels on the trajectory up to and including the state (the published code);
            otherwise on all of the trajectory (the published equations).

    Returns:
        Shape (episodes, steps).
    """
    episodes, steps, d = states.shape
    x = torch.as_tensor(states - states.mean((0, 1)), dtype=torch.float32) / bandwidth
    exponent = torch.zeros(episodes, steps, steps)
    for k in range(d):
        exponent.addcmul_(*[x[:, :, None, k] - x[:, None, :, k]] * 2, value=-0.5)
    # A state's own kernel has exponent 0, so 0 is the largest.
    kernel = exponent.clamp_(min=_NEGLIGIBLE).exp_()
    counts = torch.full((steps,), float(steps), dtype=torch.float64)
    if causal:
        kernel = kernel.tril_()
        counts = torch.arange(1, steps + 1, dtype=torch.float64)
    total = kernel.sum(2).double().log() - counts.log()
    log_density: Array = (total - d * math.log(bandwidth) - 0.5 * d * _LOG_TWO_PI).numpy()
    return log_density
