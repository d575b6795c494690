"""A quadratic trend that straightens curved posteriors, with unit Jacobian.

Coordinates are taken in a fixed order, those with hard edges first. Each is standardised, and from
each the quadratic regression on its predecessors is subtracted:

    z_k = (x_k - centre_k) / scale_k,     r_k = z_k - p_k(z_1, ..., z_{k-1})

The map is triangular with ones on the diagonal, so densities carry over up to the constant scale,
and it is inverted one coordinate after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

__all__ = ["QuadraticTrend", "fit_trend"]

CROSSED = 6
"""Products of two different predecessors count among the first so many coordinates."""
RIDGE = 1e-4


@dataclass(frozen=True)
class QuadraticTrend:
    """A fitted trend.

    Attributes
    ----------
    order : int64 ndarray, shape (d,)
        Coordinate taken at each place.
    centre, scale : ndarray, shape (d,)
        In that order.
    coefficients : ndarray, shape (d, f)
        Row k holds p_k on 1, z_i, then the products z_i z_j; unused places are zero.
    """

    order: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    coefficients: np.ndarray

    @property
    def log_scale(self) -> float:
        """ln |dx / dr|, a constant."""
        return float(np.log(self.scale).sum())

    def straighten(self, x: np.ndarray) -> np.ndarray:
        """Residuals r of points x, both of shape (n, d)."""
        z = np.ascontiguousarray((x[:, self.order] - self.centre) / self.scale)
        return _straighten(z, self.coefficients)

    def bend(self, r: np.ndarray) -> np.ndarray:
        """Points x of residuals r; inverse of :meth:`straighten`."""
        z = _bend(np.ascontiguousarray(r), self.coefficients) * self.scale + self.centre
        x = np.empty_like(z)
        x[:, self.order] = z
        return x


def fit_trend(points: np.ndarray, bounded: np.ndarray) -> QuadraticTrend:
    """Fit the trend to points of shape (n, d).

    Parameters
    ----------
    points : ndarray, shape (n, d)
    bounded : ndarray of bool, shape (d,)
        Coordinates with a hard edge; they come first and have no trend of their own, so that
        their edges stay where they are.
    """
    n, d = points.shape
    order = np.concatenate([np.flatnonzero(bounded), np.flatnonzero(~bounded)])
    x = points[:, order]
    centre, scale = x.mean(axis=0), x.std(axis=0)
    scale = np.where(scale > 1e-300, scale, 1.0)
    z = np.ascontiguousarray((x - centre) / scale)
    coefficients = np.zeros((d, _count(d - 1)))
    for k in range(int(bounded.sum()), d):
        size = _count(k)
        if n < 5 * size:
            continue
        features = _features(z, k)
        normal = features.T @ features + RIDGE * n * np.eye(size)
        coefficients[k, :size] = np.linalg.solve(normal, features.T @ z[:, k])
    return QuadraticTrend(order, centre, scale, coefficients)


@njit(cache=True, nogil=True)
def _count(k):
    """Number of features of k predecessors."""
    crossed = min(k, CROSSED)
    return 1 + 2 * k + crossed * (crossed - 1) // 2


@njit(cache=True, nogil=True)
def _fill(z, k, out):
    out[0] = 1.0
    m = 1
    for i in range(k):
        out[m] = z[i]
        out[m + 1] = z[i] * z[i] - 1.0
        m += 2
        if i < CROSSED:
            for j in range(i):
                out[m] = z[i] * z[j]
                m += 1
    return m


@njit(cache=True, nogil=True)
def _features(z, k):
    out = np.empty((z.shape[0], _count(k)))
    for i in range(z.shape[0]):
        _fill(z[i], k, out[i])
    return out


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _straighten(z, coefficients):
    n, d = z.shape
    out = np.empty((n, d))
    features = np.empty(_count(d))
    for i in range(n):
        _fill(z[i], d, features)
        for k in range(d):
            trend = 0.0
            for m in range(min(_count(k), coefficients.shape[1])):
                trend += coefficients[k, m] * features[m]
            out[i, k] = z[i, k] - trend
    return out


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _bend(r, coefficients):
    n, d = r.shape
    out = np.empty((n, d))
    features = np.empty(_count(d))
    for i in range(n):
        features[0] = 1.0
        filled = 1
        for k in range(d):
            trend = 0.0
            for m in range(min(filled, coefficients.shape[1])):
                trend += coefficients[k, m] * features[m]
            out[i, k] = r[i, k] + trend
            features[filled] = out[i, k]
            features[filled + 1] = out[i, k] * out[i, k] - 1.0
            filled += 2
            if k < CROSSED:
                for j in range(k):
                    features[filled] = out[i, k] * out[i, j]
                    filled += 1
    return out
