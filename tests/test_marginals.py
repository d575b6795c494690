"""Marginals of draws against closed forms: smoothed densities, spreads, ends of ranges, moves."""

import numpy as np
import pytest
from scipy.stats import lognorm, norm, uniform

from biaxbayes.identifiability.bounded_density import Span, curve, robust_sd, span
from biaxbayes.identifiability.marginals import (
    ComparisonScale,
    count_modes,
    density,
    range_ends,
)
from biaxbayes.identifiability.power_scaling import ends_by_prior, sensitivity
from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import MOUNTING_PARAMETERS, Quantity
from goh_functions import GOH_LAW
from quick_posteriors import small_specimen

LEVELS = (np.arange(20_000) + 0.5) / 20_000
"""Levels of draws spread as evenly as their distribution: without Monte Carlo error."""


def test_a_density_is_widened_by_silvermans_bandwidth_alone():
    axis = Span(-8.0, 8.0)
    x, height = curve(norm.ppf(LEVELS), axis)
    # per unit of the axis, 16 long; h = 0.9 n^(-1/5) sd is added to the variance
    wider = np.sqrt(1.0 + (0.9 * 20_000**-0.2) ** 2)
    np.testing.assert_allclose(height / 16.0, norm.pdf(x, scale=wider), atol=2e-4)
    assert (x[0], x[-1]) == (-8.0, 8.0)


def test_a_density_keeps_its_height_at_a_closed_end_and_loses_half_at_an_open_one():
    draws = uniform.ppf(LEVELS)
    for low, high in ((True, True), (True, False), (False, True), (False, False)):
        _, height = curve(draws, Span(0.0, 1.0, low, high))
        # half a bin of 1/256 from an open end
        half = norm.cdf(0.5 / 256, scale=0.9 * 20_000**-0.2 * draws.std())
        ends = (1.0 if low else half, 1.0 if high else half)
        assert (height[0], height[-1]) == pytest.approx(ends, abs=2e-3)
        assert height[128] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("limits", "closed"), [((0.0, 1.0), (1, 1)), ((0.0, 2.0), (1, 0)), ((-1.0, 1.0), (0, 1))]
)
def test_a_density_is_reflected_at_the_limits_that_it_reaches(limits, closed):
    shape = density(uniform.ppf(LEVELS), limits)
    assert (shape.at(0.0), shape.at(1.0)) == pytest.approx([0.5 + 0.5 * c for c in closed], abs=0.1)


def test_a_logarithmic_axis_has_the_density_of_the_logarithm():
    values = lognorm.ppf(LEVELS, 0.5, scale=3.0)
    axis = Span(0.1, 90.0, log=True)
    x, height = curve(values, axis)
    length = np.log(900.0)
    wider = 0.5 * np.sqrt(1.0 + (0.9 * 20_000**-0.2) ** 2)
    np.testing.assert_allclose(height / length, norm.pdf(np.log(x), np.log(3.0), wider), atol=2e-3)
    np.testing.assert_allclose(axis.back(axis.forward(values)), values, rtol=1e-12)


def test_a_spread_is_not_that_of_the_tails():
    z = norm.ppf(LEVELS)
    assert robust_sd(0.1 * z) == pytest.approx(0.1, rel=1e-3)
    # one in ten far out: the middle half hardly widens, the standard deviation does
    tailed = np.where(np.arange(z.size) % 10 == 0, 5.0 * z, 0.1 * z)
    q25, q75 = np.quantile(tailed, [0.25, 0.75])
    assert robust_sd(tailed) == pytest.approx((q75 - q25) / (2.0 * norm.ppf(0.75)), rel=1e-3)
    assert robust_sd(np.full(9, 0.3)) == 0.0
    # the middle half is one value: the standard deviation tells
    assert robust_sd(np.r_[np.zeros(90), np.full(10, 0.5)]) == pytest.approx(0.15)


def test_a_range_shows_the_draws_and_ends_where_physics_does():
    draws = np.linspace(1.0, 2.0, 10_001)
    low, high = np.quantile(draws, [0.0005, 0.9995])
    margin = 0.08 * (high - low)
    result = span(draws)
    assert (result.low, result.high) == pytest.approx((low - margin, high + margin))
    assert not (result.closed_low or result.closed_high)
    result = span(draws, limits=(0.95, 5.0))
    assert result.low == 0.95 and result.closed_low and not result.closed_high
    result = span(draws, draws + 1.0, include=(4.0,), log=True)
    assert result.log
    moved = np.log(np.quantile(draws, 0.0005))
    margin = 0.08 * (np.log(4.0) - moved)
    assert (result.low, result.high) == pytest.approx(
        (np.exp(moved - margin), np.exp(np.log(4.0) + margin)), rel=1e-6
    )
    assert not span(draws - 1.5, log=True).log
    alone = span(np.full(9, 2.0))
    assert (alone.low, alone.high) == pytest.approx((1.9, 2.1))


def test_widths_above_a_share_of_the_peak():
    result = density(norm.ppf(LEVELS), (-np.inf, np.inf))
    # exp(-1.92) of the peak lies 1.96 sd away
    assert result.width_above(0.147) == pytest.approx(2 * 1.96 * 1.02, rel=0.02)
    assert result.at(result.x[0] - 1.0) == 0.0
    assert result.at(0.0) == pytest.approx(result.peak, rel=1e-3)


def scale_of(name: str, **prior: object) -> ComparisonScale:
    target = Posterior(small_specimen(), noise="independent", priors={name: prior} if prior else {})
    parameter = MOUNTING_PARAMETERS[0] if name.startswith("mounting") else GOH_LAW.parameter(name)
    return ComparisonScale(Quantity(parameter), target.priors[name])


def ends_of(scale: ComparisonScale, natural: np.ndarray, distance: float | None = 0.02):
    likelihood = density(scale.prior.cdf(natural), (0.0, 1.0))
    return range_ends(scale, natural, likelihood, distance)


def test_a_physical_end_has_the_mass_that_is_near_it():
    scale = scale_of("kappa")
    low, high = ends_of(scale, LEVELS / 6.0)  # uniform up to half of its range
    assert [e.kind for e in (low, high)] == ["physical", "physical"]
    assert (low.value, high.value) == pytest.approx((0.0, 1.0 / 3.0))
    assert (low.mass, high.mass) == pytest.approx((0.12, 0.0), abs=1e-3)
    assert (low.prior_mass, high.prior_mass) == pytest.approx((0.06, 0.06), abs=1e-3)
    assert low.support > 0.97 and high.support < 1e-6


def test_a_prior_that_excludes_an_end_of_the_law_ends_before_it():
    scale = scale_of("kappa", distribution="normal", mean=0.14, sd=0.003)
    # draws of the prior: the record says nothing, and nothing speaks for 0 or 1/3
    low, high = ends_of(scale, norm.ppf(LEVELS, 0.14, 0.003))
    assert [e.kind for e in (low, high)] == ["prior", "prior"]
    assert [low.value, high.value] == pytest.approx(norm.ppf([0.025, 0.975], 0.14, 0.003), rel=1e-6)
    wide = scale_of("kappa", distribution="normal", mean=0.14, sd=0.06)
    assert [e.kind for e in ends_of(wide, LEVELS / 6.0)] == ["physical", "physical"]


def test_an_end_without_physics_is_where_the_prior_thins_out_or_what_the_user_said():
    scale = scale_of("mounting_stretch_x", distribution="normal", mean=1.0, sd=0.05)
    # the same as the prior: as much mass beyond its ends as it has itself
    low, high = ends_of(scale, norm.ppf(LEVELS, 1.0, 0.05), None)
    assert [low.value, high.value] == pytest.approx(norm.ppf([0.025, 0.975], 1.0, 0.05), rel=1e-6)
    for end in (low, high):
        assert end.kind == "prior" and end.distance == 0.0
        assert (end.mass, end.prior_mass) == pytest.approx((0.025, 0.025), abs=1e-3)
        assert end.support == pytest.approx(1.0, abs=0.05)
    low, high = ends_of(scale, norm.ppf(LEVELS, 1.0, 0.005), None)
    assert low.mass == high.mass == low.support == high.support == 0.0
    bounded = scale_of("k1", distribution="uniform", low=10.0, high=30.0)
    low, high = ends_of(bounded, 10.0 + 10.0 * LEVELS, None)  # the lower half
    assert [(e.kind, e.value) for e in (low, high)] == [("user", 10.0), ("user", 30.0)]
    # near is a twentieth of the prior, 1 kPa, which has a tenth of the draws
    assert (low.distance, high.distance) == pytest.approx((1.0, 1.0))
    assert (low.mass, high.mass) == pytest.approx((0.1, 0.0), abs=1e-3)
    assert low.support > 0.97 and high.support < 1e-6


def test_peaks_at_closed_ends_count_as_modes():
    at_both = np.concatenate([LEVELS**4, 1.0 - LEVELS**4])
    rng = np.random.default_rng(2)
    assert count_modes(rng.permutation(at_both), (0.0, 1.0)) == 2
    assert count_modes(rng.permutation(1.0 - LEVELS**4), (0.0, 1.0)) == 1
    assert count_modes(rng.permutation(LEVELS), (0.0, 1.0)) == 1


def test_a_mirror_is_no_end_and_a_bound_beside_it_is():
    assert ends_of(scale_of("alpha"), 90.0 * LEVELS, 1.0) == ()
    bounded = scale_of("alpha", distribution="uniform", low=0.0, high=60.0)
    (end,) = ends_of(bounded, 60.0 * LEVELS, 1.0)
    assert (end.side, end.kind, end.value) == (1, "user", 60.0)


@pytest.mark.parametrize(("share", "decided"), [(0.25, False), (0.45, True), (0.9, True)])
def test_a_prior_decides_ends_by_its_share_of_the_precision(share, decided):
    """A normal prior times a normal likelihood: doubling the prior's sd moves both ends."""
    # precision 1 of the posterior, the prior's centre that of the posterior
    z = norm.ppf(LEVELS)
    assert ends_by_prior(z, -0.5 * share * z * z) == (decided, decided)


def test_sensitivity_to_what_is_not_known_is_not_known():
    values = np.random.default_rng(1).normal(size=(2000, 2))
    values[:, 1] = 3.0
    assert np.isnan(sensitivity(values, None)).all()
    assert sensitivity(values, np.zeros(2000)).tolist() == [0.0, 0.0]
    result = sensitivity(values, -0.5 * values[:, 0] ** 2)
    assert result[0] > 0.05 and result[1] == 0.0
