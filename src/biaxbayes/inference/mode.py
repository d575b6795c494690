"""A local mode of the density in the sampling coordinates, and the curvature there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["local_mode"]

MAX_STEPS = 40
STEP_FACTORS = np.array([1.0, 0.5, 0.25, 0.1, 0.03, 0.01, 1e-3])
STEEPEST = 1e14  # curvature in units of scale; beyond it differences are noise
SETTLED = 1e-2  # rise of the log density below which a start is good enough


def local_mode(
    log_density: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    scale: np.ndarray,
    edges: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Climb to a mode by damped Newton steps on finite differences.

    The density costs microseconds and takes many points at once, so differences are cheaper
    than a derivation would be worth. Steps stay inside the edges.

    Parameters
    ----------
    log_density : callable
        Vectorised, (n, d) to (n,).
    start : ndarray, shape (d,)
        A point of positive density.
    scale : ndarray, shape (d,)
        Width beyond which a direction counts as not determined.
    edges : ndarray, shape (d, 2)

    Returns
    -------
    mode : ndarray, shape (d,)
    factor : ndarray, shape (d, d)
        A square root of the covariance of the local Gaussian approximation, its widths limited
        to ``scale``.
    """
    low = np.where(np.isfinite(edges[:, 0]), edges[:, 0] + 1e-3, -np.inf)
    high = np.where(np.isfinite(edges[:, 1]), edges[:, 1] - 1e-3, np.inf)
    x = np.clip(start, low, high)
    value = float(log_density(x[None])[0])
    step = 0.02 * scale
    factor = np.diag(scale)
    for _ in range(MAX_STEPS):
        gradient, hessian = _differences(log_density, x, value, step, low, high)
        # Directions in units of scale, so that the eigenvalues compare with one.
        h = -hessian * np.outer(scale, scale)
        if not (np.isfinite(h).all() and np.isfinite(gradient).all()):
            break
        try:
            curvature, directions = np.linalg.eigh(0.5 * (h + h.T))
        except np.linalg.LinAlgError:
            break
        curvature = np.clip(np.abs(curvature), 1.0, STEEPEST)
        factor = scale[:, None] * directions / np.sqrt(curvature)
        move = factor @ (factor.T @ gradient)
        candidates = np.clip(x + STEP_FACTORS[:, None] * move, low, high)
        values = log_density(candidates)
        best = int(np.argmax(values))
        rise = float(values[best]) - value
        if rise > 0.0:
            x, value = candidates[best], float(values[best])
        # A fraction of the conditional sd of each coordinate, from the diagonal of the precision.
        step = 0.3 * scale / np.sqrt((directions**2 * curvature).sum(axis=1))
        if rise < SETTLED:
            break
    return x, factor


def _differences(
    log_density: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    value: float,
    step: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and Hessian by central differences, moved inward at an edge."""
    d = x.size
    room = np.minimum(x - low, high - x)
    step = np.minimum(step, np.where(np.isfinite(room), np.maximum(0.9 * room, 1e-5), step))
    eye = np.diag(step)
    i, j = np.triu_indices(d, 1)
    points = np.concatenate([x + eye, x - eye, x + eye[i] + eye[j], x - eye[i] - eye[j]])
    values = np.maximum(log_density(points), value - 1e6)
    plus, minus = values[:d], values[d : 2 * d]
    both = values[2 * d : 2 * d + i.size] + values[2 * d + i.size :]
    gradient = (plus - minus) / (2.0 * step)
    hessian = np.diag((plus - 2.0 * value + minus) / step**2)
    # f(+,+) + f(-,-) - f(+i) - f(-i) - f(+j) - f(-j) + 2 f = 2 h_i h_j H_ij
    cross = (both - plus[i] - minus[i] - plus[j] - minus[j] + 2.0 * value) / (
        2.0 * step[i] * step[j]
    )
    hessian[i, j] = hessian[j, i] = cross
    return gradient, hessian
