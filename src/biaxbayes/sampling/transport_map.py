"""A triangular transport map: curved and funnel-shaped densities become nearly Gaussian.

Coordinates are taken in a fixed order, those with bounds first, then those that set the width
of others (the noise sd does). Each is standardised; from each a quadratic regression on its
predecessors is subtracted, and what is left is divided by a width, log-quadratic in them. In a
funnel the wide end would rule the regression, so rows are weighted by their inverse variance:

    z_k = (x_k - centre_k) / scale_k
    r_k = (z_k - p_k(z_1 ... z_{k-1})) exp(-s_k(z_1 ... z_{k-1}))

r are the reference coordinates. The map is triangular, so densities carry over with the factor
exp(-sum s_k), and it is inverted one coordinate after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from biaxbayes.compilation import compiled, inlined

__all__ = ["TransportMap", "fit_transport_map"]

CROSSED = 6
"""Products of two different predecessors count among the first so many coordinates."""
RIDGE = 1e-4
WIDTH_RIDGE = 1e-2
SATURATION = 4.0
"""The map stops following predecessors beyond this many standard deviations."""
WIDEST = 4.0
"""Limit of |s_k|."""
REWEIGHTED = 3
"""Rounds of regression: on the points, on how far they scatter, on the points so weighted."""
SCREENED = 600
"""Points on which orders of the coordinates are compared."""


@dataclass(frozen=True)
class TransportMap:
    """A fitted map.

    Attributes
    ----------
    order : int64 ndarray, shape (d,)
        Coordinate taken at each place.
    centre, scale : ndarray, shape (d,)
        In that order.
    coefficients : ndarray, shape (d, f)
        Row k holds p_k on 1, z_i, then the products z_i z_j; unused places are zero.
    widths : ndarray, shape (d, 2 d + 1)
        Row k holds s_k on 1, the z_i, and their squares less one.
    """

    order: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    coefficients: np.ndarray
    widths: np.ndarray

    def to_reference(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reference coordinates r of points x, shape (n, d), and ln |dr/dx| of each."""
        z = np.ascontiguousarray((x[:, self.order] - self.centre) / self.scale)
        r, log_jacobian = _to_reference(z, self.coefficients, self.widths)
        return r, log_jacobian - float(np.log(self.scale).sum())

    def from_reference(self, r: np.ndarray) -> np.ndarray:
        """Points x of reference coordinates r; inverse of :meth:`to_reference`."""
        z = _from_reference(np.ascontiguousarray(r), self.coefficients, self.widths)
        x = np.empty_like(z)
        x[:, self.order] = z * self.scale + self.centre
        return x

    @classmethod
    def identity(cls, dimension: int) -> TransportMap:
        """The map that changes nothing."""
        d = dimension
        return cls(np.arange(d), np.zeros(d), np.ones(d), np.zeros((d, 1)), np.zeros((d, 1)))


def fit_transport_map(
    points: np.ndarray, bounded: np.ndarray, *, screen: bool = True
) -> TransportMap:
    """Fit the map to points of shape (n, d).

    Parameters
    ----------
    points : ndarray, shape (n, d)
    bounded : ndarray of bool, shape (d,)
        Coordinates with a finite bound; they come first and keep their own shape, so that
        their bounds stay where they are.
    screen : bool
        Try several orders of the other coordinates and keep the best; else one is guessed.
    """
    if not screen:
        return _in_order(points, _orders(points, bounded)[0], int(bounded.sum()))[0]
    few = points[:: max(1, len(points) // SCREENED)]
    orders = _orders(few, bounded)
    scores = [_in_order(few, order, int(bounded.sum()))[1] for order in orders]
    return _in_order(points, orders[int(np.argmin(scores))], int(bounded.sum()))[0]


def _in_order(points: np.ndarray, order: np.ndarray, first: int) -> tuple[TransportMap, float]:
    """The map for one order of the coordinates, and its score.

    The score is the entropy that Gaussian residuals would have, ``sum_k <s_k> + ln sd(r_k)`` and
    a constant: the lower, the better the map describes the points.
    """
    n, d = points.shape
    x = points[:, order]
    centre, scale = x.mean(axis=0), x.std(axis=0)
    scale = np.where(scale > 1e-300, scale, 1.0)
    z = np.ascontiguousarray((x - centre) / scale)
    coefficients, widths = np.zeros((d, _count(d - 1))), np.zeros((d, 2 * d + 1))
    score = 0.0
    for k in range(first, d):
        size = _count(k)
        if n < 5 * size:
            continue
        features = _features(z, k)
        near = np.clip(z[:, :k], -SATURATION, SATURATION)
        spreads = np.column_stack([np.ones(n), near, near * near - 1.0])
        row, slopes, s = _heteroscedastic(features, spreads, z[:, k])
        coefficients[k, :size] = row
        widths[k, : k + 1], widths[k, d + 1 : d + 1 + k] = slopes[: k + 1], slopes[k + 1 :]
        residual = (z[:, k] - features @ row) * np.exp(-s)
        score += float(s.mean() + np.log(residual.std() + 1e-300))
    return TransportMap(order, centre, scale, coefficients, widths), score


def _heteroscedastic(
    features: np.ndarray, spreads: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and log width regressed in turn; coefficients of both, and the log width at each point.

    The log width is free up to a constant: its first coefficient is zero.
    """
    s = np.zeros(len(target))
    row, slopes = np.empty(0), np.empty(0)
    for _ in range(REWEIGHTED if spreads.shape[1] > 1 else 1):
        weight = np.exp(-2.0 * s)
        row = _regression(features, target, RIDGE, weight / weight.mean())
        left = (target - features @ row) * np.exp(-s)
        # ln |left| of a Gaussian scatters by 1.1 whatever its width; its mean follows ln width.
        logs = np.log(np.abs(left) + 1e-3 * left.std() + 1e-300) + s
        slopes = _regression(spreads, logs - logs.mean(), WIDTH_RIDGE)
        slopes[0] = 0.0
        s = np.clip(spreads @ slopes, -WIDEST, WIDEST)
    return row, slopes, s


def _orders(points: np.ndarray, bounded: np.ndarray) -> list[np.ndarray]:
    """Orders to choose from: bounded coordinates, any other, then those that set widths."""
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
    free = free[np.argsort(-influence[free], kind="stable")]
    return [
        np.concatenate([np.flatnonzero(bounded), [first], free[free != first]]) for first in free
    ] or [np.flatnonzero(bounded)]


def _regression(
    features: np.ndarray, target: np.ndarray, ridge: float, weight: np.ndarray | None = None
) -> np.ndarray:
    n, size = features.shape
    weighted = features if weight is None else features * weight[:, None]
    return np.linalg.solve(weighted.T @ features + ridge * n * np.eye(size), weighted.T @ target)


@inlined
def _count(k: int) -> int:
    """Number of features of k predecessors."""
    crossed = min(k, CROSSED)
    return 1 + 2 * k + crossed * (crossed - 1) // 2


@njit(nogil=True, forceinline=True)
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


@compiled(nogil=True)
def _features(z, k):
    out = np.empty((z.shape[0], _count(k)))
    for i in range(z.shape[0]):
        out[i, 0] = 1.0
        filled = 1
        for j in range(k):
            filled = _append(z[i], j, out[i], filled)
    return out


@njit(nogil=True, fastmath={"reassoc", "contract", "nsz"}, forceinline=True)
def _place(features, filled, z, k, coefficients, widths):
    """(p_k, s_k) given the features of the predecessors."""
    mean = 0.0
    for m in range(min(filled, coefficients.shape[1])):
        mean += coefficients[k, m] * features[m]
    width = 0.0
    d = (widths.shape[1] - 1) // 2
    for i in range(min(k, d)):
        x = min(max(z[i], -SATURATION), SATURATION)
        width += widths[k, 1 + i] * x + widths[k, 1 + d + i] * (x * x - 1.0)
    return mean, min(max(width, -WIDEST), WIDEST)


@compiled(nogil=True)
def _to_reference(z, coefficients, widths):
    n, d = z.shape
    out = np.empty((n, d))
    log_jacobian = np.zeros(n)
    features = np.empty(_count(d))
    features[0] = 1.0
    for i in range(n):
        filled = 1
        for k in range(d):
            mean, width = _place(features, filled, z[i], k, coefficients, widths)
            out[i, k] = (z[i, k] - mean) * np.exp(-width)
            log_jacobian[i] -= width
            filled = _append(z[i], k, features, filled)
    return out, log_jacobian


@compiled(nogil=True)
def _from_reference(r, coefficients, widths):
    n, d = r.shape
    out = np.empty((n, d))
    features = np.empty(_count(d))
    features[0] = 1.0
    for i in range(n):
        filled = 1
        for k in range(d):
            mean, width = _place(features, filled, out[i], k, coefficients, widths)
            out[i, k] = r[i, k] * np.exp(width) + mean
            filled = _append(out[i], k, features, filled)
    return out
