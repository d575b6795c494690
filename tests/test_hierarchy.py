"""Means, donors and spreads against what is known without sampling."""

import math

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from biaxbayes.populations.hierarchy import Common, Layout, correlation_factors
from biaxbayes.populations.population_result import truncated_median
from biaxbayes.populations.reweighting import MAX_K, RunDraws
from biaxbayes.populations.sampler import PopulationCheckpoint, PopulationPlan, draw_population
from biaxbayes.stored_data import pack_record, unpack_record

INF = math.inf
GROUP = np.array([0, 0, 1, 1, 0, 1])
DONOR = np.array([0, 1, 0, 1, 2, 2])


def layout(*, low: float = -INF, high: float = INF, p: int = 1, eta: float = 0.0) -> Layout:
    scale = np.full(p, 0.5)
    ends = np.full(p, low), np.full(p, high)
    scales = np.array([scale, scale])
    return Layout(GROUP, DONOR, np.zeros(2, int), 3, 1, *ends, 2 * scale, scales, np.full(2, eta))


def common(of: Layout, theta: np.ndarray, rng: np.random.Generator, **state) -> Common:
    """Chains at a given state."""
    out = Common(of, theta, rng)
    for name, values in state.items():
        assert getattr(out, name).shape == values.shape
        setattr(out, name, values)
    return out


def by_definition(of: Layout, theta: np.ndarray, sd: np.ndarray, factors: list) -> float:
    """Log density of values (n, p), means and effects integrated out, by their covariance."""
    roots = [s[:, None] * F for s, F in zip(sd, factors, strict=True)]
    n, p = theta.shape
    whole = np.zeros((n, p, n, p))
    for i in range(n):
        own = roots[1 + of.set_of[i]]
        for j in range(n):
            whole[i, :, j] += (i == j) * own @ own.T
            whole[i, :, j] += (of.donor[i] == of.donor[j]) * roots[0] @ roots[0].T
            whole[i, :, j] += (of.group[i] == of.group[j]) * np.diag(of.mean_sd**2)
    x, whole = theta.ravel(), whole.reshape(n * p, n * p)
    return -0.5 * x @ np.linalg.solve(whole, x) - 0.5 * np.linalg.slogdet(whole)[1]


@pytest.mark.parametrize(("p", "eta"), [(1, 0.0), (3, 0.0), (3, 1.0)])
def test_means_and_effects_are_integrated_out(p, eta):
    rng = np.random.default_rng(1)
    of = layout(p=p, eta=eta)
    theta, sd = rng.standard_normal((2, 6, p)), 0.3 + rng.random((2, 2, p))
    pairs = p * (p - 1) // 2 if eta else 0
    partial = rng.uniform(-0.7, 0.7, (2, 2, pairs))
    chains = common(of, theta, rng, sd=sd, partial=partial)
    result = chains.log_marginal(chains.with_rejected(theta))[0].sum(axis=1)
    factors = [correlation_factors(partial[:, side], p) for side in (0, 1)]
    for c in range(2):
        known = by_definition(of, theta[c], sd[c], [F[c] for F in factors])
        assert result[c] - 2 * np.log(of.mean_sd).sum() == pytest.approx(known, rel=1e-9)


def test_donors_of_other_counts_and_groups_of_other_spreads():
    """Equal and unequal counts, a group that a donor lacks: by the covariance of the whole."""
    rng = np.random.default_rng(3)
    group = np.array([0, 0, 1, 0, 0, 1, 1, 0, 0])
    donor = np.array([0, 0, 0, 1, 1, 1, 2, 3, 3])
    scale = np.full(2, 0.5)
    ends = np.full(2, -INF), np.full(2, INF)
    scales = np.array([scale, scale])
    of = Layout(group, donor, np.array([0, 1]), 4, 2, *ends, 2 * scale, scales, np.ones(2))
    theta, sd = rng.standard_normal((1, 9, 2)), 0.3 + rng.random((1, 3, 2))
    partial = np.array([[[0.6], [-0.4]]])
    chains = common(of, theta, rng, sd=sd, partial=partial)
    result = chains.log_marginal(chains.with_rejected(theta))[0]
    first, second = (correlation_factors(partial[:, side], 2)[0] for side in (0, 1))
    known = by_definition(of, theta[0], sd[0], [first, second, second])
    assert result[0, 0] == pytest.approx(known, rel=1e-9)  # means have a prior sd of 1


@pytest.mark.long
def test_draws_of_the_whole_model_keep_its_prior():
    """Geweke's joint test, cut at both sides: values given spreads, spreads given values."""
    rng = np.random.default_rng(4)
    of = layout(low=-0.8, high=0.9)
    C, n = 600, 6

    def spreads(size):
        mu = of.mean_sd * rng.standard_normal((size, 2, 1))
        sd = np.abs(0.5 * rng.standard_normal((size, 2, 1)))
        return mu, sd[:, :1] * rng.standard_normal((size, 3, 1)), sd

    def inside(mu, effect, sd):
        m = mu[:, GROUP, 0] + effect[:, DONOR, 0]
        return ndtr((0.9 - m) / sd[:, 1]) - ndtr((-0.8 - m) / sd[:, 1])

    def seen(mu, sd):
        return np.column_stack([np.log(sd[:, 0, 0]), np.log(sd[:, 1, 0]), mu[:, 0, 0] ** 2])

    mu, effect, sd = spreads(4 * C)
    allowed = (inside(mu, effect, sd) >= 0.01).all(axis=1)
    prior = seen(mu[allowed], sd[allowed])
    state = {"mu": mu[allowed][:C], "effect": effect[allowed][:C], "sd": sd[allowed][:C].copy()}
    chains = common(of, np.zeros((C, n, 1)), rng, **state)
    found = []
    for _ in range(60):
        m = chains.m()[..., 0]
        first = ndtr((-0.8 - m) / chains.sd[:, 1])
        share = inside(chains.mu, chains.effect, chains.sd)
        theta = m + chains.sd[:, 1] * norm.ppf(first + share * rng.random((C, n)))
        chains.update(np.clip(theta, -0.8, 0.9)[..., None])
        found.append(seen(chains.mu, chains.sd))
    result = np.mean(found[10:], axis=0)  # one mean per chain, the chains independent
    error = np.sqrt(result.var(axis=0) / C + prior.var(axis=0) / len(prior))
    assert (np.abs(result.mean(axis=0) - prior.mean(axis=0)) < 4.0 * error).all()


@pytest.mark.long
def test_correlations_keep_their_prior():
    """Geweke's joint test of two values that correlate, donors and specimens."""
    rng = np.random.default_rng(6)
    of = layout(p=2, eta=2.0)
    C = 400
    partial = 2.0 * rng.beta(2.0, 2.0, (C, 2, 1)) - 1.0
    sd = np.abs(0.5 * rng.standard_normal((C, 2, 2)))
    chains = common(of, np.zeros((C, 6, 2)), rng, partial=partial, sd=sd)
    chains.mu = of.mean_sd * rng.standard_normal((C, 2, 2))
    z = rng.standard_normal((C, 3, 2))
    chains.effect = np.einsum("cij,cdj->cdi", chains.factors(0), z) * sd[:, :1]
    seen = []
    for _ in range(40):
        z = rng.standard_normal((C, 6, 2))
        own = np.einsum("cij,cnj->cni", chains.factors(1), z) * chains.sd[:, 1:]
        chains.update(chains.m() + own)
        c = chains.partial
        seen.append(np.column_stack([c[:, j, 0] ** k for j in (0, 1) for k in (1, 2)]))
    result = np.mean(seen[5:], axis=0)
    # (1 + c) / 2 ~ Beta(2, 2): mean of c 0, of its square 1/5
    error = result.std(axis=0) / math.sqrt(C)
    assert (np.abs(result.mean(axis=0) - [0.0, 0.2, 0.0, 0.2]) < 4.0 * error).all()


def test_median_of_a_cut_normal():
    x = np.random.default_rng(2).normal(0.1, 0.2, 400_000)
    known = np.median(x[(x > 0.0) & (x < 0.3)])
    assert truncated_median(np.array([0.1]), np.array([0.2]), 0.0, 0.3)[0] == pytest.approx(
        known, abs=1e-3
    )
    assert truncated_median(np.array([0.1]), np.array([0.2]), -INF, INF)[0] == 0.1


ERROR = 0.3
Y = np.array([0.2, 0.5, -0.4, -0.9, 0.6, -0.1])
QUICK = {**{"ensembles": 4, "chains": 24, "warm_up": 60}, **{"first_block": 160, "max_steps": 160}}


def drawn(i: int, prior_mean: float, prior_sd: float, rng: np.random.Generator) -> RunDraws:
    """Draws of a specimen whose likelihood is N(Y_i, ERROR^2), under a normal prior."""
    precision = 1 / ERROR**2 + 1 / prior_sd**2
    mean = (Y[i] / ERROR**2 + prior_mean / prior_sd**2) / precision
    theta = mean + rng.standard_normal((4, 1000, 1)) / precision**0.5
    return RunDraws({}, theta, -0.5 * ((theta[..., 0] - prior_mean) / prior_sd) ** 2)


def again(i: int, mean: np.ndarray, sd: np.ndarray, seed: int) -> RunDraws:
    return drawn(i, mean[0], sd[0], np.random.default_rng(seed))


def quantities(history, theta=None):
    return {
        "mean": history.mu[..., 0, 0],
        "sd_donors": history.sd[..., 0, 0],
        "sd_specimens": history.sd[..., 1, 0],
    }


def pooled(plan=None, *, prior_mean=0.0, prior_sd=0.7, again=again, **work):
    """The population of six specimens from draws under one prior."""
    rng = np.random.default_rng(8)
    specimens = [drawn(i, prior_mean, prior_sd, rng) for i in range(6)]
    asked = PopulationPlan(**{"ess": 50, "seed": 3} | QUICK | (plan or {}))
    return draw_population(layout(), specimens, asked, quantities, again, labels="ABCDEF", **work)


def by_quadrature() -> dict[str, tuple[float, float]]:
    """Posterior means and sds on a grid of both sds."""
    of, y = layout(), Y
    grid = np.exp(np.linspace(math.log(0.002), math.log(3.0), 70))
    rows = []
    X = np.eye(2)[GROUP]
    same = (DONOR[:, None] == DONOR).astype(float)
    for a in grid:
        for b in grid:
            V = (b * b + ERROR**2) * np.eye(6) + a * a * same
            whole = V + X @ X.T * of.mean_sd[0] ** 2
            log = -0.5 * y @ np.linalg.solve(whole, y) - 0.5 * np.linalg.slogdet(whole)[1]
            log += -0.5 * (a / 0.5) ** 2 - 0.5 * (b / 0.5) ** 2 + math.log(a * b)
            cov = np.linalg.inv(X.T @ np.linalg.solve(V, X) + np.eye(2) / of.mean_sd[0] ** 2)
            mean = cov @ X.T @ np.linalg.solve(V, y)
            rows.append((log, a, a * a, b, b * b, mean[0], mean[0] ** 2 + cov[0, 0]))
    table = np.array(rows)
    w = np.exp(table[:, 0] - table[:, 0].max())
    m = w @ table[:, 1:] / w.sum()
    names = ("sd_donors", "sd_specimens", "mean")
    return {
        name: (m[2 * k], math.sqrt(m[2 * k + 1] - m[2 * k] ** 2)) for k, name in enumerate(names)
    }


def assert_agrees(result, within: float = 0.002) -> None:
    known, convergence = by_quadrature(), result.convergence
    found = quantities(result.history)
    for name, ess in zip(convergence.names, convergence.ess_bulk, strict=True):
        mean, sd = known[name]
        assert abs(found[name].mean() - mean) < 4.0 * sd / math.sqrt(ess) + within, name
        assert found[name].std() == pytest.approx(sd, rel=0.12), name


@pytest.mark.long
def test_more_is_never_done_than_there_is():
    """However many draws there are: chains that are too short have not converged."""
    seen = []
    short = {"ess": 1, "first_block": 20, "max_steps": 60}
    result = pooled(short, progress=seen.append)
    assert result.convergence.state != "converged" and result.convergence.worst_ess > 2.0
    shares = [step.share for step in seen if step.share is not None]
    assert len(shares) > 1 and max(shares) < 1.0


@pytest.mark.long
def test_sampler_agrees_with_quadrature():
    """The prior of the runs is divided out."""
    result = pooled()
    assert_agrees(result)
    assert not result.sampled_again
    # the specimens are drawn as their likelihood and the others have them
    assert np.corrcoef(result.theta.mean(axis=(0, 1, 2))[:, 0], Y)[0, 1] > 0.95


@pytest.mark.long
def test_runs_whose_draws_are_elsewhere_are_sampled_again():
    """Under a prior that keeps the runs from where their specimens are."""
    seen = []
    result = pooled(prior_mean=3.0, prior_sd=0.15, progress=seen.append)
    assert any("A, B, C, D and 2 more of 6 specimens again" in step.note for step in seen)
    assert "sampling F again, round 1" in [step.phase for step in seen]
    assert result.sampled_again == list(range(6)) and (result.pareto_k < MAX_K).all()
    assert_agrees(result, within=0.01)
    left = pooled({"rounds": 0}, prior_mean=3.0, prior_sd=0.15)
    assert not left.sampled_again and (left.pareto_k > MAX_K).any()
    assert not pooled({"rounds": 1}).sampled_again
    assert pooled({"rounds": 1}, cut_short=[4]).sampled_again == [4]


@pytest.mark.long
def test_a_run_is_sampled_again_under_the_prior_that_the_others_make():
    given = {}

    def noted(i: int, mean: np.ndarray, sd: np.ndarray, seed: int) -> RunDraws:
        assert mean.shape == sd.shape == (1,)
        given[i] = mean[0], sd[0]
        return again(i, mean, sd, seed)

    h = pooled({"rounds": 1, "warm_up": 160}, cut_short=[4], again=noted).history
    # a new specimen of its donor and group
    m = h.mu[..., GROUP[4], 0] + h.effect[..., DONOR[4], 0]
    new = m + h.sd[..., 1, 0] * np.random.default_rng(4).standard_normal(m.shape)
    assert [*given] == [4]
    assert given[4] == pytest.approx((new.mean(), new.std()), rel=0.1)


@pytest.mark.long
def test_one_seed_the_same_bytes_whatever_comes_between():
    quick = {"first_block": 24, "max_steps": 60, "chains": 8, "warm_up": 20, "ess": 1e9}
    elsewhere = {"prior_mean": 1.0, "prior_sd": 0.2}
    stored = []

    def keep(state: PopulationCheckpoint) -> None:
        stored.append(pack_record(state.record()))

    whole = pooled(quick, on_step=keep, **elsewhere)
    assert len(whole.sampled_again) > 1 and len(stored) > len(whole.sampled_again) + 1
    results = [pooled(quick | {"workers": 3}, **elsewhere)]
    for record in stored:  # after every run that was sampled again, and after every block
        state = PopulationCheckpoint.from_record(unpack_record(record))
        results.append(pooled(quick, state=state, **elsewhere))
    for result in results:
        assert result.sampled_again == whole.sampled_again
        for name, values in vars(whole.history).items():
            assert values.tobytes() == getattr(result.history, name).tobytes(), name
    assert pooled(quick, stop=lambda: True, **elsewhere) is None
    another = pooled(quick | {"seed": 6}, **elsewhere)
    assert (another.history.mu != whole.history.mu).any()
