"""The adapted independence move on analytic targets."""

import emcee
import numpy as np
import pytest
from scipy.stats import multivariate_t

from analytic_targets import (
    TARGETS,
    banana,
    gaussian,
    half_bounded,
    largest_departures,
    limit,
    one_step,
)
from biaxbayes.sampling.convergence import autocorrelation_time, split_rhat
from biaxbayes.sampling.ensembles import Ensembles
from biaxbayes.sampling.independence_move import AdaptedIndependenceMove
from biaxbayes.sampling.mixture import fit_mixture
from biaxbayes.sampling.proposal import first_proposal, fit_transported_mixture
from biaxbayes.sampling.target import bounds_array
from biaxbayes.sampling.transport_map import fit_transport_map

IDS = [t.name for t in TARGETS]


def fitted_move(target, *, points=3000, seed=1, **options):
    """An independence move with a frozen proposal, fitted to exact draws."""
    move = AdaptedIndependenceMove(np.random.default_rng(seed), bounds=target.bounds, **options)
    move.adapt(target.sample(np.random.default_rng(seed + 100), points))
    move.freeze()
    return move


@pytest.mark.parametrize("target", TARGETS, ids=IDS)
def test_a_step_leaves_the_target_and_is_reversible(target):
    stationary, reversible = largest_departures(fitted_move(target), target)
    assert stationary[0] < limit(stationary[1])
    assert reversible[0] < limit(reversible[1])


@pytest.mark.parametrize("sweeps", [1, 3])
def test_sweeps_do_not_change_what_is_right(sweeps):
    target = banana(6)
    stationary, reversible = largest_departures(fitted_move(target, sweeps=sweeps), target)
    assert stationary[0] < limit(stationary[1])
    assert reversible[0] < limit(reversible[1])


class Scaled:
    """A proposal whose density is ten percent wrong in its logarithm."""

    def __init__(self, proposal):
        self.proposal = proposal

    def sample(self, rng, size):
        return self.proposal.sample(rng, size)

    def log_density(self, x):
        return 0.9 * self.proposal.log_density(x)


def test_a_slightly_wrong_proposal_density_is_caught():
    target = half_bounded(6, with_bounds=True)
    move = fitted_move(target)
    move.proposal = Scaled(move.proposal)
    stationary, reversible = largest_departures(move, target)
    assert stationary[0] > limit(stationary[1]) or reversible[0] > limit(reversible[1])


def chain_of(target, *, seed=7, steps=160):
    """Chains of four ensembles that adapt to their pooled history, freeze, and are recorded."""
    rng = np.random.default_rng(seed)
    d = target.dimension
    starts = []
    for _ in range(4):
        start = target.sample(rng, max(64, 4 * d))
        start = start.mean(axis=0) + 1.5 * (start - start.mean(axis=0))
        if target.name.startswith("bounded"):
            start[:, 0], start[:, 1] = np.abs(start[:, 0]), np.abs(start[:, 1]) % 1
        starts.append(start)
    ensembles = Ensembles(
        target.log_density, starts, np.random.SeedSequence(seed), bounds=target.bounds
    )
    ensembles.set_share(0.0)
    history, _ = ensembles.run(40)
    for _ in range(4):
        ensembles.adapt(history[:, len(history[0]) // 2 :].reshape(-1, d))
        ensembles.set_share(0.85)
        history, _ = ensembles.run(60)  # as many evaluations as 30 steps of four sweeps
    ensembles.freeze()
    chain, _ = ensembles.run(steps)
    return chain, ensembles.acceptance


SLOW = ("banana-20", "bounded-20-plain", "two-modes-20")
MARKS = {t.name: pytest.mark.long for t in TARGETS if t.dimension == 20}
MARKS["bounded-6-folded"] = pytest.mark.long
MARKS |= dict.fromkeys(SLOW, pytest.mark.slow)


@pytest.mark.parametrize(
    "target", [pytest.param(t, marks=MARKS.get(t.name, ()), id=t.name) for t in TARGETS]
)
def test_moments_and_quantiles_within_monte_carlo_error(target):
    chain, acceptance = chain_of(target)
    assert (0.3 if target.dimension == 6 else 0.1) < acceptance <= 1.0
    exact = target.sample(np.random.default_rng(55), 60_000)
    dimensions = [0, 1, 2, 3, target.dimension - 1]
    for k in dimensions:
        draws, truth = chain[..., k], exact[:, k]
        assert split_rhat(draws) < 1.05
        centre, scale = truth.mean(), truth.std()
        levels = np.quantile(truth, [0.05, 0.5, 0.95])
        functions = [lambda x, c=centre: x - c, lambda x, c=centre, s=scale: ((x - c) / s) ** 2]
        functions += [lambda x, q=q: (x < q).astype(float) for q in levels]
        for function in functions:
            values, expected = function(draws), function(truth)
            tau = autocorrelation_time(values)
            error = np.sqrt(expected.var() * (tau / draws.size + 1 / truth.size))
            # tau itself is an estimate: a margin on top of the simultaneous limit
            z = abs(values.mean() - expected.mean()) / error
            assert z < 1.25 * limit(5 * len(dimensions), 1e-3), (target.name, k)


def test_any_log_density_with_blobs_and_without_vectorisation():
    """One point at a time, -inf outside, a blob beside the density."""

    def log_density(x):
        return (-0.5 * float(x @ x) if x[0] > 0 else -np.inf), float(2 * x[0])

    rng = np.random.default_rng(3)
    start = np.abs(rng.standard_normal((24, 3)))
    move = AdaptedIndependenceMove(rng, bounds=bounds_array({0: (0.0, np.inf)}, 3))
    history = rng.standard_normal((600, 3))
    history[:, 0] = np.abs(history[:, 0])
    move.adapt(history, components=2)
    move.freeze()
    sampler = emcee.EnsembleSampler(24, 3, log_density, moves=move)
    sampler.run_mcmc(start, 60)
    np.testing.assert_allclose(sampler.get_blobs(flat=True), 2 * sampler.get_chain(flat=True)[:, 0])
    assert (sampler.get_chain(flat=True)[:, 0] > 0).all()
    # what emcee stores as the density is the density of what it stores as the chain
    logs = -0.5 * (sampler.get_chain(flat=True) ** 2).sum(axis=1)
    np.testing.assert_allclose(sampler.get_log_prob(flat=True), logs)
    assert 0.3 < move.accepted / move.tried <= 1.0
    assert move.tried == 24 * 60 * move.sweeps


def test_proposals_beyond_a_bound_are_never_accepted():
    """Where the density is positive beyond a given bound, the folded move does not go."""
    target = gaussian(2)
    rng = np.random.default_rng(1)
    move = AdaptedIndependenceMove(rng, bounds=bounds_array({0: (-2.3, -1.7)}, 2))
    inside = target.sample(rng, 60_000)
    inside = inside[(inside[:, 0] > -2.3) & (inside[:, 0] < -1.7)]
    move.adapt(inside[:2000])
    after = one_step(move, target, inside[2000:2200])
    assert ((after[:, 0] >= -2.3) & (after[:, 0] <= -1.7)).all()


def small_proposal(bounds, seed=4):
    """A two-dimensional proposal of three unlike components behind a bent map."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((4000, 2))
    x[:, 0] = np.abs(x[:, 0]) if np.isfinite(bounds[0, 0]) else x[:, 0]
    if np.isfinite(bounds[0, 1]):
        x[:, 0] %= bounds[0, 1]
    x[:, 1] = 0.5 * x[:, 1] + 0.3 * x[:, 0] ** 2
    return fit_transported_mixture(x, rng, bounds=bounds, components=3)


BOUNDS = {
    "none": np.array([[-np.inf, np.inf], [-np.inf, np.inf]]),
    "low": np.array([[0.0, np.inf], [-np.inf, np.inf]]),
    "both": np.array([[0.0, 1.2], [-np.inf, np.inf]]),
}


@pytest.mark.parametrize("bounds", BOUNDS.values(), ids=BOUNDS)
def test_proposal_density_is_normalised_and_matches_its_draws(bounds):
    """Cell by cell: quadrature of the density against counted draws."""
    q = small_proposal(bounds)
    rng = np.random.default_rng(8)
    n = 100_000
    draws = q.sample(rng, n)
    inside = np.isfinite(q.log_density(draws))
    low, high = max(bounds[0, 0], -6.0), min(bounds[0, 1], 6.0)
    x_ticks, y_ticks = np.linspace(low, high, 13), np.linspace(-5, 14, 20)
    counts, _, _ = np.histogram2d(*draws[inside].T, [x_ticks, y_ticks])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    mass = np.zeros_like(counts)
    for i in range(len(x_ticks) - 1):
        hx = 0.5 * (x_ticks[i + 1] - x_ticks[i])
        xs = x_ticks[i] + hx * (1 + nodes)
        for j in range(len(y_ticks) - 1):
            hy = 0.5 * (y_ticks[j + 1] - y_ticks[j])
            ys = y_ticks[j] + hy * (1 + nodes)
            grid = np.array(np.meshgrid(xs, ys, indexing="ij")).reshape(2, -1).T
            density = np.exp(q.log_density(grid)).reshape(12, 12)
            mass[i, j] = hx * hy * weights @ density @ weights
    lost = 1 - inside.mean()  # folded beyond the far bound: no density, rejected
    assert lost < (0.05 if np.isfinite(bounds[0, 1]) else 1e-9)
    beyond = 1 - counts.sum() / n  # lost, or outside the cells
    assert beyond < 0.06
    assert mass.sum() + beyond == pytest.approx(1.0, abs=4.5 * np.sqrt(0.06 / n))
    expected = n * mass
    big = expected > 25
    z = (counts - expected)[big] / np.sqrt(expected[big])
    assert big.sum() > 25
    assert np.abs(z).max() < 4.5
    assert (z**2).mean() == pytest.approx(1.0, abs=4.5 * np.sqrt(2 / big.sum()))


@pytest.mark.parametrize("d", [3, 4])
def test_folding_at_two_coordinates_adds_up_every_combination(d):
    """Even and odd powers, one bound and two, against SciPy image by image."""
    rng = np.random.default_rng(d)
    factors = [np.linalg.cholesky(np.cov(rng.standard_normal((d, 20)))) for _ in range(3)]
    means, weights = rng.standard_normal((3, d)), np.array([0.5, 0.2, 0.3])
    bounds = bounds_array({0: (-1.0, np.inf), 2: (-0.5, 2.0)}, d)
    q = first_proposal(means, factors, weights, bounds)
    x = rng.standard_normal((150, d))
    x = x[(x[:, 0] > -1) & (x[:, 2] > -0.5) & (x[:, 2] < 2)]
    total = np.zeros(len(x))
    for first in (None, -1.0):
        for third in (None, -0.5, 2.0):
            image = x.copy()
            if first is not None:
                image[:, 0] = 2 * first - x[:, 0]
            if third is not None:
                image[:, 2] = 2 * third - x[:, 2]
            for w, m, f in zip(weights, means, factors, strict=True):
                total += w * multivariate_t(m, f @ f.T, df=6.0).pdf(image)
    np.testing.assert_allclose(q.log_density(x), np.log(total), rtol=1e-9)


def test_first_proposal_is_the_given_mixture_and_needs_no_triangle():
    rng = np.random.default_rng(5)
    factor = rng.standard_normal((3, 3))  # any square root
    q = first_proposal(np.zeros((1, 3)), [factor], np.ones(1), bounds_array({}, 3))
    x = rng.standard_normal((20, 3))
    expected = multivariate_t(np.zeros(3), factor @ factor.T, df=6.0).logpdf(x)
    np.testing.assert_allclose(q.log_density(x), expected, rtol=1e-9)


@pytest.mark.parametrize("d", [2, 7, 20])
def test_transport_map_is_inverted_exactly_and_knows_its_jacobian(d):
    rng = np.random.default_rng(d)
    points = rng.standard_normal((3000, d)) * np.geomspace(0.1, 3, d)
    points[:, -1] = points[:, -1] * np.exp(0.5 * points[:, 0] / 0.1) + 100 * points[:, 0] ** 2
    bounded = np.zeros(d, dtype=bool)
    bounded[d // 2] = d > 2
    transport = fit_transport_map(points, bounded)
    x = points[:40] * 1.3
    r, log_jacobian = transport.to_reference(x)
    np.testing.assert_allclose(transport.from_reference(r), x, rtol=1e-9, atol=1e-11)
    for row, expected in zip(x[:8], log_jacobian[:8], strict=True):
        h = 1e-6 * points.std(axis=0)
        moved, _ = transport.to_reference(np.concatenate([row + np.diag(h), row - np.diag(h)]))
        jacobian = (moved[:d] - moved[d:]).T / (2 * h)
        assert expected == pytest.approx(np.linalg.slogdet(jacobian)[1], abs=1e-5)
    assert np.ptp(log_jacobian) > 0.1  # a funnel: the width follows the first coordinate
    if d > 2:  # the bounded coordinate is only shifted and scaled: its bound stays straight
        place = int(np.flatnonzero(transport.order == d // 2)[0])
        z = (x[:, d // 2] - transport.centre[place]) / transport.scale[place]
        np.testing.assert_allclose(r[:, place], z, rtol=1e-12)
    straight = transport.to_reference(points)[0][:, np.flatnonzero(transport.order == d - 1)[0]]
    assert abs(np.corrcoef(straight, points[:, 0] ** 2)[0, 1]) < 0.1
    assert abs(np.corrcoef(np.abs(straight), points[:, 0])[0, 1]) < 0.15


def test_few_points_give_few_components_not_an_error():
    rng = np.random.default_rng(1)
    assert len(fit_mixture(rng.standard_normal((30, 6)), rng, components=8).weights) == 1
    close = np.tile([[1.0, 2.0]], (50, 1)) + 1e-9 * rng.standard_normal((50, 2))
    constant = np.column_stack([rng.standard_normal(200), np.ones(200)])
    for points in (close, constant):
        q = fit_transported_mixture(points, rng)
        assert np.isfinite(q.log_density(q.sample(rng, 10))).all()
