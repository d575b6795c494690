"""A mixture of multivariate Student t distributions."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
from numba import njit

__all__ = ["StudentMixture", "fit_mixture"]

DEGREES = 6.0  # of freedom: tails heavier than any posterior that falls like a Gaussian


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

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density at points of shape (n, d); shape (n,)."""
        return _log_density(
            np.ascontiguousarray(x), self._log_scale(), self.means, self.inverses, self.degrees
        )

    def _log_scale(self) -> np.ndarray:
        """Log weight of each component times the normaliser of its t density."""
        d, nu = self.means.shape[1], self.degrees
        log_norm = (
            math.lgamma(0.5 * (nu + d)) - math.lgamma(0.5 * nu) - 0.5 * d * math.log(nu * math.pi)
        )
        log_det = np.log(np.diagonal(self.factors, axis1=1, axis2=2)).sum(axis=1)
        return np.log(self.weights) + log_norm - log_det

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


def fit_mixture(
    points: np.ndarray, rng: np.random.Generator, *, components: int = 6
) -> StudentMixture:
    """Fit a Gaussian mixture to points and make its tails heavier.

    scikit-learn fits the Gaussians by expectation maximisation; their covariances are kept as
    scale matrices of Student t distributions.

    Parameters
    ----------
    points : ndarray, shape (n, d)
        Roughly standardised.
    rng : numpy.random.Generator
    components : int
        Upper limit; fewer where the points could not determine them.

    Returns
    -------
    StudentMixture
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    n, d = points.shape
    # A component needs several times d points to have a covariance worth the name.
    components = max(1, min(components, n // (5 * (d + 1))))
    model = GaussianMixture(
        components,
        reg_covar=1e-6,
        max_iter=50,
        tol=2e-3,
        init_params="k-means++",
        random_state=int(rng.integers(2**31)),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(points)
    weights = np.maximum(model.weights_, 1e-4)
    return StudentMixture.from_factors(
        weights / weights.sum(), model.means_, np.linalg.cholesky(model.covariances_)
    )


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _log_density(x, log_scale, means, inverses, nu):
    n, d = x.shape
    count = log_scale.size
    out = np.empty(n)
    logs = np.empty(count)
    power = 0.5 * (nu + d)
    for i in range(n):
        top = -np.inf
        for k in range(count):
            distance = 0.0
            for a in range(d):
                z = 0.0
                for b in range(a + 1):
                    z += inverses[k, a, b] * (x[i, b] - means[k, b])
                distance += z * z
            # ln t_nu(x) = ln norm - (nu + d)/2 ln(1 + distance / nu)
            logs[k] = log_scale[k] - power * np.log1p(distance / nu)
            top = max(top, logs[k])
        total = 0.0
        for k in range(count):
            total += np.exp(logs[k] - top)
        out[i] = top + np.log(total)
    return out


@njit(cache=True, nogil=True)
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
