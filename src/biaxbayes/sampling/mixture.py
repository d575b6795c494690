"""Mixtures of multivariate Student t distributions, and Gaussian mixtures fitted to points."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.cluster.vq import kmeans, vq
from scipy.special import logsumexp

DEGREES_OF_FREEDOM = 6.0
"""Degrees of freedom: tails heavier than those of any posterior that falls like a Gaussian."""
MAX_ITERATIONS = 50
EM_TOLERANCE = 2e-3
"""Rise of the mean log density at which expectation maximisation ends."""
VARIANCE_FLOOR = 1e-6
"""Added to the variances; coordinates are roughly standardised."""
MIN_WEIGHT = 1e-4
KMEANS_STARTS = 4
"""Starts of k-means, the best of which counts: with one alone the fit to a bent density of twenty
coordinates was worse."""


@dataclass(frozen=True)
class StudentMixture:
    """A mixture of K Student t components in d dimensions."""

    weights: np.ndarray  # (K,)
    means: np.ndarray  # (K, d)
    factors: np.ndarray  # (K, d, d): lower Cholesky factors L of the scale matrices
    inverses: np.ndarray = field(init=False)  # L^-1

    def __post_init__(self) -> None:
        object.__setattr__(self, "inverses", np.linalg.inv(self.factors))

    def density(self, x: np.ndarray) -> np.ndarray:
        """Density at points of shape (n, d); shape (n,)."""
        d, nu = self.means.shape[1], DEGREES_OF_FREEDOM
        # Gamma((nu + d) / 2) / (Gamma(nu / 2) (nu pi)^(d / 2) |L|)
        log_norm = math.lgamma(0.5 * (nu + d)) - math.lgamma(0.5 * nu)
        log_norm -= 0.5 * d * math.log(nu * math.pi)
        log_det = np.log(np.diagonal(self.factors, axis1=1, axis2=2)).sum(axis=1)
        scale = self.weights * np.exp(log_norm - log_det)
        # sum_k scale_k (1 + |L_k^-1 (x - m_k)|^2 / nu)^(-(nu + d) / 2)
        distance = squared_distances(x, self.means, self.inverses)
        return np.asarray((1.0 + distance / nu) ** (-0.5 * (nu + d)) @ scale)

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size, d)."""
        component = rng.choice(len(self.weights), size, p=self.weights)
        z = rng.standard_normal((size, self.means.shape[1]))
        z *= np.sqrt(DEGREES_OF_FREEDOM / rng.chisquare(DEGREES_OF_FREEDOM, size))[:, None]
        return self.means[component] + np.einsum("nab,nb->na", self.factors[component], z)


def squared_distances(x: np.ndarray, means: np.ndarray, inverses: np.ndarray) -> np.ndarray:
    """|L_k^-1 (x - m_k)|^2 of points (n, d) from every component; shape (n, K)."""
    count, d = means.shape
    z = x @ inverses.reshape(count * d, d).T
    z -= np.einsum("kab,kb->ka", inverses, means).ravel()
    z = z.reshape(len(x), count, d)
    return np.asarray(np.einsum("nkd,nkd->nk", z, z))


def fit_mixture(
    points: np.ndarray, rng: np.random.Generator, *, components: int = 6
) -> StudentMixture:
    """Fit a Gaussian mixture to points (n, d) by expectation maximisation.

    The covariances become the scale matrices of Student t distributions. There are fewer
    ``components`` where the points, roughly standardised, could not determine them.
    """
    n, d = points.shape
    # A component needs several times d points for a usable covariance.
    components = max(1, min(components, n // (5 * (d + 1))))
    centres, _ = kmeans(points, components, iter=KMEANS_STARTS, seed=rng)
    # (n, K): responsibility of each component for each point
    responsibility = np.eye(len(centres))[vq(points, centres)[0]]
    last = -np.inf
    for _ in range(MAX_ITERATIONS):
        # m_k = sum_i r_ik x_i / n_k,  S_k = sum_i r_ik (x_i - m_k)(x_i - m_k)^T / n_k
        totals = responsibility.sum(axis=0) + 10.0 * np.finfo(float).eps
        means = responsibility.T @ points / totals[:, None]
        offsets = [points - mean for mean in means]
        scatter = np.array([(r * o.T) @ o for r, o in zip(responsibility.T, offsets, strict=True)])
        factors = np.linalg.cholesky(scatter / totals[:, None, None] + VARIANCE_FLOOR * np.eye(d))
        # r_ik = w_k N(x_i; m_k, S_k) / sum_j w_j N(x_i; m_j, S_j)
        log_det = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
        log_joint = np.log(totals / totals.sum()) - log_det - 0.5 * d * math.log(2.0 * math.pi)
        log_joint = log_joint - 0.5 * squared_distances(points, means, np.linalg.inv(factors))
        log_density = logsumexp(log_joint, axis=1, keepdims=True)
        responsibility = np.exp(log_joint - log_density)
        if abs(log_density.mean() - last) < EM_TOLERANCE:
            break
        last = log_density.mean()
    weights = np.maximum(totals / totals.sum(), MIN_WEIGHT)
    return StudentMixture(weights / weights.sum(), means, factors)
