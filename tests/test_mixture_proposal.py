"""Two proposals side by side, for densities that no single map makes Gaussian."""

import numpy as np
import pytest
from scipy.stats import norm

from analytic_targets import TARGETS, Target, largest_departures, limit, one_step
from biaxbayes.sampling.adaptation import add_components
from biaxbayes.sampling.independence_move import AdaptedIndependenceMove
from biaxbayes.sampling.proposal import MixtureProposal, first_proposal, fit_mixture_proposal
from biaxbayes.sampling.target import bounds_array


def two_ridges(d):
    """Two bent ridges of different direction and width, side by side."""

    def parts(x):
        left, right = x.copy(), x.copy()
        left[:, 1] -= 1.5 * (x[:, 0] ** 2 - 1)
        right[:, 0] -= 4.0
        right[:, 2] += 1.5 * (right[:, 0] ** 2 - 1)
        right[:, 1] = (right[:, 1] - 2.0 * right[:, 0]) / 0.1
        return left, right

    def log_density(x):
        left, right = (norm.logpdf(z).sum(axis=1) for z in parts(x))
        return np.logaddexp(left, right - np.log(0.1)) - np.log(2.0)

    def sample(rng, n):
        x = rng.standard_normal((n, d))
        right = rng.random(n) < 0.5
        left = ~right
        x[left, 1] += 1.5 * (x[left, 0] ** 2 - 1)
        x[right, 1] = 0.1 * x[right, 1] + 2.0 * x[right, 0]
        x[right, 2] -= 1.5 * (x[right, 0] ** 2 - 1)
        x[right, 0] += 4.0
        return x

    return Target(f"two-ridges-{d}", d, log_density, sample)


RIDGES = two_ridges(6)
SIX = [t for t in TARGETS if t.dimension == 6]


def fitted(target, parts, seed=1, points=6000):
    move = AdaptedIndependenceMove(np.random.default_rng(seed), bounds=target.bounds)
    history = target.sample(np.random.default_rng(seed + 100), points)
    move.adapt(history, components=12, parts=parts)
    move.freeze()
    return move


def unequal(target):
    """A mixture whose parts are far from equal shares of the target."""
    parts = fitted(target, 2).proposal.parts
    return MixtureProposal(np.array([0.85, 0.15]), parts)


@pytest.mark.parametrize("target", [*SIX, RIDGES], ids=lambda t: t.name)
def test_a_step_leaves_the_target_and_is_reversible(target):
    move = fitted(target, 2)
    assert len(move.proposal.parts) == 2
    stationary, reversible = largest_departures(move, target)
    assert stationary[0] < limit(stationary[1])
    assert reversible[0] < limit(reversible[1])


def test_forgotten_weights_are_caught():
    class Unweighted(MixtureProposal):
        def log_density(self, x):
            return np.logaddexp(*(part.log_density(x) for part in self.parts))

    right = unequal(RIDGES)
    for q in (right, Unweighted(right.weights, right.parts)):
        move = AdaptedIndependenceMove(np.random.default_rng(3), proposal=q)
        stationary, _ = largest_departures(move, RIDGES)
        assert (stationary[0] > limit(stationary[1])) == isinstance(q, Unweighted)


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


def test_two_maps_follow_two_ridges():
    """More proposals are accepted than with one map and as many components."""
    start = RIDGES.sample(np.random.default_rng(8), 4000)
    accepted = []
    for parts in (1, 2):
        move = fitted(RIDGES, parts)
        one_step(move, RIDGES, start)
        accepted.append(move.acceptance)
    assert accepted[1] > accepted[0] + 0.04, accepted  # its error is 0.006


def test_groups_far_from_equal_stay_together():
    rng = np.random.default_rng(5)
    x = rng.standard_normal((2000, 3))
    x[:40] += 30.0
    assert len(fit_mixture_proposal(x, rng, parts=2).parts) == 1
    x[:600] += 30.0
    assert len(fit_mixture_proposal(x, rng, parts=2).parts) == 2


def test_arrays_carry_everything():
    q = unequal(SIX[3])  # with folded bounds
    again = MixtureProposal.from_arrays(q.arrays())
    x = q.sample(np.random.default_rng(6), 300)
    np.testing.assert_array_equal(again.log_density(x), q.log_density(x))
    np.testing.assert_array_equal(again.sample(np.random.default_rng(6), 300), x)


@pytest.mark.parametrize("parts", [1, 2])
def test_added_components_lower_the_largest_weight_and_keeps_the_density_normalised(parts):
    rng = np.random.default_rng(7)
    x = RIDGES.sample(rng, 6000)
    short = x[x[:, 0] < 4.5]  # the end of a ridge is missing
    q = fit_mixture_proposal(short, rng, bounds=bounds_array({}, 6), parts=parts)
    log_prob = RIDGES.log_density(x)
    covered = add_components(q, q.located(x), log_prob, 0.0)
    assert covered is not q
    assert abs(covered.weights.sum() - 1.0) < 1e-12
    for part in covered.parts:
        assert abs(part.mixture.weights.sum() - 1.0) < 1e-12
    before, after = (float((log_prob - p.log_density(x)).max()) for p in (q, covered))
    assert after < before - 0.5
    y = covered.sample(rng, 40_000)
    ratio = np.exp(RIDGES.log_density(y) - covered.log_density(y))
    assert abs(ratio.mean() - 1.0) < 4 * ratio.std() / np.sqrt(len(y))


def test_nothing_is_added_where_nothing_stands_out():
    x = np.random.default_rng(9).standard_normal((2000, 2))
    exact = first_proposal(np.zeros((1, 2)), [np.eye(2)], np.ones(1), bounds_array({}, 2))
    q = MixtureProposal(np.ones(1), (exact,))
    assert add_components(q, q.located(x), norm.logpdf(x).sum(axis=1), 0.0) is q
