"""Groups of near points: k-means, and a mixture of Gaussians by expectation maximisation.

scikit-learn does both, at the price of an import that takes as long as all the fits of a run, and
of three times their time for points as few as ours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Gaussians", "fit_gaussians", "groups_of"]

LEAST_VARIANCE = 1e-6
"""Added to every variance: a component may have few points, or points on a line."""
ROUNDS, SETTLED = 50, 2e-3
"""Most rounds, and the rise of the mean log likelihood at which they end."""
STARTS, MOST_MOVES = 4, 100


class Gaussians(NamedTuple):
    """A mixture of k Gaussians.

    Attributes
    ----------
    weights : ndarray, shape (k,)
    means : ndarray, shape (k, d)
    covariances : ndarray, shape (k, d, d)
    """

    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray


def fit_gaussians(points: np.ndarray, rng: np.random.Generator, count: int) -> Gaussians:
    """Fit a mixture of so many Gaussians to points by expectation maximisation.

    Parameters
    ----------
    points : ndarray, shape (n, d)
        Roughly standardised.
    rng : numpy.random.Generator
    count : int
    """
    n, d = points.shape
    rows, columns = np.triu_indices(d)
    # Sums over points are sums of 1, x_i and x_i x_j, and log densities are linear in them.
    features = np.hstack([np.ones((n, 1)), points, points[:, rows] * points[:, columns]])
    nearest = _distances(points, points[_far_apart(points, rng, count)]).argmin(axis=1)
    share = np.zeros((n, count))
    share[np.arange(n), nearest] = 1.0
    before = -np.inf
    for _ in range(ROUNDS):
        found = _of_sums(share.T @ features, rows, columns)
        logs = features @ _coefficients(found, rows, columns)
        top = logs.max(axis=1, keepdims=True)
        share = np.exp(logs - top)
        total = share.sum(axis=1, keepdims=True)
        share /= total
        likelihood = float((top + np.log(total)).mean())
        if abs(likelihood - before) < SETTLED:
            break
        before = likelihood
    return found


def _of_sums(sums: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> Gaussians:
    """Gaussians from the weighted sums of 1, x_i and x_i x_j, shape (k, features)."""
    counts = sums[:, 0] + 1e-12
    d = int(rows[-1]) + 1
    means = sums[:, 1 : d + 1] / counts[:, None]
    covariances = np.empty((len(counts), d, d))
    # cov_ij = <x_i x_j> - <x_i> <x_j>
    upper = sums[:, d + 1 :] / counts[:, None] - means[:, rows] * means[:, columns]
    covariances[:, rows, columns] = covariances[:, columns, rows] = upper
    covariances[:, range(d), range(d)] += LEAST_VARIANCE
    return Gaussians(counts / counts.sum(), means, covariances)


def _coefficients(found: Gaussians, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Ln (weight density) of each Gaussian on 1, x_i and x_i x_j, shape (features, k)."""
    d = found.means.shape[1]
    precision = np.linalg.inv(found.covariances)
    slope = np.einsum("kij,kj->ki", precision, found.means)
    # ln w N(x) = ln w - (d ln 2 pi + ln |S| + m S^-1 m) / 2 + (S^-1 m) x - x S^-1 x / 2
    constant = np.log(found.weights) - 0.5 * (
        d * np.log(2.0 * np.pi)
        + np.linalg.slogdet(found.covariances)[1]
        + (slope * found.means).sum(axis=1)
    )
    twice = np.where(rows == columns, 1.0, 2.0)
    square = -0.5 * twice * precision[:, rows, columns]
    return np.hstack([constant[:, None], slope, square]).T


def groups_of(points: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Label of each of n points by k-means, the best of several starts; shape (n,)."""
    best, labels = np.inf, np.zeros(len(points), dtype=int)
    for _ in range(STARTS):
        centres = points[_far_apart(points, rng, count)]
        label = np.full(len(points), -1)
        for _ in range(MOST_MOVES):
            distances = _distances(points, centres)
            moved = distances.argmin(axis=1)
            if (moved == label).all():
                break
            label = moved
            for k in np.unique(label):
                centres[k] = points[label == k].mean(axis=0)
        cost = float(distances.min(axis=1).sum())
        if cost < best:
            best, labels = cost, label
    return labels


def _distances(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Squared distances, shape (n, k)."""
    return np.stack([((points - centre) ** 2).sum(axis=1) for centre in centres], axis=1)


def _far_apart(points: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Indices of points that are far from each other: greedy k-means++.

    Arthur and Vassilvitskii, Proceedings of SODA 2007, 1027: the next one is drawn with a
    probability in proportion to its squared distance from those there are. Of several so drawn
    the one is taken that brings all points nearest.
    """
    chosen = [int(rng.integers(len(points)))]
    distance = _distances(points, points[chosen])[:, 0]
    tries = 2 + int(np.log(count))
    for _ in range(count - 1):
        reach = np.cumsum(distance)
        drawn = np.searchsorted(reach, rng.random(tries) * reach[-1], side="right")
        drawn = np.minimum(drawn, len(points) - 1)
        left = np.minimum(distance[:, None], _distances(points, points[drawn]))
        best = int(left.sum(axis=0).argmin())
        chosen.append(int(drawn[best]))
        distance = left[:, best]
    return np.array(chosen)
