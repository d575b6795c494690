"""Weighted populations, against what their weights say: shares, resampling, starts by ridge."""

import numpy as np
import pytest
from scipy.stats import norm

from biaxbayes.sampling.population_monte_carlo import (
    CLUSTER_POINTS,
    TEMPERED_FRACTION,
    Start,
    dispersed_starts,
    draw_cluster_points,
    draw_tempered_points,
    effective_fraction,
    resample,
    resample_clusters,
    tempering_power,
)
from biaxbayes.sampling.proposal import MixtureProposal, first_proposal
from biaxbayes.sampling.target import bounds_array

FREE = bounds_array({}, 2)


def test_the_effective_fraction_is_that_of_equal_weights():
    assert effective_fraction(np.full(50, -700.0)) == pytest.approx(1.0)
    # ten of fifty have all the weight
    assert effective_fraction(np.r_[np.full(10, 3.0), np.full(40, -np.inf)]) == pytest.approx(0.2)
    w = np.array([1.0, 2.0, 3.0, 4.0])
    assert effective_fraction(np.log(w)) == pytest.approx(100.0 / (4 * 30.0))


def test_weights_are_tempered_as_far_as_the_share_needs():
    assert tempering_power(np.zeros(10)) == 1.0
    # w = exp(s z): the share of the power p is exp(-p^2 s^2)
    s = 6.0
    z = norm.ppf((np.arange(200_000) + 0.5) / 200_000)
    expected = np.sqrt(-np.log(TEMPERED_FRACTION)) / s
    # 200,000 points end at z = 4.4: half a per cent
    assert tempering_power(s * z) == pytest.approx(expected, rel=1e-2)
    # where few have a weight at all, half of them are asked for
    few = np.r_[s * z[::1000], np.full(9800, -np.inf)]
    power = tempering_power(few)
    share = effective_fraction(power * few[:200])
    assert share == pytest.approx(0.5, rel=1e-6)


def test_points_are_resampled_by_their_weights():
    rng = np.random.default_rng(1)
    w = np.array([0.1, 0.0, 0.6, 0.3])
    with np.errstate(divide="ignore"):
        chosen = resample(np.log(w), 1000, rng)
    counts = np.bincount(chosen, minlength=4)
    # systematic resampling errs by less than one
    assert np.abs(counts - 1000 * w).max() < 1.0 + 1e-9
    each = resample_clusters(np.log([1.0, 3.0, 1e-9, 1e-9]), np.array([0, 0, 1, 1]), 400, rng)
    counts = np.bincount(each, minlength=4)
    assert np.abs(counts - [50, 150, 100, 100]).max() <= 1


def two_ridges(n=40_000, share=0.2):
    """A population of two round ridges at x = 0 and 20, the second of a share of the mass."""
    rng = np.random.default_rng(5)
    centre = np.where(np.arange(n) % 2 == 0, 0.0, 20.0)
    points = 3.0 * rng.standard_normal((n, 2))
    # proposal: sd 3; density: sd 1
    log_weight = norm.logpdf(points).sum(axis=1) - norm.logpdf(points, scale=3.0).sum(axis=1)
    log_weight += np.where(centre > 0.0, np.log(share), np.log(1.0 - share))
    points[:, 0] += centre
    parts = tuple(
        first_proposal(np.array([[at, 0.0]]), [np.eye(2)], np.ones(1), FREE) for at in (0.0, 20.0)
    )
    proposal = MixtureProposal(np.array([0.5, 0.5]), parts)
    return Start(proposal, points, log_weight, np.random.default_rng(6))


def one_ridge(n=20_000):
    both = two_ridges(2 * n)
    own = both.points[:, 0] < 10.0
    alone = MixtureProposal(np.ones(1), both.proposal.parts[:1])
    return Start(alone, both.points[own], both.log_weight[own], both.rng)


def test_tempered_points_have_twice_the_variance():
    # the square root of exp(-x^2 / 2 + x^2 / 18), times the proposal: 1 / var = (1 + 1/9) / 2
    points = draw_tempered_points(one_ridge())
    assert points.var(axis=0) == pytest.approx([1.8, 1.8], rel=0.05)


def test_walkers_start_spread_and_on_each_ridge_by_its_mass():
    starts = dispersed_starts(two_ridges(share=0.2), ensembles=4, walkers=500)
    assert [s.shape for s in starts] == [(500, 2)] * 4
    every = np.vstack(starts)
    assert len(np.unique(every[:500], axis=0)) == 500  # of one ensemble all are distinct
    right = every[:, 0] > 10.0
    # four standard errors of a share of 2,000
    assert right.mean() == pytest.approx(0.2, abs=4 * np.sqrt(0.16 / 2000))
    assert every[~right].var(axis=0) == pytest.approx([1.8, 1.8], rel=0.15)
    barred = one_ridge()
    barred.log_weight[barred.points[:, 1] > 0.0] = -np.inf
    for start in dispersed_starts(barred, ensembles=2, walkers=64):
        assert (start[:, 1] <= 0.0).all()


def test_points_of_every_ridge_are_as_many_whatever_it_weighs():
    points = draw_cluster_points(two_ridges(share=0.01))
    right = points[:, 0] > 10.0
    assert len(points) == 2 * CLUSTER_POINTS and right.sum() == CLUSTER_POINTS
    for own, at in ((points[~right], 0.0), (points[right], 20.0)):
        assert own.mean(axis=0) == pytest.approx([at, 0.0], abs=4 / np.sqrt(CLUSTER_POINTS))
        assert own.var(axis=0) == pytest.approx([1.0, 1.0], rel=0.25)
