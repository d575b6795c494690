"""The sampler on densities that are no posterior of a specimen, from search to judged draws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from analytic_targets import on_second_ridge, two_modes, two_ridges
from biaxbayes.errors import NotConverged
from biaxbayes.sampling import Plan, Target, bounds_array, draw, log_integral, search
from biaxbayes.sampling.convergence import effective_sample_size
from biaxbayes.sampling.modes import Mode, mode_clusters

QUICK = Plan(ess=1000, seed=3, population=2048)
BOUNDS = bounds_array({0: (0.0, np.inf)}, 2)


def bounded_banana(x):
    """x_0 half normal, x_1 normal around x_0^2: the integral is pi."""
    log_prob = -0.5 * x[:, 0] ** 2 - 0.5 * (x[:, 1] - x[:, 0] ** 2) ** 2
    return np.where(x[:, 0] >= 0.0, log_prob, -np.inf)


def sampled(target, starts, scale, plan=QUICK, **options):
    start = search(target, starts, scale, plan.search_rng(), plan.population)
    return draw(target, start, plan, **options)


@pytest.fixture(scope="module")
def banana():
    return sampled(Target(bounded_banana, BOUNDS), np.array([[1.0, 0.0]]), np.ones(2))


def within_error(draws, expected):
    error = draws.std() / np.sqrt(effective_sample_size(draws))
    return abs(draws.mean() - expected) < 4.5 * error


def test_moments_of_a_bent_density_that_ends_at_a_bound(banana):
    assert banana.convergence.state == "converged"
    assert banana.convergence.worst_ess >= QUICK.ess
    x, y = banana.quantities["x0"], banana.quantities["x1"]
    assert x.min() >= 0.0
    assert within_error(x, np.sqrt(2.0 / np.pi))
    assert within_error(x**2, 1.0)
    assert within_error(y, 1.0)
    assert within_error((y - x**2) ** 2, 1.0)
    assert within_error((x < norm.ppf(0.525)).astype(float), 0.05)  # next to the bound
    assert banana.evaluations == {}  # nothing was counted


def test_its_integral(banana):
    value, error = log_integral(banana.target.log_prob, banana.chain, banana.proposal, seed=1)
    assert 0.0 < error < 0.05
    assert abs(value - np.log(np.pi)) < 4.5 * error


@pytest.mark.parametrize("start", [0, 1])
def test_both_modes_are_reached_from_starts_near_each_and_weigh_what_they_should(start):
    """Ten standard deviations apart, weights 0.3 and 0.7, whichever is the best guess."""
    target = two_modes(6)
    starts = np.zeros((2, 6))
    starts[start, 0], starts[1 - start, 0] = -4.0, 4.0
    result = sampled(Target(target.log_density, target.bounds), starts, np.ones(6))
    assert result.convergence.state == "converged"
    assert len(result.proposal.parts) == 2
    low = (result.quantities["x0"] < 0.0).astype(float)
    assert within_error(low, 0.3)
    assert (low.mean(axis=(1, 2)) > 0.1).all()  # in every ensemble


RIDGES = [two_ridges(8, share=share, bend=bend) for share in (0.3, 0.05) for bend in (0.0, 1.0)]


@pytest.mark.long
@pytest.mark.parametrize("target", RIDGES, ids=lambda target: target.name)
def test_two_ridges_that_one_map_cannot_hold_weigh_what_they_should(target):
    starts = 8.0 * np.eye(8)[:2]
    start = search(
        Target(target.log_density, target.bounds),
        starts,
        2.0 * np.ones(8),
        QUICK.search_rng(),
        QUICK.population,
    )
    assert len(start.proposal.parts) == 2
    exact = on_second_ridge(target.sample(np.random.default_rng(1), 200_000)).mean()
    w = np.exp(start.log_weight - start.log_weight.max())
    of_search = (w * on_second_ridge(start.points)).sum() / w.sum()
    assert abs(of_search - exact) < 0.1 * exact + 0.03
    result = draw(Target(target.log_density, target.bounds), start, QUICK)
    assert result.convergence.state == "converged"
    second = on_second_ridge(result.chain).astype(float)
    assert within_error(second, exact)
    assert (second.mean(axis=(1, 2)) > 0.5 * exact).all()  # in every ensemble


def test_modes_on_one_ridge_have_one_part_and_a_ridge_without_mass_has_none():
    """Three starts along a straight ridge; a second ridge of e^-12 of the mass."""

    def log_density(x):
        ridge = norm.logpdf(x, 0.0, [9.0, 0.3, 0.3]).sum(axis=1)
        return np.logaddexp(ridge, norm.logpdf(x, [0.0, 9.0, 0.0], 0.5).sum(axis=1) - 12.0)

    target = Target(log_density, bounds_array({}, 3))
    starts = np.array([[0.0, 0.0, 0.0], [-9.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0]])
    modes = [Mode(x, 0.3 * np.eye(3), 0.0, float(log_density(x[None])[0])) for x in starts]
    groups = mode_clusters(log_density, modes)
    assert [len(group) for group in groups] == [3, 1]
    assert groups[0][0] is modes[0]
    start = search(target, starts, np.ones(3), QUICK.search_rng(), QUICK.population)
    assert len(start.proposal.parts) == 1


def counting(**more) -> Target:
    """The bent density, which counts its evaluations."""
    counts = np.zeros(2, dtype=np.int64)

    def log_prob(x):
        out = bounded_banana(x)
        np.add(counts, [np.isfinite(out).sum(), np.isinf(out).sum()], out=counts)
        return out

    return Target(log_prob, BOUNDS, **more, counts=counts, reasons=("beyond",))


def test_quantities_and_reasons_are_those_of_the_target():
    """Assessed, not assessed and counted by name."""
    target = counting(
        quantities=lambda x, log_prob: {
            "ratio": x[:, 1] / (1.0 + x[:, 0]),
            "noise": np.arange(len(x)) * 1.0,
            "lp": log_prob,
        },
        skip_diagnostics=("noise",),
    )
    result = sampled(target, np.array([[1.0, 0.0]]), np.ones(2), replace(QUICK, ess=300))
    assert result.convergence.names == ("ratio", "lp")
    assert set(result.quantities) == {"ratio", "noise", "lp"}
    lp = bounded_banana(result.chain.reshape(-1, 2)).reshape(result.chain.shape[:3])
    np.testing.assert_allclose(result.quantities["lp"], lp)
    assert result.evaluations == {"evaluated": target.counts.sum(), "beyond": target.counts[1]}


@pytest.mark.long
def test_a_run_continued_from_any_of_its_states_is_the_same_run():
    plan = replace(QUICK, ess=1e9, max_steps=200, first_block=64)
    target = counting()
    states = []
    whole = sampled(target, np.array([[1.0, 0.0]]), np.ones(2), plan, on_block=states.append)
    assert len(states) > 2 and states[0].steps == 0
    for state in states[:-1]:
        again = draw(counting(), replace(state), plan)
        np.testing.assert_array_equal(again.chain, whole.chain)
        assert again.evaluations == whole.evaluations and whole.evaluations["beyond"]


def test_a_density_that_is_zero_everywhere_is_refused():
    nowhere = Target(lambda x: np.full(len(x), -np.inf), bounds_array({}, 2))
    with pytest.raises(NotConverged, match="no region of positive density"):
        sampled(nowhere, np.zeros((1, 2)), np.ones(2))
