"""Convergence diagnostics against ArviZ, analytic autocorrelation times, and chains that lie."""

import arviz
import numpy as np
import pytest
from scipy.stats import norm, rankdata

from biaxbayes.sampling.convergence import (
    assess,
    autocorrelation_time,
    effective_sample_size,
    split_rhat,
)

SHAPE = (4, 400, 32)  # ensembles, steps, walkers


def ar1(rho, shape=SHAPE, seed=0):
    """Independent stationary AR(1) walkers; tau = (1 + rho) / (1 - rho)."""
    rng = np.random.default_rng(seed)
    x = np.empty(shape)
    x[:, 0] = rng.standard_normal((shape[0], shape[2]))
    for t in range(1, shape[1]):
        noise = rng.standard_normal((shape[0], shape[2]))
        x[:, t] = rho * x[:, t - 1] + np.sqrt(1 - rho**2) * noise
    return x


def as_walkers(x):
    """ArviZ chains, one per walker."""
    return x.transpose(0, 2, 1).reshape(-1, x.shape[1])


def published_rhat(x):
    """Vehtari et al. (2021), equations 1 to 4 and section 4, of ensembles cut in halves."""
    half = x.shape[1] // 2
    folded = np.abs(x - np.median(x))
    result = []
    for values in (x, folded):
        ranks = rankdata(values).reshape(values.shape)
        z = norm.ppf((ranks - 3 / 8) / (x.size + 1 / 4))
        chains = np.array([part.ravel() for e in z for part in (e[:half], e[half:])])
        within = chains.var(axis=1, ddof=1).mean()
        n = chains.shape[1]
        total = (n - 1) / n * within + chains.mean(axis=1).var(ddof=1)
        result.append(np.sqrt(total / within))
    return max(result)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, -0.3])
def test_autocorrelation_time_is_that_of_the_process(rho):
    x = ar1(rho)
    assert autocorrelation_time(x) == pytest.approx((1 + rho) / (1 - rho), rel=0.12)
    # around any mean and in any unit
    assert autocorrelation_time(1e6 + 3 * x) == pytest.approx(autocorrelation_time(x), rel=1e-6)


def test_effective_size_of_short_chains_is_that_of_the_process():
    """25 autocorrelation times; ArviZ cuts walkers in halves, which makes the time longer."""
    result = [assess({"a": ar1(0.905, (4, 512, 64), seed)}, target_ess=1) for seed in range(4)]
    tau = 1.905 / 0.095
    assert np.mean([c.tau[0] for c in result]) == pytest.approx(tau, rel=0.15)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_effective_sizes_agree_with_arviz(rho):
    x = ar1(rho)
    c = assess({"a": x}, target_ess=100)
    bulk = arviz.ess(as_walkers(x), method="bulk")
    tail = arviz.ess(as_walkers(x), method="tail", prob=(0.05, 0.95))
    assert c.ess_bulk[0] == pytest.approx(bulk, rel=0.15)
    assert c.ess_tail[0] == pytest.approx(tail, rel=0.2)
    assert c.ess_bulk[0] <= x.size
    assert effective_sample_size(x) == pytest.approx(
        arviz.ess(as_walkers(x), method="mean"), rel=0.15
    )


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_slower_tail_limits_the_effective_size(side):
    x, slow = ar1(0.0), ar1(0.95, seed=4)
    x = side * np.where(slow > 1.5 * slow.std(), 5.0 + x, x)
    tail = arviz.ess(as_walkers(x), method="tail", prob=(0.05, 0.95))
    assert tail < 0.3 * x.size
    assert assess({"a": x}, target_ess=100).ess_tail[0] == pytest.approx(tail, rel=0.2)


@pytest.mark.parametrize("shift", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("stretch", [1.0, 1.3])
def test_rhat_is_the_published_one_of_ensembles(shift, stretch):
    x = ar1(0.5)
    x[0] = shift + stretch * x[0]
    assert split_rhat(x) == pytest.approx(published_rhat(x), rel=1e-12)
    assert assess({"a": x}, target_ess=100).rhat[0] == split_rhat(x)


def test_coverage_of_intervals_of_the_mean_is_what_the_effective_size_promises():
    hits = 0
    for seed in range(200):
        x = ar1(0.7, (2, 120, 16), seed)
        error = x.std() / np.sqrt(effective_sample_size(x))
        hits += abs(x.mean()) < 1.96 * error
    assert 180 <= hits <= 199  # 95 % of 200, within binomial error


def basins(chains, *, apart: float, seed: int) -> np.ndarray:
    """Independent draws of which some chains lie in another basin."""
    x = np.random.default_rng(seed).standard_normal(SHAPE)
    x[chains] += apart
    return x


@pytest.mark.parametrize(
    ("draws", "target", "state", "reason", "rhat"),
    [
        (ar1(0.8, (4, 300, 2)), 2000, "tentative", "effective sample size of a", ""),
        # Three in truth; ArviZ measures 2.4 on halves of walkers.
        (ar1(0.97, (4, 200, 200)), 100, "", "only 2 autocorrelation times of a", ""),
        # Each ensemble in its own basin; each with the same share of both: R-hat is blind.
        (basins(np.s_[3], apart=4.0, seed=2), 100, "unusable", "R-hat of a", "high"),
        (basins(np.s_[:, :, ::4], apart=6.0, seed=3), 100, "", "autocorrelation times", "low"),
    ],
    ids=["few", "short", "between ensembles", "within ensembles"],
)
def test_chains_that_are_too_short_or_in_two_basins_have_not_converged(
    draws, target, state, reason, rhat
):
    c = assess({"a": draws, "good": ar1(0.0, draws.shape, seed=5)}, target_ess=target)
    assert c.state == state if state else c.state != "converged"
    assert reason in c.reason
    if rhat == "high":
        assert c.worst_rhat > 1.5 and c.worst_ess < 300  # ArviZ's, of 51,200
    if rhat == "low":
        assert c.worst_rhat < 1.01


def test_chains_of_25_autocorrelation_times_are_long_enough():
    lengths = {}
    for rho in np.linspace(0.822, 0.836, 8):
        c = assess({"a": ar1(float(rho), (4, 300, 64), seed=8)}, target_ess=500)
        assert c.worst_rhat < 1.01
        lengths[300 / c.tau[0]] = c.state
    assert {x for x, state in lengths.items() if state == "converged"} == {
        x for x in lengths if x >= 25.0
    }
    assert any(24.0 < x < 25.0 for x in lengths) and any(25.0 < x < 26.0 for x in lengths)


@pytest.mark.parametrize("steps", [128, 512, 1024])
@pytest.mark.parametrize("stuck", [1, 4])
def test_walkers_stuck_in_a_tail_are_noticed(steps, stuck):
    x = np.random.default_rng(4).standard_normal((4, steps, 64))
    x[0, :, :stuck] = 3.0 + 0.1 * np.arange(stuck)
    assert assess({"a": x}, target_ess=2000).state != "converged"


def test_nothing_moving_or_nothing_there_is_unusable():
    rng = np.random.default_rng(6)
    still = np.broadcast_to(rng.standard_normal((4, 1, 32)), SHAPE).copy()
    for draws in (still, np.ones(SHAPE), rng.standard_normal((4, 1, 32))):
        assert assess({"a": draws}, target_ess=100).state == "unusable"
    assert split_rhat(np.repeat(np.arange(4.0)[:, None, None], 10, axis=1)) == np.inf


def test_one_still_walker_in_the_middle_is_noticed(monkeypatch):
    """Where it stands it costs hardly any effective draws: only its standing still tells."""
    draws = np.random.default_rng(5).standard_normal((4, 300, 64))
    draws[0, :150, 0] = draws[0, 0, 0] = 0.1
    result = assess({"k2": draws}, target_ess=1000.0)
    assert result.state == "tentative"
    assert result.reason == "a walker was stuck for 150 of 300 steps"
    monkeypatch.setattr("biaxbayes.sampling.convergence.MAX_STUCK", 1.0)
    assert assess({"k2": draws}, target_ess=1000.0).state == "converged"
