"""A mixture of multivariate Student t distributions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numba import njit

from biaxbayes.compilation import compiled, inlined

__all__ = ["Mirrors", "StudentMixture"]

BLOCK = 160  # points evaluated side by side
DEGREES = (
    6.0  # of freedom, a whole number: tails heavier than any posterior that falls like a Gaussian
)


class Mirrors(NamedTuple):
    """Reflections of a point at bounds, each at one bound or at several in turn.

    Attributes
    ----------
    coordinates : int64 ndarray, shape (b,)
        Coordinates that have a finite bound.
    doubled : ndarray, shape (s, b)
        Twice the bound that each is reflected at in each of s images; NaN where it is not.
    """

    coordinates: np.ndarray
    doubled: np.ndarray

    @classmethod
    def at(cls, bounds: np.ndarray) -> Mirrors:
        """Every way to reflect at bounds of shape (d, 2), infinite where there is none."""
        bounded = np.flatnonzero(np.isfinite(bounds).any(axis=1))
        ways = [[np.nan, *(2.0 * e for e in bounds[j] if np.isfinite(e))] for j in bounded]
        doubled = list(product(*ways))[1:]  # the first reflects nothing
        return cls(bounded, np.array(doubled, dtype=float).reshape(len(doubled), len(bounded)))


@dataclass(frozen=True)
class StudentMixture:
    """A frozen mixture of K Student t components in d dimensions.

    Attributes
    ----------
    weights : ndarray, shape (K,)
    means : ndarray, shape (K, d)
    factors : ndarray, shape (K, d, d)
        Lower Cholesky factors of the scale matrices.
    inverses : ndarray, shape (K, d, d)
        Inverses of the factors, lower triangular.
    degrees : float
        Degrees of freedom.
    """

    weights: np.ndarray
    means: np.ndarray
    factors: np.ndarray
    inverses: np.ndarray
    degrees: float = DEGREES

    def log_density(self, x: np.ndarray, mirrors: Mirrors | None = None) -> np.ndarray:
        """Log density at points of shape (n, d); shape (n,).

        Parameters
        ----------
        x : ndarray, shape (n, d)
        mirrors : Mirrors, optional
            Images of each point whose densities are added to its own.
        """
        if mirrors is None:
            mirrors = Mirrors(np.empty(0, dtype=np.int64), np.empty((0, 0)))
        top, scale = self._scale
        return top + _log_density(
            np.ascontiguousarray(x.T),
            scale,
            self.means,
            self.inverses,
            self.degrees,
            *mirrors,
        )

    @cached_property
    def _scale(self) -> tuple[float, np.ndarray]:
        """Weights times the normalisers of the t densities: log of the largest, all over that."""
        d, nu = self.means.shape[1], self.degrees
        log_norm = (
            math.lgamma(0.5 * (nu + d)) - math.lgamma(0.5 * nu) - 0.5 * d * math.log(nu * math.pi)
        )
        log_det = np.log(np.diagonal(self.factors, axis1=1, axis2=2)).sum(axis=1)
        log_scale = np.log(self.weights) + log_norm - log_det
        top = float(log_scale.max())
        return top, np.exp(log_scale - top)

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size, d)."""
        d, nu = self.means.shape[1], self.degrees
        component = np.searchsorted(np.cumsum(self.weights), rng.random(size), side="right")
        component = np.minimum(component, self.weights.size - 1)
        z = rng.standard_normal((size, d))
        stretch = np.sqrt(nu / rng.chisquare(nu, size))
        return _transform(z, component, stretch, self.means, self.factors)

    @classmethod
    def from_factors(
        cls, weights: np.ndarray, means: np.ndarray, factors: np.ndarray
    ) -> StudentMixture:
        """Build from weights, means and lower Cholesky factors."""
        inverses = np.array([np.linalg.solve(f, np.eye(len(f))) for f in factors])
        return cls(weights, means, factors, np.tril(inverses))

    @classmethod
    def single(cls, mean: np.ndarray, factor: np.ndarray) -> StudentMixture:
        """One component alone."""
        return cls.from_factors(np.ones(1), mean[None], factor[None])


FASTMATH = {"reassoc", "contract", "arcp", "nsz"}
"""What the compiler may do to sums; infinities and NaN keep their meaning."""


@compiled(error_model="numpy", nogil=True, fastmath=FASTMATH)
def _log_density(x, scale, means, inverses, nu, coordinates, doubled):
    """Log of the summed component densities; ``x`` of shape (d, n).

    Points are taken in blocks, and every inner loop runs along a block, so that the compiler
    evaluates several points at a time. nu is a whole number: its power needs no logarithm.
    """
    d, n = x.shape
    bounded = coordinates.size
    out = np.empty(n)
    z, slope, shift = np.empty(BLOCK), np.empty((bounded, BLOCK)), np.empty((bounded, BLOCK))
    distance, image = np.empty(BLOCK), np.empty(BLOCK)
    work, total = np.empty(BLOCK), np.empty(BLOCK)
    for first in range(0, n, BLOCK):
        m = min(BLOCK, n - first)
        total[:m] = 0.0
        for k in range(scale.size):
            _distances(x, first, m, means[k], inverses[k], coordinates, z, distance, slope)
            for s in range(doubled.shape[0]):
                for i in range(m):  # a slice assigned to a slice would compile its refusal
                    image[i] = distance[i]
                _reflect(image, x, first, m, inverses[k], coordinates, doubled[s], slope, shift)
                _add_t_density(image, m, nu, d, scale[k], work, total)
            _add_t_density(distance, m, nu, d, scale[k], work, total)
        for i in range(m):
            out[first + i] = np.log(total[i])
    return out


@njit(error_model="numpy", nogil=True, fastmath=FASTMATH, forceinline=True)
def _distances(x, first, m, mean, inverse, coordinates, z, distance, slope):
    """Squared distances |z|^2, z = L^-1 (x - mean), and (L^-T z)_b of the coordinates b."""
    distance[:m] = 0.0
    slope[:, :m] = 0.0
    for a in range(mean.size):
        z[:m] = 0.0
        for b in range(a + 1):
            factor, centre, column = inverse[a, b], mean[b], x[b, first : first + m]
            for i in range(m):
                z[i] += factor * (column[i] - centre)
        for i in range(m):
            distance[i] += z[i] * z[i]
        for c in range(coordinates.size):
            if coordinates[c] <= a:
                factor, along = inverse[a, coordinates[c]], slope[c]
                for i in range(m):
                    along[i] += factor * z[i]


@njit(error_model="numpy", nogil=True, fastmath=FASTMATH, forceinline=True)
def _reflect(distance, x, first, m, inverse, coordinates, doubled, slope, shift):
    """Squared distances of the points reflected where ``doubled`` is a number.

    A reflection adds t_b = 2 bound - 2 x_b to coordinate b:

        |z + L^-1 t|^2 = |z|^2 + 2 sum_b t_b (L^-T z)_b + t^T (L^-T L^-1) t
    """
    for c in range(coordinates.size):
        if np.isnan(doubled[c]):
            continue
        t, along, column = shift[c], slope[c], x[coordinates[c], first : first + m]
        square = _product(inverse, coordinates[c], coordinates[c])
        for i in range(m):
            t[i] = doubled[c] - 2.0 * column[i]
            distance[i] += t[i] * (2.0 * along[i] + square * t[i])
        for e in range(c):
            if not np.isnan(doubled[e]):
                cross = 2.0 * _product(inverse, coordinates[c], coordinates[e])
                other = shift[e]
                for i in range(m):
                    distance[i] += cross * t[i] * other[i]


@inlined
def _product(inverse, b, c):
    """(L^-T L^-1)_bc."""
    total = 0.0
    for a in range(inverse.shape[0]):
        total += inverse[a, b] * inverse[a, c]
    return total


@njit(error_model="numpy", nogil=True, fastmath=FASTMATH, forceinline=True)
def _add_t_density(distance, m, nu, d, scale, work, total):
    """Add scale (1 + distance / nu)^(-(nu + d) / 2) to ``total``; the first arrays are used up."""
    power = int(nu) + d
    for i in range(m):
        distance[i] = 1.0 / (1.0 + max(distance[i], 0.0) / nu)
    if power % 2 == 1:
        for i in range(m):
            work[i] = scale * np.sqrt(distance[i])
    else:
        work[:m] = scale
    power //= 2
    while power > 0:
        if power % 2 == 1:
            for i in range(m):
                work[i] *= distance[i]
        power //= 2
        for i in range(m):
            distance[i] *= distance[i]
    for i in range(m):
        total[i] += work[i]


@compiled(nogil=True)
def _transform(z, component, stretch, means, factors):
    n, d = z.shape
    out = np.empty((n, d))
    for i in range(n):
        k = component[i]
        for a in range(d):
            total = 0.0
            for b in range(a + 1):
                total += factors[k, a, b] * z[i, b]
            out[i, a] = means[k, a] + stretch[i] * total
    return out
