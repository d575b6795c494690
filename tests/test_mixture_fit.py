"""Fits of Gaussian mixtures and groups of points, beside scikit-learn's from the same numbers."""

import warnings

import numpy as np
import pytest
from sklearn.cluster import KMeans, kmeans_plusplus
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from biaxbayes.sampling import mixture_fit

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
        reg_covar=mixture_fit.FLOOR,
        max_iter=mixture_fit.MOST_ROUNDS,
        tol=mixture_fit.LEAST_RISE,
        init_params="k-means++",
        random_state=seed,
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("n", "d", "components"), SHAPES)
def test_mixtures_are_those_of_scikit_learn(n, d, components, seed):
    x = skewed(n, d, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        expected = peer(components, seed).fit(x)
    weights, means, covariances = mixture_fit.fit_gaussians(
        x, components, np.random.RandomState(seed)
    )
    assert weights == pytest.approx(expected.weights_, rel=1e-8, abs=1e-10)
    assert means == pytest.approx(expected.means_, rel=1e-8, abs=1e-9)
    assert covariances == pytest.approx(expected.covariances_, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_chosen_points_are_those_of_scikit_learn(seed):
    x = skewed(700, 4, seed)
    chosen = mixture_fit.spread_points(x, 9, np.random.RandomState(seed))
    assert chosen.tolist() == kmeans_plusplus(x, 9, random_state=seed)[1].tolist()


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("seed", range(6))
def test_groups_are_those_of_scikit_learn(seed, count):
    x = skewed(1500, 6, seed)
    expected = KMeans(count, n_init=mixture_fit.RESTARTS, random_state=seed).fit_predict(x)
    assert (mixture_fit.groups(x, count, np.random.RandomState(seed)) == expected).all()


def test_points_that_are_not_finite_are_refused():
    x = skewed(200, 3, 0)
    x[17, 1] = np.nan
    with pytest.raises(ValueError, match="finite"):
        mixture_fit.fit_gaussians(x, 2, np.random.RandomState(0))
