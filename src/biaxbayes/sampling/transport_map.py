"""A triangular transport map: curved and funnel-shaped densities become nearly Gaussian.

Coordinates are taken in a fixed order, those with bounds first, then those that set the width
of others (the noise sd does). Each is standardised; from each a quadratic regression on its
predecessors is subtracted, and the remainder is divided by a width, log-quadratic in them. In a
funnel the wide end would rule the regression, so rows are weighted by their inverse variance:

    z_k = (x_k - centre_k) / scale_k
    r_k = (z_k - p_k(z_1 ... z_{k-1})) exp(-s_k(z_1 ... z_{k-1}))

r are the reference coordinates. The map is triangular, so densities carry over with the factor
exp(-sum s_k), and it is inverted one coordinate after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CROSSED_COORDINATES = 6
"""Number of leading coordinates whose products with each other are terms."""
RIDGE_PENALTY = 1e-4
WIDTH_RIDGE_PENALTY = 1e-2
SATURATION = 4.0
"""The map stops following predecessors beyond this many standard deviations."""
MAX_LOG_WIDTH = 4.0
"""Limit of |s_k|."""
REGRESSION_ROUNDS = 3
"""Rounds of regression: on the points, on their scatter, on the points weighted by it."""


@dataclass(frozen=True)
class TransportMap:
    """A fitted map."""

    order: np.ndarray  # (d,): coordinate taken at each place
    centre: np.ndarray  # (d,), in that order
    scale: np.ndarray
    # (d, f): row k holds p_k on :func:`mean_terms`; zero for other than predecessors
    coefficients: np.ndarray
    widths: np.ndarray  # (d, 2 d): row k holds s_k on z_1, z_1^2 - 1, z_2, z_2^2 - 1, ..., likewise

    def to_reference(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reference coordinates r of points x, shape (n, d), and ln |dr/dx| of each."""
        z = (x[:, self.order] - self.centre) / self.scale
        mean = mean_terms(z) @ self.coefficients.T
        width = np.clip(width_terms(z) @ self.widths.T, -MAX_LOG_WIDTH, MAX_LOG_WIDTH)
        return (z - mean) * np.exp(-width), -width.sum(axis=1) - np.log(self.scale).sum()

    def from_reference(self, r: np.ndarray) -> np.ndarray:
        """Points x of reference coordinates r; inverse of :meth:`to_reference`."""
        z = np.empty_like(r)
        for k in range(r.shape[1]):
            terms = mean_terms(z[:, :k])
            mean = terms @ self.coefficients[k, : terms.shape[1]]
            width = width_terms(z[:, :k]) @ self.widths[k, : 2 * k]
            z[:, k] = r[:, k] * np.exp(np.clip(width, -MAX_LOG_WIDTH, MAX_LOG_WIDTH)) + mean
        x = np.empty_like(z)
        x[:, self.order] = z * self.scale + self.centre
        return x

    @classmethod
    def identity(cls, dimension: int) -> TransportMap:
        """The map that changes nothing."""
        d = dimension
        terms = mean_terms(np.zeros((1, d))).shape[1]
        return cls(
            np.arange(d), np.zeros(d), np.ones(d), np.zeros((d, terms)), np.zeros((d, 2 * d))
        )


def mean_terms(z: np.ndarray) -> np.ndarray:
    """Terms of the quadratic regressions: 1, then z_k, z_k^2 - 1 and z_k z_j, j < k, for each k."""
    n, d = z.shape
    crossed = min(d, CROSSED_COORDINATES)
    out = np.ones((n, 1 + 2 * d + crossed * (crossed - 1) // 2))
    z = np.clip(z, -SATURATION, SATURATION)
    end = 1
    for k in range(d):
        out[:, end], out[:, end + 1] = z[:, k], z[:, k] ** 2 - 1.0
        end += 2
        if k < CROSSED_COORDINATES:
            out[:, end : end + k] = z[:, k, None] * z[:, :k]
            end += k
    return out


def width_terms(z: np.ndarray) -> np.ndarray:
    """Terms of the log widths: z_k and z_k^2 - 1 for each k."""
    z = np.clip(z, -SATURATION, SATURATION)
    return np.stack([z, z * z - 1.0], axis=2).reshape(len(z), 2 * z.shape[1])


def fit_transport_map(points: np.ndarray, bounded: np.ndarray) -> TransportMap:
    """Fit the map to points (n, d); bounded coordinates come first and are only standardised."""
    n, d = points.shape
    order = _order(points, bounded)
    x = points[:, order]
    centre, scale = x.mean(axis=0), x.std(axis=0)
    scale = np.where(scale > 1e-300, scale, 1.0)
    z = (x - centre) / scale
    coefficients, widths = np.zeros((d, mean_terms(z[:1]).shape[1])), np.zeros((d, 2 * d))
    for k in range(int(bounded.sum()), d):
        means, logs = mean_terms(z[:, :k]), width_terms(z[:, :k])
        if n >= 5 * means.shape[1]:
            row, slopes = _heteroscedastic(means, logs, z[:, k])
            coefficients[k, : row.size], widths[k, : 2 * k] = row, slopes
    return TransportMap(order, centre, scale, coefficients, widths)


def _order(points: np.ndarray, bounded: np.ndarray) -> np.ndarray:
    """Bounded coordinates first, then those that set the widths of others."""
    z = points - points.mean(axis=0)
    sd = z.std(axis=0)
    z = z / np.where(sd > 0.0, sd, 1.0)
    logs = np.log(np.abs(z) + 1e-3)
    logs = (logs - logs.mean(axis=0)) / (logs.std(axis=0) + 1e-12)
    # Squared correlation of coordinate j with the log distances of the others from their means.
    predicts = (z.T @ logs / len(z)) ** 2
    np.fill_diagonal(predicts, 0.0)
    return np.lexsort([-predicts.sum(axis=1), ~bounded])


def _heteroscedastic(
    means: np.ndarray, logs: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the mean and of the log width, regressed in turn."""
    s, slopes = np.zeros(len(target)), np.zeros(logs.shape[1])
    terms = np.column_stack([np.ones(len(target)), logs])
    row = np.empty(0)
    for _ in range(REGRESSION_ROUNDS):
        weight = np.exp(-2.0 * s)
        row = _regression(means, target, RIDGE_PENALTY, weight / weight.mean())
        left = (target - means @ row) * np.exp(-s)
        # ln |left| of a Gaussian scatters by 1.1 whatever its width; its mean follows ln width.
        spread = np.log(np.abs(left) + 1e-3 * left.std() + 1e-300) + s
        spread -= spread.mean()  # the log width is free up to a constant
        slopes = _regression(terms, spread, WIDTH_RIDGE_PENALTY, np.ones(len(s)))[1:]
        s = np.clip(logs @ slopes, -MAX_LOG_WIDTH, MAX_LOG_WIDTH)
    return row, slopes


def _regression(
    terms: np.ndarray, target: np.ndarray, ridge: float, weight: np.ndarray
) -> np.ndarray:
    """Weighted least squares with a ridge penalty."""
    n, size = terms.shape
    weighted = terms * weight[:, None]
    return np.linalg.solve(weighted.T @ terms + ridge * n * np.eye(size), weighted.T @ target)
