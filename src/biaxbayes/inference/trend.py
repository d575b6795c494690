"""A triangular map that straightens curved and funnel-shaped posteriors.

Coordinates are taken in a fixed order, those with hard edges first, then those that set the width
of others (the noise sd does). Each is standardised; from each a quadratic regression on its
predecessors is subtracted, and what is left is divided by a width that depends on them too:

    z_k = (x_k - centre_k) / scale_k
    r_k = (z_k - p_k(z_1 ... z_{k-1})) exp(-s_k(z_1 ... z_{k-1}))

The map is triangular, so densities carry over with the factor exp(-sum s_k), and it is inverted
one coordinate after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

__all__ = ["Trend", "fit_trend"]

CROSSED = 6
"""Products of two different predecessors count among the first so many coordinates."""
RIDGE = 1e-4
WIDTH_RIDGE = 1e-2
SATURATION = 4.0
"""The trend stops following predecessors beyond this many standard deviations."""
WIDEST = 2.5
"""Limit of |s_k|."""


@dataclass(frozen=True)
class Trend:
    """A fitted map.

    Attributes
    ----------
    order : int64 ndarray, shape (d,)
        Coordinate taken at each place.
    centre, scale : ndarray, shape (d,)
        In that order.
    coefficients : ndarray, shape (d, f)
        Row k holds p_k on 1, z_i, then the products z_i z_j; unused places are zero.
    widths : ndarray, shape (d, d + 1)
        Row k holds s_k on 1 and z_i.
    """

    order: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    coefficients: np.ndarray
    widths: np.ndarray

    def straighten(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals r of points x, shape (n, d), and ln |dr/dx| of each."""
        z = np.ascontiguousarray((x[:, self.order] - self.centre) / self.scale)
        r, log_jacobian = _straighten(z, self.coefficients, self.widths)
        return r, log_jacobian - float(np.log(self.scale).sum())

    def bend(self, r: np.ndarray) -> np.ndarray:
        """Points x of residuals r; inverse of :meth:`straighten`."""
        z = _bend(np.ascontiguousarray(r), self.coefficients, self.widths)
        x = np.empty_like(z)
        x[:, self.order] = z * self.scale + self.centre
        return x

    @classmethod
    def none(cls, dimension: int) -> Trend:
        """The identity."""
        d = dimension
        return cls(np.arange(d), np.zeros(d), np.ones(d), np.zeros((d, 1)), np.zeros((d, 1)))


def fit_trend(points: np.ndarray, bounded: np.ndarray) -> Trend:
    """Fit the map to points of shape (n, d).

    Parameters
    ----------
    points : ndarray, shape (n, d)
    bounded : ndarray of bool, shape (d,)
        Coordinates with a hard edge; they come first and keep their own shape, so that
        their edges stay where they are.
    """
    n, d = points.shape
    order = _order(points, bounded)
    x = points[:, order]
    centre, scale = x.mean(axis=0), x.std(axis=0)
    scale = np.where(scale > 1e-300, scale, 1.0)
    z = np.ascontiguousarray((x - centre) / scale)
    coefficients, widths = np.zeros((d, _count(d - 1))), np.zeros((d, d + 1))
    for k in range(int(bounded.sum()), d):
        size = _count(k)
        if n < 5 * size:
            continue
        features = _features(z, k)
        coefficients[k, :size] = _regression(features, z[:, k], RIDGE)
        if k == 0:
            continue
        left = z[:, k] - features @ coefficients[k, :size]
        linear = np.column_stack([np.ones(n), np.clip(z[:, :k], -SATURATION, SATURATION)])
        # ln |left| of a Gaussian scatters by 1.1 whatever its width; its mean follows ln width.
        logs = np.log(np.abs(left) + 1e-3 * left.std() + 1e-300)
        slopes = _regression(linear, logs - logs.mean(), WIDTH_RIDGE)
        slopes[0] = 0.0
        widths[k, : k + 1] = slopes
    return Trend(order, centre, scale, coefficients, widths)


def _order(points: np.ndarray, bounded: np.ndarray) -> np.ndarray:
    """Bounded coordinates, then the others, those that set widths first."""
    z = points - points.mean(axis=0)
    sd = z.std(axis=0)
    z = z / np.where(sd > 0.0, sd, 1.0)
    logs = np.log(np.abs(z) + 1e-3)
    logs = (logs - logs.mean(axis=0)) / (logs.std(axis=0) + 1e-12)
    # How well coordinate j foretells how far the others lie from their mean.
    foretells = (z.T @ logs / len(z)) ** 2
    np.fill_diagonal(foretells, 0.0)
    influence = foretells.sum(axis=1)
    free = np.flatnonzero(~bounded)
    return np.concatenate(
        [np.flatnonzero(bounded), free[np.argsort(-influence[free], kind="stable")]]
    )


def _regression(features: np.ndarray, target: np.ndarray, ridge: float) -> np.ndarray:
    n, size = features.shape
    return np.linalg.solve(features.T @ features + ridge * n * np.eye(size), features.T @ target)


@njit(cache=True, nogil=True)
def _count(k):
    """Number of features of k predecessors."""
    crossed = min(k, CROSSED)
    return 1 + 2 * k + crossed * (crossed - 1) // 2


@njit(cache=True, nogil=True)
def _append(z, k, out, filled):
    """Features that coordinate k adds for its successors; their new count."""
    x = min(max(z[k], -SATURATION), SATURATION)
    out[filled] = x
    out[filled + 1] = x * x - 1.0
    filled += 2
    if k < CROSSED:
        for j in range(k):
            out[filled] = x * min(max(z[j], -SATURATION), SATURATION)
            filled += 1
    return filled


@njit(cache=True, nogil=True)
def _features(z, k):
    out = np.empty((z.shape[0], _count(k)))
    for i in range(z.shape[0]):
        out[i, 0] = 1.0
        filled = 1
        for j in range(k):
            filled = _append(z[i], j, out[i], filled)
    return out


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _place(features, filled, z, k, coefficients, widths):
    """(p_k, s_k) given the features of the predecessors."""
    trend = 0.0
    for m in range(min(filled, coefficients.shape[1])):
        trend += coefficients[k, m] * features[m]
    width = 0.0
    for i in range(min(k, widths.shape[1] - 1)):
        width += widths[k, i + 1] * min(max(z[i], -SATURATION), SATURATION)
    return trend, min(max(width, -WIDEST), WIDEST)


@njit(cache=True, nogil=True)
def _straighten(z, coefficients, widths):
    n, d = z.shape
    out = np.empty((n, d))
    log_jacobian = np.zeros(n)
    features = np.empty(_count(d))
    features[0] = 1.0
    for i in range(n):
        filled = 1
        for k in range(d):
            trend, width = _place(features, filled, z[i], k, coefficients, widths)
            out[i, k] = (z[i, k] - trend) * np.exp(-width)
            log_jacobian[i] -= width
            filled = _append(z[i], k, features, filled)
    return out, log_jacobian


@njit(cache=True, nogil=True)
def _bend(r, coefficients, widths):
    n, d = r.shape
    out = np.empty((n, d))
    features = np.empty(_count(d))
    features[0] = 1.0
    for i in range(n):
        filled = 1
        for k in range(d):
            trend, width = _place(features, filled, out[i], k, coefficients, widths)
            out[i, k] = r[i, k] * np.exp(width) + trend
            filled = _append(out[i], k, features, filled)
    return out
