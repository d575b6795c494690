"""Fits of Gaussian mixtures, beside those of scikit-learn."""

import warnings

import numpy as np
import pytest
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from biaxbayes.sampling import mixture

SHAPES = [(60, 2, 1), (300, 3, 4), (900, 5, 12), (4000, 8, 8), (2500, 13, 6)]


def skewed(n, d, seed):
    """Standardised points with curved and heavy marginals, some of them twice."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((n, d)) @ rng.standard_normal((d, d))
    x += 0.3 * rng.standard_normal((n, d)) ** 2
    x[: n // 5] = x[n // 5 : 2 * (n // 5)]
    return (x - x.mean(axis=0)) / x.std(axis=0)


def peer(components, seed):
    return GaussianMixture(
        components,
        reg_covar=mixture.VARIANCE_FLOOR,
        max_iter=mixture.MAX_ITERATIONS,
        tol=mixture.TOLERANCE,
        random_state=seed,
    )


def mean_log_density(x, fit):
    """Of the Gaussian mixture whose covariances became scale matrices."""
    gaussians = peer(len(fit.weights), 0)
    gaussians.weights_, gaussians.means_ = fit.weights, fit.means
    gaussians.precisions_cholesky_ = np.linalg.inv(fit.factors).transpose(0, 2, 1)
    return gaussians.score(x)


@pytest.mark.parametrize(("n", "d", "components"), SHAPES)
def test_mixtures_fit_as_well_as_those_of_scikit_learn(n, d, components):
    """Optima depend on the first groups: the best of three seeds is compared."""
    x = skewed(n, d, 1)
    fits = [
        mixture.fit_mixture(x, np.random.default_rng(seed), components=components)
        for seed in range(3)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        expected = max(peer(len(fits[0].weights), seed).fit(x).score(x) for seed in range(3))
    assert max(mean_log_density(x, fit) for fit in fits) > expected - 0.05
    for fit in fits:
        assert fit.weights.sum() == pytest.approx(1.0, abs=1e-12)


def test_a_mixture_of_one_component_has_the_moments_of_the_points():
    x = skewed(500, 4, 2)
    fit = mixture.fit_mixture(x, np.random.default_rng(0), components=1)
    assert fit.means[0] == pytest.approx(x.mean(axis=0), abs=1e-12)
    covariance = np.cov(x.T, ddof=0) + mixture.VARIANCE_FLOOR * np.eye(4)
    assert fit.factors[0] @ fit.factors[0].T == pytest.approx(covariance, abs=1e-10)


def test_points_that_are_not_finite_are_refused():
    x = skewed(200, 3, 0)
    x[17, 1] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        mixture.fit_mixture(x, np.random.default_rng(0), components=2)
