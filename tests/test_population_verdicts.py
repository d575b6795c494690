"""Verdicts on pooled values: the rule of single runs, with the priors that values have here."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ks_1samp, ks_2samp, norm

from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.identifiability.verdict import (
    BOUNDED,
    COMBINATION,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
)
from biaxbayes.laws.goh import GOH
from biaxbayes.model.priors import DrawnPrior, Prior
from biaxbayes.options import PopulationOptions
from biaxbayes.populations.hierarchy import MIN_INSIDE_PROBABILITY, Layout
from biaxbayes.populations.model import Grouping, PooledValue, make_layout, pooled_values
from biaxbayes.populations.population_result import Hyper
from biaxbayes.populations.verdicts import in_words, mean_verdicts, reported_text, spread_verdicts
from goh_functions import GOH_LAW
from quick_posteriors import sampled, specimen

NAMES = ("C1", "k1", "k2", "alpha", "kappa")
DRAWS = 4000


def layout(values: list[PooledValue]) -> Layout:
    grouping = Grouping(tuple("abcd"), ("m", "m", "a", "a"), ("P", "Q", "P", "Q"))
    return make_layout(grouping, values, PopulationOptions())


@pytest.fixture(scope="module")
def values() -> list[PooledValue]:
    return pooled_values(GOH_LAW, NAMES)


@pytest.fixture(scope="module")
def prior(values) -> tuple[Hyper, np.ndarray]:
    return Hyper.from_prior(values, layout(values), 2**14, np.random.default_rng(1))


def hyper_of(values, mu, *, sd_donors=0.05, sd=0.05) -> Hyper:
    """Draws with given means (M, p) and spreads in units of their priors' scales."""
    M, p = mu.shape
    scale = np.array([v.specimen_scale for v in values])
    own = [
        np.broadcast_to(np.asarray(s, dtype=float).reshape(-1, 1), (M, p)) * scale
        for s in (sd_donors, sd)
    ]
    eye = np.broadcast_to(np.eye(p), (M, p, p))
    return Hyper(tuple(values), np.zeros(1, int), mu[:, None], own[0], own[1][:, None], eye, eye)


def judged(hyper, prior, state="converged"):
    materials = pd.DataFrame(
        {v.name: v.from_scale(hyper.typical_median(0)[:, k]) for k, v in enumerate(hyper.values)}
    )
    return mean_verdicts(hyper, prior[0], 0, GOH_LAW, materials, 1.2, state)


def known(values, rng, **at) -> np.ndarray:
    """Means that are known well, about a material."""
    middle = dict(zip(NAMES, (14.0, 60.0, 8.0, 38.0, 0.15), strict=True)) | at
    sd = {"alpha": 1.0, "kappa": 0.01}
    return np.column_stack(
        [
            v.to_scale(np.array(middle[v.name])) + sd.get(v.name, 0.05) * rng.standard_normal(DRAWS)
            for v in values
        ]
    )


def test_prior_of_values_without_limits_is_the_given_one(values, prior):
    hyper, location = prior
    v = values[0]
    assert ks_1samp(hyper.mu[:, 0, 0], norm(v.mean, v.mean_sd).cdf).pvalue > 1e-3
    assert np.sqrt(np.mean(hyper.sd_donors[:, 0] ** 2)) == pytest.approx(v.donor_scale, rel=0.03)
    assert np.sqrt(np.mean(hyper.sd[:, 0, 0] ** 2)) == pytest.approx(v.specimen_scale, rel=0.03)
    wide = math.hypot(v.mean_sd, v.donor_scale)
    assert location[:, 1, 0].std() == pytest.approx(wide, rel=0.03)
    # -1/2 z^2 of every mean and spread: half a unit each on average
    assert hyper.log_prior().mean() == pytest.approx(-0.5 * 4 * len(values), rel=0.15)


def test_prior_leaves_out_what_the_sampler_excludes(values, prior):
    """Draws of the plain prior, filtered by the rule of the model."""
    hyper, _ = prior
    v, rng = values[4], np.random.default_rng(2)
    N = 6000
    sd_donors, sd = np.abs(rng.standard_normal((2, N))) * [[v.donor_scale], [v.specimen_scale]]
    mu = v.mean_sd * rng.standard_normal((N, 2))
    effect = sd_donors[:, None] * rng.standard_normal((N, 2))
    # specimens of both donors in both groups
    m = v.mean + mu[:, [0, 0, 1, 1]] + effect[:, [0, 1, 0, 1]]
    own = norm(m, sd[:, None])
    inside = own.cdf(v.limits[1]) - own.cdf(v.limits[0])
    ok = (inside >= MIN_INSIDE_PROBABILITY).all(axis=1)
    assert 0.5 < ok.mean() < 0.99
    for result, expected in (
        (hyper.mu[:, 0, 4], mu[ok, 0] + v.mean),
        (hyper.sd_donors[:, 4], sd_donors[ok]),
        (hyper.sd[:, 0, 4], sd[ok]),
    ):
        assert ks_2samp(result, expected).pvalue > 1e-3
    typical = hyper.typical_median(0)[:, 4]
    assert (typical >= 0.0).all() and (typical <= 1.0 / 3.0).all()


def test_one_rule_for_runs_and_populations():
    """The draws of a run under its own prior, known by its draws, get the verdicts of the run."""
    run = sampled(specimen(GOH(14.0, 60.0, 8.0, 38.0, 0.1), ratios=((1.0, 1.0),), increments=8))
    own = identify_draws(run.target, run.draws, "converged")
    levels = (np.arange(2**14) + 0.5) / 2**14
    drawn = {
        name: DrawnPrior(p.ppf(levels))
        for name, p in run.target.priors.items()
        if name in NAMES and isinstance(p, Prior)
    }
    again = identify_draws(
        run.target, run.draws, "converged", priors={**run.target.priors, **drawn}
    )
    assert len(drawn) == 5
    for name in NAMES:
        assert again[name].verdict == own[name].verdict, name
        first, second = own[name].diagnostics, again[name].diagnostics
        assert second.contraction == pytest.approx(first.contraction, abs=0.01)
        assert second.prior_excluded == pytest.approx(first.prior_excluded, abs=0.05)
    assert len({p.verdict for p in own.parameters}) > 1


def test_a_group_that_is_known_is_identified(values, prior):
    result = judged(hyper_of(values, known(values, np.random.default_rng(3))), prior)
    assert [result[n].verdict for n in NAMES] == [IDENTIFIED] * 5
    low, high = 14.0 * np.exp(np.array([-1.645, 1.645]) * 0.05)
    interval = f"{low:.1f} to {high:.1f}"
    assert in_words(result["C1"]) == f"identified, {interval} kPa (90 %); the data determine it"


def test_a_group_nobody_looked_at_is_that_of_the_prior(values, prior):
    other, _ = Hyper.from_prior(values, layout(values), DRAWS, np.random.default_rng(4))
    result = judged(other, prior)
    assert {result[n].verdict for n in NAMES} == {NOT_IDENTIFIED}
    assert all(abs(result[n].diagnostics.contraction) < 0.1 for n in NAMES)


def test_an_open_end_and_a_ridge_are_named(values, prior):
    rng = np.random.default_rng(5)
    mu = known(values, rng)
    mu[:, 4] = np.abs(0.02 * rng.standard_normal(DRAWS))
    ridge = 1.5 * rng.standard_normal(DRAWS)
    mu[:, 1] += ridge
    mu[:, 2] -= ridge
    result = judged(hyper_of(values, mu), prior)
    assert result[
        "kappa"
    ].verdict == BOUNDED and "(95 %); the data are compatible with aligned fibres" in in_words(
        result["kappa"]
    )
    assert reported_text(result["kappa"]).startswith("below 0.0")
    assert result["k1"].verdict == COMBINATION and result["k1"].diagnostics.partners.names == (
        "k2",
    )
    assert result["C1"].verdict == IDENTIFIED


@pytest.mark.parametrize("state", ["tentative", "unusable"])
def test_no_verdict_of_chains_that_have_not_converged(values, prior, state):
    rng = np.random.default_rng(7)
    sds = np.abs(rng.standard_normal((2, DRAWS)))
    hyper = hyper_of(values, known(values, rng), sd_donors=sds[0], sd=sds[1])
    assert {p.verdict for p in judged(hyper, prior, state).values()} == {NO_VERDICT}
    spreads = spread_verdicts(hyper, 0, GOH_LAW, state)
    assert {p.verdict for sides in spreads.values() for p in sides.values()} == {NO_VERDICT}


def spread(values, sd_donors, sd):
    mu = known(values, np.random.default_rng(8))
    result = spread_verdicts(
        hyper_of(values, mu, sd_donors=sd_donors, sd=sd), 0, GOH_LAW, "converged"
    )
    return result["C1"]


def test_spreads_are_judged_by_the_same_rule(values):
    rng = np.random.default_rng(9)
    same, near = (np.abs(rng.standard_normal(DRAWS)) for _ in range(2))
    result = spread(values, same, 0.1 * near)
    assert result["sd_donors"].verdict == NOT_IDENTIFIED
    assert result["sd_donors"].diagnostics.contraction == pytest.approx(0.0, abs=0.1)
    assert result["sd_specimens"].verdict == BOUNDED
    assert "no spread" in in_words(result["sd_specimens"])
    known = 0.6 + 0.05 * rng.standard_normal(DRAWS)
    assert spread(values, known, same)["sd_donors"].verdict == IDENTIFIED


def test_spreads_of_which_only_the_sum_is_known_are_a_combination(values):
    """One specimen per donor: sd_donors^2 + sd_specimens^2 is what the specimens show."""
    rng = np.random.default_rng(10)
    whole, angle = 1.5 + 0.05 * rng.standard_normal(DRAWS), 0.5 * np.pi * rng.random(DRAWS)
    result = spread(values, whole * np.sin(angle), whole * np.cos(angle))
    assert result["sd_donors"].verdict == COMBINATION
    assert result["sd_donors"].diagnostics.partners.names == ("sd_specimens of C1",)
    total = result["sd_total"]
    assert total.verdict == IDENTIFIED
    # 1.5 times the scale 0.5 of a log
    assert total.diagnostics.median == pytest.approx(0.75, abs=0.01)


def test_a_specimen_is_compared_with_specimens_of_new_donors(values):
    """Donors differ by ten sds of their specimens in the first value: one that far is usual."""
    two = values[:2]  # C1 and k1, without limits
    scale = np.array([v.specimen_scale for v in two])
    M = 40_000
    mu = np.tile([v.mean for v in two], (M, 1))
    eye = np.broadcast_to(np.eye(2), (M, 2, 2))
    sd_donors, sd = (np.tile(factor * scale, (M, 1)) for factor in ((1.0, 0.1), (0.1, 1.0)))
    hyper = Hyper(tuple(two), np.zeros(1, int), mu[:, None], sd_donors, sd[:, None], eye, eye)
    total = np.sqrt(1.01) * scale
    joint, each = hyper.predictive_p(mu + total * [1.5, 0.0], 0, np.random.default_rng(1))
    # chi-squared of two values at 1.5^2; each alone normal; four Monte Carlo standard errors
    assert joint == pytest.approx(np.exp(-0.5 * 1.5**2), abs=4.0 * 0.5 / np.sqrt(M))
    assert each == pytest.approx([2.0 * norm.sf(1.5), 1.0], abs=4.0 * 0.5 / np.sqrt(M))
