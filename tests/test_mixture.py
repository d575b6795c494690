"""Mixtures of proposals and their fits, against known densities and scikit-learn."""

import warnings

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from analytic_targets import TARGETS, largest_departures, limit, on_second_ridge, two_ridges
from biaxbayes.sampling import mixture
from biaxbayes.sampling.adaptation import warm_up
from biaxbayes.sampling.ensembles import Ensembles
from biaxbayes.sampling.independence_move import AdaptedIndependenceMove
from biaxbayes.sampling.proposal import MixtureProposal, first_proposal
from biaxbayes.sampling.target import bounds_array

RIDGES = two_ridges(6, share=0.5, bend=1.0)
SIX = [t for t in TARGETS if t.dimension == 6]


def fitted(target, seed=1, points=6000):
    move = AdaptedIndependenceMove(np.random.default_rng(seed), bounds=target.bounds)
    history = target.sample(np.random.default_rng(seed + 100), points)
    label = on_second_ridge(history) if target is RIDGES else history[:, 0] > 2.0
    move.adapt(history, components=12, label=label.astype(int))
    move.freeze()
    return move


def unequal(target):
    """A mixture whose parts are far from equal shares of the target."""
    parts = fitted(target).proposal.parts
    return MixtureProposal(np.array([0.85, 0.15]), parts)


@pytest.mark.parametrize("target", [SIX[1], SIX[3], RIDGES], ids=lambda t: t.name)
def test_a_step_leaves_the_target_and_is_reversible(target):
    move = fitted(target)
    assert len(move.proposal.parts) == 2
    stationary, reversible = largest_departures(move, target)
    assert stationary[0] < limit(stationary[1])
    assert reversible[0] < limit(reversible[1])


def test_the_density_is_normalised_and_matches_its_draws():
    """E_p[q / p] = 1 for draws of the target, and shares of draws by part are the weights."""
    q = unequal(RIDGES)
    x = q.sample(np.random.default_rng(4), 40_000)
    ratio = np.exp(RIDGES.log_density(x) - q.log_density(x))  # the target is normalised
    assert abs(ratio.mean() - 1.0) < 4 * ratio.std() / np.sqrt(len(x))
    share = (q.log_densities(x).argmax(axis=0) == 0).mean()
    assert abs(share - 0.85) < 0.02
    # every row has the same chance of either part, or a walker would meet but one of them
    halves = np.array_split(q.log_densities(x).argmax(axis=0), 2)
    assert abs(halves[0].mean() - halves[1].mean()) < 4 * np.sqrt(0.85 * 0.15 * 4 / len(x))


NO_BOUNDS = bounds_array({}, 2)


@pytest.mark.parametrize("far", [0.0, 0.005])
def test_a_proposal_is_kept_as_it_is_only_where_it_holds_no_walker_in_the_tails(far):
    rng = np.random.default_rng(4)

    def log_density(x):
        with np.errstate(divide="ignore"):
            return np.logaddexp(
                np.log1p(-far) + norm.logpdf(x).sum(axis=1),
                np.log(far) + norm.logpdf(x - [12.0, 0.0]).sum(axis=1),
            )

    starts = [1.3 * rng.standard_normal((24, 2)) for _ in range(4)]
    ensembles = Ensembles(log_density, starts, np.random.SeedSequence(5))
    part = first_proposal(np.zeros((1, 2)), [1.1 * np.eye(2)], np.ones(1), NO_BOUNDS)
    proposal = MixtureProposal(np.ones(1), (part,))
    spread = 1.5 * rng.standard_normal((1000, 2))
    spread[:100, 0] += 12.0 * (far > 0.0)
    result = warm_up(ensembles, proposal, spread, spread)
    assert (ensembles.proposal.parts[0] is part) == (far == 0.0)
    assert 0.5 < result.acceptance <= 1.0 and result.rounds == 2
    with pytest.raises(RuntimeError, match="frozen"):
        ensembles.adapt(spread)


def test_a_warm_up_ends_after_two_rounds_that_are_not_better(monkeypatch):
    accepted = iter([0.2, 0.2, 0.3, 0.31, 0.31, *[0.31] * 9])
    monkeypatch.setattr(Ensembles, "acceptance", property(lambda self: next(accepted)))
    rng = np.random.default_rng(2)
    starts = [rng.standard_normal((24, 2)) for _ in range(2)]
    ensembles = Ensembles(lambda x: norm.logpdf(x).sum(axis=1), starts, np.random.SeedSequence(5))
    part = first_proposal(np.zeros((1, 2)), [1.1 * np.eye(2)], np.ones(1), NO_BOUNDS)
    spread = rng.standard_normal((1000, 2))
    result = warm_up(ensembles, MixtureProposal(np.ones(1), (part,)), spread, spread)
    assert result.rounds == 5


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
        tol=mixture.EM_TOLERANCE,
        random_state=seed,
    )


def mean_log_density(x, fit):
    """Score of the Gaussian mixture whose covariances became scale matrices."""
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
