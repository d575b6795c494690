"""Shares of components that let an independence sampler move, and the warm-up that uses them."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm

from analytic_targets import TARGETS
from biaxbayes.sampling import adaptation as warmup
from biaxbayes.sampling.adaptation import KEPT, optimise_weights
from biaxbayes.sampling.ensembles import Ensembles
from biaxbayes.sampling.proposal import MixtureProposal, first_proposal, fit_mixture_proposal
from biaxbayes.sampling.student_mixture import StudentMixture
from biaxbayes.sampling.target import bounds_array

NO_BOUNDS = bounds_array({}, 2)


def circle(x):
    return norm.logpdf(x).sum(axis=1)


def mixture_of(shares, means, scales):
    factors = [s * np.eye(2) for s in scales]
    part = first_proposal(np.array(means), factors, np.array(shares), NO_BOUNDS)
    return MixtureProposal(np.ones(1), (part,))


def mean_weight(proposal, x, log_prob):
    """E[w] with both densities normalised, over draws x of the density."""
    return np.exp(log_prob - proposal.log_density(x)).mean()


def shares_of(proposal):
    pairs = zip(proposal.weights, proposal.parts, strict=True)
    return np.concatenate([w * part.mixture.weights for w, part in pairs])


def test_shares_are_those_that_a_general_optimiser_finds():
    rng = np.random.default_rng(1)
    x = rng.standard_normal((6000, 2))
    # three components around the target, none of them where it should be alone
    means, scales = [[-0.6, 0.0], [0.8, 0.3], [0.0, -0.5]], [0.9, 1.1, 0.7]
    start = mixture_of([0.3, 0.3, 0.4], means, scales)
    found = optimise_weights(start, x, circle(x), rng)

    kept = KEPT * np.array([0.3, 0.3, 0.4])

    def objective(free):
        return mean_weight(mixture_of(kept + (1.0 - KEPT) * free, means, scales), x, circle(x))

    one = {"type": "eq", "fun": lambda free: free.sum() - 1.0}
    best = minimize(
        objective, np.full(3, 1 / 3), bounds=[(0, 1)] * 3, constraints=one, method="SLSQP"
    )
    before, after = (mean_weight(q, x, circle(x)) for q in (start, found))
    assert best.fun - 1e-6 < after < best.fun + 0.1 * (before - best.fun)
    assert before - best.fun > 0.01
    assert shares_of(found).sum() == pytest.approx(1.0, abs=1e-12)


def test_a_component_beyond_the_points_keeps_its_part():
    rng = np.random.default_rng(2)
    x = rng.standard_normal((3000, 2))
    start = mixture_of([0.6, 0.4], [[0.0, 0.0], [40.0, 0.0]], [1.0, 1.0])
    found = shares_of(optimise_weights(start, x, circle(x), rng))
    assert found[1] == pytest.approx(0.4 * KEPT, rel=1e-6)


@pytest.mark.parametrize("target", [t for t in TARGETS if t.dimension == 6], ids=lambda t: t.name)
@pytest.mark.parametrize("parts", [1, 2])
def test_only_the_shares_change_and_walkers_are_held_less(target, parts):
    rng = np.random.default_rng(3)
    x = target.sample(rng, 8000)
    fitted = fit_mixture_proposal(x[:4000], rng, bounds=target.bounds, components=12, parts=parts)
    uneven = []
    for part in fitted.parts:  # every other component has far too much
        old = part.mixture
        weights = old.weights * np.where(np.arange(len(old.weights)) % 2, 5.0, 1.0)
        mixture = StudentMixture.from_factors(weights / weights.sum(), old.means, old.factors)
        uneven.append(type(part)(part.transport, mixture, part.bounds))
    start = MixtureProposal(fitted.weights, tuple(uneven))
    found = optimise_weights(start, x, target.log_density(x), rng)
    fresh = target.sample(rng, 20_000)
    before, after = (mean_weight(q, fresh, target.log_density(fresh)) for q in (start, found))
    assert after < before - 0.05
    for old, new in zip(start.parts, found.parts, strict=True):
        assert new.transport is old.transport
        assert np.array_equal(new.mixture.means, old.mixture.means)
        assert np.array_equal(new.mixture.factors, old.mixture.factors)
    assert found.weights.sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("far", [0.0, 0.005])
def test_a_proposal_is_kept_as_it_is_only_where_it_holds_no_walker_in_the_tails(far):
    rng = np.random.default_rng(4)

    def log_density(x):
        with np.errstate(divide="ignore"):
            return np.logaddexp(np.log1p(-far) + circle(x), np.log(far) + circle(x - [12.0, 0.0]))

    starts = [1.3 * rng.standard_normal((24, 2)) for _ in range(4)]
    ensembles = Ensembles(log_density, starts, np.random.SeedSequence(5))
    part = first_proposal(np.zeros((1, 2)), [1.1 * np.eye(2)], np.ones(1), NO_BOUNDS)
    proposal = MixtureProposal(np.ones(1), (part,))
    spread = 1.5 * rng.standard_normal((1000, 2))
    spread[:100, 0] += 12.0 * (far > 0.0)
    found = warmup.warm_up(ensembles, proposal, spread, spread)
    assert (ensembles.proposal.parts[0] is part) == (far == 0.0)
    assert found.acceptance > 0.5 and found.rounds == 2
    with pytest.raises(RuntimeError, match="frozen"):
        ensembles.adapt(spread)
