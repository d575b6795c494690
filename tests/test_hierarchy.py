"""Means, donors and spreads against what is known without sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from biaxbayes.populations.ensemble import Design, Ensemble, Individual, Tuning, scale_deviations
from biaxbayes.populations.hierarchy import Augmented, Block, Layout, augment, log_marginal, update
from biaxbayes.populations.result import truncated_median
from biaxbayes.populations.sampler import PopulationPlan, draw_population

INF = math.inf
GROUP = np.array([0, 0, 1, 1, 0, 1])
DONOR = np.array([0, 1, 0, 1, 2, 2])


def layout(*, low: float = -INF, high: float = INF, b: int = 1, eta: float = 0.0) -> Layout:
    scale = np.full(b, 0.5)
    ends = np.full(b, low), np.full(b, high)
    scales = np.array([scale, scale])
    return Layout(GROUP, DONOR, np.zeros(2, int), 3, 1, *ends, 2 * scale, scales, np.full(2, eta))


def covariance(of: Layout, omega: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Covariance of all values, means and effects integrated out: by its definition."""
    n, b = len(GROUP), len(omega)
    out = np.zeros((n, b, n, b))
    for i in range(n):
        for j in range(n):
            out[i, :, j] += (i == j) * sigma + (DONOR[i] == DONOR[j]) * omega
            out[i, :, j] += (GROUP[i] == GROUP[j]) * np.diag(of.mean_sd**2)
    return out.reshape(n * b, n * b)


def block(theta, sd_donors, factor_donors, sd, factor) -> Block:
    """What the integrals need; means, effects and partial correlations are left at zero."""
    zeros = np.zeros((len(theta), 4, theta.shape[2]))
    sds = np.concatenate([sd_donors[:, None], sd], axis=1)
    factors = np.stack([factor_donors, factor], axis=1)
    return Block(theta, zeros, zeros, sds, np.zeros((len(theta), 2, 0)), factors)


@pytest.mark.long
@pytest.mark.parametrize("b", [1, 3])
def test_means_and_effects_are_integrated_out(b):
    rng = np.random.default_rng(1)
    of = layout(b=b, eta=1.0)
    theta = rng.standard_normal((2, 6, b))
    factor = np.tile(np.eye(b), (2, 2, 1, 1))
    if b > 1:
        for k in range(2):
            made = np.linalg.cholesky(np.corrcoef(rng.standard_normal((b, 9))))
            factor[k] = made
    sd_donors, sd = 0.3 + rng.random((2, b)), 0.3 + rng.random((2, 1, b))
    nothing = Augmented(np.zeros((2, 6)), np.zeros((2, 6, b)), np.zeros((2, 1, b, b)))
    result = log_marginal(of, block(theta, sd_donors, factor[0], sd, factor[1]), nothing)
    for c in range(2):
        roots = [s[:, None] * f[c] for s, f in ((sd_donors[c], factor[0]), (sd[c, 0], factor[1]))]
        whole = covariance(of, *(r @ r.T for r in roots))
        x = theta[c].ravel()
        known = -0.5 * x @ np.linalg.solve(whole, x) - 0.5 * np.linalg.slogdet(whole)[1]
        known -= 0.5 * x.size * math.log(2 * math.pi)
        assert result[c] == pytest.approx(known, rel=1e-9)


@pytest.mark.long
def test_donors_of_other_counts_and_groups_of_other_spreads():
    """Equal and unequal counts, a group that a donor lacks: by the covariance of the whole."""
    rng = np.random.default_rng(3)
    group = np.array([0, 0, 1, 0, 0, 1, 1, 0, 0])
    donor = np.array([0, 0, 0, 1, 1, 1, 2, 3, 3])
    scale = np.full(2, 0.5)
    ends = np.full(2, -INF), np.full(2, INF)
    scales = np.array([scale, scale])
    of = Layout(group, donor, np.array([0, 1]), 4, 2, *ends, 2 * scale, scales, np.ones(2))
    theta = rng.standard_normal((1, 9, 2))
    factors = [np.linalg.cholesky(np.array([[1.0, c], [c, 1.0]])) for c in (0.6, -0.4)]
    sd_donors, sd = 0.3 + rng.random((1, 2)), 0.3 + rng.random((1, 2, 2))
    nothing = Augmented(np.zeros((1, 9)), np.zeros((1, 9, 2)), np.zeros((1, 2, 2, 2)))
    of_block = block(theta, sd_donors, factors[0][None], sd, factors[1][None])
    result = log_marginal(of, of_block, nothing)
    root = sd_donors[0][:, None] * factors[0]
    whole = np.zeros((9, 2, 9, 2))
    for i in range(9):
        own = sd[0, group[i]][:, None] * factors[1]
        for j in range(9):
            whole[i, :, j] += (i == j) * own @ own.T + (donor[i] == donor[j]) * root @ root.T
            whole[i, :, j] += (group[i] == group[j]) * np.eye(2)
    x, whole = theta[0].ravel(), whole.reshape(18, 18)
    known = -0.5 * x @ np.linalg.solve(whole, x) - 0.5 * np.linalg.slogdet(whole)[1]
    assert result[0] == pytest.approx(known - 9 * math.log(2 * math.pi), rel=1e-9)


@pytest.mark.long
def test_draws_of_the_whole_model_keep_its_prior():
    """Geweke's joint test, cut at both sides: values given spreads, spreads given values."""
    rng = np.random.default_rng(4)
    of = layout(low=-0.8, high=0.9)
    C, n = 600, 6

    def spreads(size):
        mu = of.mean_sd * rng.standard_normal((size, 2, 1))
        sd_donors = np.abs(0.5 * rng.standard_normal((size, 1)))
        effect = sd_donors[:, None] * rng.standard_normal((size, 3, 1))
        sd = np.abs(0.5 * rng.standard_normal((size, 1, 1)))
        return mu, effect, sd_donors, sd

    def inside(mu, effect, sd):
        m = mu[:, GROUP, 0] + effect[:, DONOR, 0]
        share = ndtr((0.9 - m) / sd[:, 0]) - ndtr((-0.8 - m) / sd[:, 0])
        return share

    mu, effect, sd_donors, sd = spreads(4 * C)
    allowed = (inside(mu, effect, sd) >= 0.01).all(axis=1)
    mu, effect, sd_donors, sd = (
        np.ascontiguousarray(a[allowed]) for a in (mu, effect, sd_donors, sd)
    )
    prior = np.column_stack([np.log(sd_donors[:, 0]), np.log(sd[:, 0, 0]), mu[:, 0, 0] ** 2])
    mu, effect, sd_donors, sd = (a[:C].copy() for a in (mu, effect, sd_donors, sd))
    one, none = np.ones((C, 2, 1, 1)), np.zeros((C, 2, 0))
    seen = []
    for _ in range(60):
        m = mu[:, GROUP, 0] + effect[:, DONOR, 0]
        first = ndtr((-0.8 - m) / sd[:, 0])
        theta = m + sd[:, 0] * norm.ppf(first + inside(mu, effect, sd) * rng.random((C, n)))
        theta = np.clip(theta, -0.8, 0.9)[..., None]
        sds = np.concatenate([sd_donors[:, None], sd], axis=1)
        state = Block(theta, mu, effect, sds, none, one)
        update(rng, of, state, augment(rng, of, state))
        sd_donors, sd = sds[:, 0], sds[:, 1:]
        seen.append(
            np.column_stack([np.log(sd_donors[:, 0]), np.log(sd[:, 0, 0]), mu[:, 0, 0] ** 2])
        )
    result = np.mean(seen[10:], axis=0)  # one mean per chain, the chains independent
    error = np.sqrt(result.var(axis=0) / C + prior.var(axis=0) / len(prior))
    assert (np.abs(result.mean(axis=0) - prior.mean(axis=0)) < 4.0 * error).all()


def test_median_of_a_cut_normal():
    x = np.random.default_rng(2).normal(0.1, 0.2, 400_000)
    known = np.median(x[(x > 0.0) & (x < 0.3)])
    assert truncated_median(np.array([0.1]), np.array([0.2]), 0.0, 0.3)[0] == pytest.approx(
        known, abs=1e-3
    )
    assert truncated_median(np.array([0.1]), np.array([0.2]), -INF, INF)[0] == 0.1


# --- the whole sampler, on specimens whose likelihoods are normal --------------------------------


ERROR = 0.3
QUICK = {
    **{"ensembles": 4, "chains": 24, "rounds": 2, "round_sweeps": 20},
    **{"first_block": 160, "max_steps": 160},
}


def normal_design(
    prior_sd: float = 0.7, low: float = -INF, high: float = INF
) -> tuple[Design, np.ndarray]:
    rng = np.random.default_rng(8)
    y = np.array([0.2, 0.5, -0.4, -0.9, 0.6, -0.1])

    def individual(i: int) -> Individual:
        precision = 1 / ERROR**2 + 1 / prior_sd**2
        pool = y[i] / ERROR**2 / precision + rng.standard_normal((4, 1000, 1)) / precision**0.5
        return Individual(
            f"s{i}",
            lambda u: (-0.5 * ((u[:, 0] - y[i]) / ERROR) ** 2, u.copy()),
            lambda theta: -0.5 * (theta[:, 0] / prior_sd) ** 2,
            np.array([[-INF, INF]]),
            pool,
        )

    blocks = ((slice(0, 1), layout(low=low, high=high)),)
    return Design(tuple(individual(i) for i in range(6)), blocks, np.zeros(1)), y


def quantities(history):
    return [
        {
            "mean": history.mu[..., 0, 0],
            "sd_donors": history.sd_donors[..., 0],
            "sd_specimens": history.sd[..., 0, 0],
        }
    ]


def by_quadrature(y: np.ndarray) -> dict[str, tuple[float, float]]:
    """Posterior means and sds on a grid of both sds."""
    of = layout()
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


@pytest.fixture(scope="module")
def sampled():
    design, y = normal_design()
    return draw_population(design, PopulationPlan(ess=50, seed=3, **QUICK), quantities), y


@pytest.mark.long
def test_sampler_agrees_with_quadrature(sampled):
    result, y = sampled
    known = by_quadrature(y)
    convergence = result.convergence
    [drawn] = quantities(result.history)
    for name, ess in zip(convergence.names, convergence.ess_bulk, strict=True):
        mean, sd = known[name]
        assert abs(drawn[name].mean() - mean) < 4.0 * sd / math.sqrt(ess) + 0.002, name
        assert drawn[name].std() == pytest.approx(sd, rel=0.12), name


@pytest.mark.long
def test_dividing_out_the_runs_prior_matters(sampled):
    """A pool under another prior changes nothing; a prior not divided out would."""
    design, y = normal_design(prior_sd=0.3)
    result = draw_population(design, PopulationPlan(ess=50, seed=3, **QUICK), quantities)
    mean, sd = by_quadrature(y)["mean"]
    [drawn] = quantities(result.history)
    assert abs(drawn["mean"].mean() - mean) < 0.25 * sd


@pytest.mark.long
def test_one_seed_the_same_bytes_whatever_comes_between():
    design, _ = normal_design()
    quick = QUICK | {"first_block": 24, "max_steps": 60, "chains": 8}
    states = []
    whole = draw_population(
        design, PopulationPlan(ess=1e9, seed=5, **quick), quantities, on_block=states.append
    )
    other = draw_population(design, PopulationPlan(ess=1e9, seed=5, workers=3, **quick), quantities)
    assert len(states) >= 3 and states[-1].finished
    # continued after the warm-up, and after the first block
    for state in states[:2]:
        again = draw_population(
            design, PopulationPlan(ess=1e9, seed=5, **quick), quantities, state=state
        )
        for name, values in whole.history.arrays.items():
            assert values.tobytes() == again.history.arrays[name].tobytes(), name
            assert values.tobytes() == other.history.arrays[name].tobytes(), name
    another = draw_population(design, PopulationPlan(ess=1e9, seed=6, **quick), quantities)
    assert (another.history.mu != whole.history.mu).any()


def test_density_that_joint_moves_carry_on_is_that_of_where_they_ended():
    """Where a location is refused, the whole move is taken back, and its density with it."""
    design, _ = normal_design(low=-0.1, high=0.6)
    ensemble = Ensemble(design, 0, 32, np.random.SeedSequence(4))
    n = len(GROUP)
    middle = np.zeros((n, 1))
    tuning = Tuning((), (), 0.3 * np.ones((1, n, 1)), np.ones((3, 1)), middle, middle + 1.0)
    extra = ensemble.draw_rejected()
    carried = ensemble.log_marginal(ensemble.theta, extra)
    first = carried.copy()
    for _ in range(20):
        ensemble.move_together(tuning, extra, carried)
    assert carried == pytest.approx(ensemble.log_marginal(ensemble.theta, extra), rel=1e-12)
    moved = np.abs(carried - first) > 1e-9
    assert moved.sum() > 5 and ensemble.moves["together"][0, 0] < 20


@pytest.mark.parametrize("of", [GROUP, DONOR])
def test_specimens_are_drawn_apart_by_a_map_of_known_determinant(of):
    rng = np.random.default_rng(7)
    middle, sd = rng.standard_normal((6, 2)), 0.5 + rng.random((6, 2))
    tuning = Tuning((), (), np.zeros((0, 6, 2)), np.ones((3, 0)), middle, sd)
    direction = rng.standard_normal((6, 2))
    direction[4] = 0.0  # takes no part
    u, by = rng.standard_normal((1, 6, 2)), np.array([0.3])
    new, log_jacobian = scale_deviations(u, tuning, direction, of, by)
    assert scale_deviations(new, tuning, direction, of, -by)[0] == pytest.approx(u)
    unit = np.eye(12).reshape(12, 6, 2)
    columns = scale_deviations(u + unit, tuning, direction, of, np.repeat(by, 12))[0] - new
    sign, log_determinant = np.linalg.slogdet(columns.reshape(12, 12))
    assert sign > 0 and log_determinant == pytest.approx(log_jacobian[0])
    assert (new[0, 4] == u[0, 4]).all() and np.abs(new - u).max() > 0.05


def test_correlations_keep_their_prior():
    """Geweke's joint test of two values that correlate, donors and specimens."""
    rng = np.random.default_rng(6)
    of = layout(b=2, eta=2.0)
    C = 400

    def factors(partial):
        out = np.zeros((C, 2, 2))
        out[:, 0, 0], out[:, 1, 0] = 1.0, partial[:, 0]
        out[:, 1, 1] = np.sqrt(1.0 - partial[:, 0] ** 2)
        return out

    partial = 2.0 * rng.beta(2.0, 2.0, (C, 2, 1)) - 1.0
    factor = np.stack([factors(partial[:, j]) for j in (0, 1)], axis=1)
    sds = np.abs(0.5 * rng.standard_normal((C, 2, 2)))
    mu = of.mean_sd * rng.standard_normal((C, 2, 2))
    z = rng.standard_normal((C, 3, 2))
    effect = np.einsum("cij,cdj->cdi", factor[:, 0], z) * sds[:, :1]
    augmented = Augmented(np.zeros((C, 6)), np.zeros((C, 6, 2)), np.zeros((C, 1, 2, 2)))
    seen = []
    for _ in range(40):
        z = rng.standard_normal((C, 6, 2))
        theta = mu[:, GROUP] + effect[:, DONOR]
        theta = theta + np.einsum("cij,cnj->cni", factor[:, 1], z) * sds[:, 1:]
        update(rng, of, Block(theta, mu, effect, sds, partial, factor), augmented)
        seen.append(np.column_stack([partial[:, j, 0] ** k for j in (0, 1) for k in (1, 2)]))
    result = np.mean(seen[5:], axis=0)
    # (1 + c) / 2 ~ Beta(2, 2): mean of c 0, of its square 1/5
    error = result.std(axis=0) / math.sqrt(C)
    assert (np.abs(result.mean(axis=0) - [0.0, 0.2, 0.0, 0.2]) < 4.0 * error).all()
