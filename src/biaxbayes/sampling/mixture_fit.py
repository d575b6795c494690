"""Mixtures fitted to points by expectation maximisation, and groups of points by k-means.

A warm-up fits ten mixtures or more. scikit-learn's ``GaussianMixture`` and ``KMeans``, which give
the same from the same random numbers, take half a second and 50 MB to be imported and nearly twice
as long for so few points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from biaxbayes.sampling.student_mixture import StudentMixture

__all__ = ["fit_gaussians", "fit_mixture", "groups", "mixture_seed", "spread_points"]

MOST_ROUNDS = 50
LEAST_RISE = 2e-3
"""Rise of the mean log density below which the fit ends."""
FLOOR = 1e-6
"""Added to the variances; coordinates are roughly standardised."""


# --- seeds ----------------------------------------------------------------------------------------


def mixture_seed(rng: np.random.Generator) -> int:
    """A seed of the random numbers with which a mixture or groups are begun."""
    return int(rng.integers(2**31))


def spread_points(x: np.ndarray, count: int, random: np.random.RandomState) -> np.ndarray:
    """Choose points far from one another: k-means++ (Arthur and Vassilvitskii, SODA 2007).

    The first is any; each other is, of 2 + ln(count) tried ones, that which leaves the least sum of
    squared distances to the nearest chosen point.

    Parameters
    ----------
    x : ndarray, shape (n, d)
    count : int
    random : numpy.random.RandomState

    Returns
    -------
    int64 ndarray, shape (count,)
        Rows of ``x``.
    """
    n, tries = len(x), 2 + int(np.log(count))
    norm, ones = np.einsum("ij,ij->i", x, x), np.ones((n, 1))

    def squared(rows: np.ndarray) -> np.ndarray:
        # |a - b|^2 = |a|^2 - 2 a.b + |b|^2, which rounding may leave below zero
        found = -2.0 * (x[rows] @ x.T)
        found += norm[rows, None]
        found += norm
        return np.maximum(found, 0.0, out=found)

    chosen = np.empty(count, dtype=np.int64)
    chosen[0] = random.choice(n, p=np.full(n, 1.0 / n))
    nearest = squared(chosen[:1])[0]
    total = nearest @ ones
    for k in range(1, count):
        # with a probability in proportion to the squared distance to the nearest chosen point
        tried = np.searchsorted(np.cumsum(nearest), random.uniform(size=tries) * total)
        tried = np.minimum(tried, n - 1)
        left = np.minimum(nearest, squared(tried))
        totals = left @ ones
        best = int(np.argmin(totals))
        chosen[k], nearest, total = tried[best], left[best], totals[best]
    return chosen


# --- k-means --------------------------------------------------------------------------------------


RESTARTS, MOST_STEPS = 4, 300
SETTLED = 1e-4
"""Squared shift of all centres, over the mean variance, at which the groups are kept."""


def groups(x: np.ndarray, count: int, random: np.random.RandomState) -> np.ndarray:
    """Groups of near points by k-means (Lloyd's algorithm), the best of several starts.

    Parameters
    ----------
    x : ndarray, shape (n, d)
    count : int
    random : numpy.random.RandomState

    Returns
    -------
    int64 ndarray, shape (n,)
        The group of each point.
    """
    x = x - x.mean(axis=0)
    starts = [x[spread_points(x, count, random)] for _ in range(RESTARTS)]
    best, least = None, np.inf
    for label, within in _settled(x, starts):
        # The same groups by other numbers are no better, whatever rounding says.
        if best is None or (within < least and np.unique(label * count + best).size > count):
            best, least = label, within
    assert best is not None
    return best


def _settled(x: np.ndarray, starts: Sequence[np.ndarray]) -> list[tuple[np.ndarray, float]]:
    """Groups that each set of first centres leads to, and their sums of squared distances."""
    tolerance = SETTLED * x.var(axis=0).mean()
    found = []
    for centres in starts:
        label = _nearest(x, centres)
        for _ in range(MOST_STEPS):
            moved = _means(x, label, centres)
            shift = float(((moved - centres) ** 2).sum())
            centres, before = moved, label
            label = _nearest(x, centres)
            if shift <= tolerance or np.array_equal(label, before):
                break
        found.append((label, float(((x - centres[label]) ** 2).sum())))
    return found


def _nearest(x: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """The centre that each point is nearest to."""
    squared = (centres**2).sum(axis=1) - 2.0 * (x @ centres.T)
    return np.asarray(squared.argmin(axis=1))


def _means(x: np.ndarray, label: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Means of the groups; an empty group keeps its centre."""
    count = len(centres)
    size = np.bincount(label, minlength=count)[:, None]
    sums = np.array([np.bincount(label, column, count) for column in x.T]).T
    return np.where(size > 0, sums / np.maximum(size, 1), centres)


# --- expectation maximisation ---------------------------------------------------------------------


def fit_mixture(points: np.ndarray, seed: int, *, components: int = 6) -> StudentMixture:
    """Fit a Gaussian mixture to points and make its tails heavier.

    The covariances of the Gaussians are kept as scale matrices of Student t distributions.

    Parameters
    ----------
    points : ndarray, shape (n, d)
        Roughly standardised.
    seed : int
        From :func:`mixture_seed`.
    components : int
        Upper limit; fewer where the points could not determine them.

    Returns
    -------
    StudentMixture
    """
    n, d = points.shape
    # A component needs several times d points to have a covariance worth the name.
    components = max(1, min(components, n // (5 * (d + 1))))
    random = np.random.RandomState(seed)
    weights, means, covariances = fit_gaussians(points, components, random)
    weights = np.maximum(weights, 1e-4)
    return StudentMixture.from_factors(
        weights / weights.sum(), means, np.linalg.cholesky(covariances)
    )


def fit_gaussians(
    points: np.ndarray, components: int, random: np.random.RandomState
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit a Gaussian mixture by expectation maximisation.

    Parameters
    ----------
    points : ndarray, shape (n, d)
        Roughly standardised.
    components : int
        K, at most n.
    random : numpy.random.RandomState

    Returns
    -------
    weights : ndarray, shape (K,)
    means : ndarray, shape (K, d)
    covariances : ndarray, shape (K, d, d)

    Raises
    ------
    ValueError
        If a point is not finite.
    """
    if not np.isfinite(points).all():
        raise ValueError("a mixture is fitted to finite points")
    share = np.zeros((len(points), components))
    share[spread_points(points, components, random), np.arange(components)] = 1.0
    totals, means, covariances, inverses = _maximisation(points, share)
    weights, last = totals / len(points), -np.inf
    for _ in range(MOST_ROUNDS):
        mean_log, share = _expectation(points, weights, means, inverses)
        totals, means, covariances, inverses = _maximisation(points, share)
        weights = totals / totals.sum()
        if abs(mean_log - last) < LEAST_RISE:
            break
        last = mean_log
    return weights, means, covariances


def _maximisation(
    x: np.ndarray, share: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sums of the shares (n, K), means, covariances S = L L^T and L^-T of the components."""
    d = x.shape[1]
    # m_k = sum_i r_ik x_i / sum_i r_ik
    totals = share.sum(axis=0) + 10.0 * np.finfo(float).eps
    means = (share.T @ x) / totals[:, None]
    covariances, inverses = np.empty((2, len(totals), d, d))
    for k, total in enumerate(totals):
        # S_k = sum_i r_ik (x_i - m_k)(x_i - m_k)^T / sum_i r_ik = L_k L_k^T
        offset = x - means[k]
        covariance = ((share[:, k] * offset.T) @ offset) / total
        covariance.flat[:: d + 1] += FLOOR
        factor, refused = dpotrf(covariance, lower=True)
        if refused:
            raise np.linalg.LinAlgError("the covariance of a component is not positive definite")
        covariances[k], inverses[k] = covariance, dtrtrs(factor, np.eye(d), lower=True)[0].T
    return totals, means, covariances, inverses


def _expectation(
    x: np.ndarray, weights: np.ndarray, means: np.ndarray, inverses: np.ndarray
) -> tuple[float, np.ndarray]:
    """Mean log density of the points, and the share (n, K) of each component in each."""
    (n, d), count = x.shape, len(weights)
    log_share = np.empty((count, n))  # a row a component: NumPy is slow along short rows
    for k in range(count):
        # |z|^2, z = L^-1 (x - m)
        z = inverses[k].T @ x.T
        z -= (means[k] @ inverses[k])[:, None]
        log_share[k] = _sum_of_rows(np.square(z, out=z))
    # log w_k N(x; m_k, S_k)
    log_share += d * math.log(2.0 * math.pi)
    log_share *= -0.5
    log_share += np.log(inverses.reshape(count, -1)[:, :: d + 1]).sum(axis=1)[:, None]
    log_share += np.log(weights)[:, None]
    # log sum_k exp(l_k) = l_top + log1p(sum of the others' exp(l_k - l_top))
    top = log_share.max(axis=0)
    others = log_share - top
    is_top = others == 0.0
    np.exp(others, out=others)
    others[is_top] = 0.0
    equal = is_top.sum(axis=0, dtype=float)
    log_density = np.log1p(_sum_of_rows(others) / equal) + np.log(equal) + top
    log_share -= log_density
    return float(log_density.mean()), np.ascontiguousarray(np.exp(log_share, out=log_share).T)


def _sum_of_rows(rows: np.ndarray) -> np.ndarray:
    """Sum over the first axis in the order in which NumPy adds up a row of a matrix.

    Eight running sums, which are then added in pairs: its rounding, a third of the time.
    """
    count = len(rows)
    if count < 8:
        return np.asarray(rows.sum(axis=0))
    whole = count - count % 8
    running = rows[:8].copy()
    for k in range(8, whole, 8):
        running += rows[k : k + 8]
    for apart in (1, 2, 4):
        running[:: 2 * apart] += running[apart :: 2 * apart]
    for row in rows[whole:]:
        running[0] += row
    return np.asarray(running[0])
