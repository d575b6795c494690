"""Priors against quadrature of their densities: probabilities, draws, and rows of the kernel."""

import math
import tomllib
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest

from biaxbayes.laws import law_named
from biaxbayes.model.density import log_prior
from biaxbayes.model.priors import DrawnPrior, Prior, parse_priors

PRIORS = [
    Prior("normal", 2.0, 0.7),
    Prior("normal", 2.0, 0.7, low=1.5),
    Prior("normal", 2.0, 0.7, low=0.0, high=2.5),
    Prior("normal", -1.0, 2.0, low=-3.0),
    Prior("lognormal", 3.0, 0.8),
    Prior("lognormal", 3.0, 0.8, low=2.0),
    Prior("lognormal", 3.0, 0.8, low=1.0, high=4.0),
    Prior("uniform", low=0.5, high=2.0),
    Prior("uniform", low=-1.0, high=3.0),
    Prior("loguniform", low=0.1, high=20.0),
]


def plain_density(prior: Prior, x: float) -> float:
    """Density in natural units before it is cut, without a constant where it is flat."""
    if not prior.low <= x <= prior.high:
        return 0.0
    logs = prior.family in ("lognormal", "loguniform")
    if logs and x <= 0.0:
        return 0.0
    if prior.family in ("uniform", "loguniform"):
        return 1.0 / x if logs else 1.0
    z = (math.log(x / prior.location) if logs else x - prior.location) / prior.scale
    return math.exp(-0.5 * z * z) / (x if logs else 1.0)


def mass(prior: Prior, low: float, high: float) -> float:
    """Integral of the plain density, in steps that no peak hides between."""
    logs = prior.family in ("lognormal", "loguniform")
    first = max(low, prior.low, 1e-12 if logs else -40.0)
    last = min(high, prior.high, 400.0 if logs else 40.0)
    if not first < last:
        return 0.0
    between = np.geomspace(first, last, 60) if logs else np.linspace(first, last, 60)
    return sum(quad(lambda x: plain_density(prior, x), a, b)[0] for a, b in pairwise(between))


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_probabilities_are_integrals_and_values_turn_back(prior):
    whole = mass(prior, -math.inf, math.inf)
    levels = np.array([0.01, 0.05, 0.3, 0.5, 0.8, 0.99])
    values = prior.ppf(levels)
    assert np.all((prior.low <= values) & (values <= prior.high))
    for level, value in zip(levels, values, strict=True):
        assert mass(prior, -math.inf, value) / whole == pytest.approx(level, abs=1e-7)
    np.testing.assert_allclose(prior.cdf(values), levels, atol=1e-10)
    outside = np.array([prior.low - 1.0, prior.high + 1.0])
    np.testing.assert_array_equal(prior.cdf(outside), [0.0, 1.0])
    draws = prior.sample(np.random.default_rng(1), 4000)
    assert kstest(draws, prior.cdf).pvalue > 1e-3


@pytest.mark.parametrize("prior", PRIORS, ids=str)
@pytest.mark.parametrize("log_scale", [False, True])
def test_the_row_of_the_kernel_is_the_normalised_density(prior, log_scale):
    if prior.family in ("lognormal", "loguniform") and not log_scale:
        with pytest.raises(ValueError, match="does not fit"):
            prior.encode(log_scale=False)
        return
    kind, row = prior.encode(log_scale=log_scale)
    positive = mass(prior, 0.0, math.inf) if log_scale else mass(prior, -math.inf, math.inf)
    for x in (-2.0, 0.3, 0.9, 1.7, 2.2, 3.5, 25.0):
        if log_scale and x <= 0.0:
            continue
        result = log_prior(kind, np.array(row), math.log(x) if log_scale else x)
        density = plain_density(prior, x) / positive * (x if log_scale else 1.0)
        if density == 0.0:
            assert result == -math.inf
        else:
            assert result == pytest.approx(math.log(density), abs=1e-7)


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_mass_is_the_share_of_the_prior_that_was_not_cut(prior):
    if prior.family in ("uniform", "loguniform"):
        assert prior.mass(positive=False) == 1.0
        return
    uncut = Prior(prior.family, prior.location, prior.scale)
    whole = mass(uncut, -math.inf, math.inf)
    expected = mass(prior, -math.inf, math.inf) / whole
    assert prior.mass(positive=False) == pytest.approx(expected, abs=1e-7)
    expected = mass(prior, 0.0, math.inf) / whole
    assert prior.mass(positive=True) == pytest.approx(expected, abs=1e-7)


def test_a_uniform_prior_below_zero_has_no_positive_mass():
    assert Prior("uniform", low=-2.0, high=-1.0).mass(positive=True) == 0.0
    assert Prior("normal", -5.0, 1.0, high=-1.0).mass(positive=True) == 0.0


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_a_table_reads_back_to_the_prior(prior):
    if prior.low < 0.0:  # below the range of a stiffness
        return
    lines = [
        f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}"
        for key, value in prior.as_table().items()
    ]
    table = {"C1": tomllib.loads("\n".join(lines))}
    result = parse_priors(table, law=law_named("goh"))["C1"]
    assert isinstance(result, Prior)
    np.testing.assert_allclose(result.ppf(np.array([0.2, 0.7])), prior.within(0.0, math.inf).ppf(np.array([0.2, 0.7])))  # fmt: skip  # noqa: E501


def test_a_prior_of_draws_has_their_quantiles_and_no_bounds():
    draws = np.random.default_rng(2).normal(3.0, 2.0, 20_001)
    prior = DrawnPrior(draws)
    assert (prior.low, prior.high) == (-math.inf, math.inf)
    levels = np.array([0.05, 0.5, 0.95])
    np.testing.assert_allclose(prior.ppf(levels), np.quantile(draws, levels), atol=2e-3)
    np.testing.assert_allclose(prior.cdf(prior.ppf(levels)), levels, atol=1e-12)
    np.testing.assert_array_equal(prior.cdf(np.array([-50.0, 50.0])), [0.0, 1.0])
