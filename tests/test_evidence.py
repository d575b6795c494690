"""Log evidence against integrals that are known, computed by quadrature or by a nested sampler."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

import biaxbayes
from analytic_targets import TARGETS, gaussian
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.marginal_likelihood import (
    log_prior_mass,
    marginal_likelihood,
    marginal_likelihood_record,
)
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.sampling.bridge import bridge
from biaxbayes.sampling.proposal import fit_transported_mixture
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen_file import read_specimen
from quick_posteriors import runs_without_figures

DATA = Path(__file__).parents[1] / "data"
PLAN = Plan(ess=2000, workers=2, population=2048, walkers=32)


def media():
    return read_specimen(DATA / "donor2-media.csv")


def bridged(target, seed, *, draws=(4, 100, 20), constant=0.0):
    """Diagnostics of an analytic target, its density multiplied by exp(constant)."""
    rng = np.random.default_rng(seed)
    q = fit_transported_mixture(target.sample(rng, 2000), rng, bounds=target.bounds)
    x, y = target.sample(rng, int(np.prod(draws))), q.sample(rng, 5000)
    at_y = target.log_density(y)
    inside = np.isfinite(at_y)
    ratio = np.full(len(y), -np.inf)
    ratio[inside] = at_y[inside] + constant - q.log_density(y[inside])
    return bridge((target.log_density(x) + constant - q.log_density(x)).reshape(draws), ratio)


@pytest.mark.parametrize(
    "target",
    [pytest.param(t, marks=[pytest.mark.long] * (t.dimension > 6), id=t.name) for t in TARGETS],
)
def test_normalised_targets_have_no_log_evidence(target):
    value, error = bridged(target, 3)
    assert abs(value) < 4.5 * error
    assert 0.0 < error < 0.1


def test_a_constant_comes_back_and_errors_are_honest():
    results = np.array(
        [bridged(gaussian(6), s, draws=(4, 20, 20), constant=-712.5) for s in range(60)]
    )
    z = (results[:, 0] + 712.5) / results[:, 1]
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3  # sixty draws: 1 +- 0.09
    assert np.abs(z).max() < 4.5


def test_correlated_draws_widen_the_error():
    target = gaussian(6)
    rng = np.random.default_rng(4)
    q = fit_transported_mixture(target.sample(rng, 2000), rng)
    x, y = target.sample(rng, 4 * 50 * 10), q.sample(rng, 500)
    first = (target.log_density(x) - q.log_density(x)).reshape(4, 50, 10)
    second = target.log_density(y) - q.log_density(y)
    _, error = bridge(first, second)
    _, repeated = bridge(np.repeat(first, 8, axis=1), second)
    # eight times the rows, the same information
    assert repeated == pytest.approx(error, rel=0.03)
    # also of a proposal that is hardly off the target: ln N(x; 0, 1) - ln N(x; 0.1, 1)
    near, many = (
        0.005 - 0.1 * x[:, 0].reshape(4, 50, 10),
        0.005 - 0.1 * rng.normal(0.1, 1.0, 20_000),
    )
    _, error = bridge(near, many)
    _, repeated = bridge(np.repeat(near, 8, axis=1), many)
    assert repeated == pytest.approx(error, rel=0.03)
    # and a wrong normaliser of the proposal is seen at once
    value, error = bridge(first + 0.2, second + 0.2)
    assert value == pytest.approx(0.2, abs=5 * error)


def by_quadrature(posterior, grids):
    """Trapezoidal integral of exp(log_density) over natural parameters on regular grids."""
    names = list(posterior.free)
    mesh = np.meshgrid(*(grids[n] for n in names), indexing="ij")
    logs = posterior.log_density(dict(zip(names, mesh, strict=True)))
    for axis, name in enumerate(names):
        x = grids[name]
        scaled = np.deg2rad(x) if name == "alpha" else np.log(x) if name != "kappa" else x
        weights = np.gradient(scaled)
        weights[[0, -1]] *= 0.5 if name == "kappa" else 1.0
        shape = [1] * len(names)
        shape[axis] = -1
        logs = logs + np.log(weights).reshape(shape)
    return logsumexp(logs)


@pytest.mark.parametrize("mounting", ["exact", pytest.param("ignored", marks=pytest.mark.long)])
def test_two_parameters_against_quadrature(mounting):
    fixed = {"k1": 12.0, "k2": 2.0, "kappa": 0.05, "noise_sd": 0.02}
    posterior = Posterior(media(), mounting=mounting, noise="independent", priors=fixed)
    result = marginal_likelihood(posterior, draw_posterior(posterior, PLAN))
    grids = {"C1": np.geomspace(0.02, 60, 600), "alpha": np.linspace(0.01, 89.99, 300)}
    expected = by_quadrature(posterior, grids)
    assert result.error < 0.05
    assert result.log_evidence == pytest.approx(expected, abs=4.5 * result.error + 1e-3)


@pytest.mark.long
def test_dispersion_and_angle_in_their_chart_against_quadrature():
    """The chart's Jacobian, its bounds and the prior per radian all count here."""
    fixed = {"C1": 3.0, "k2": 2.0, "noise_sd": 0.05}
    posterior = Posterior(media(), mounting="exact", noise="independent", priors=fixed)
    result = marginal_likelihood(posterior, draw_posterior(posterior, PLAN))
    grids = {
        "k1": np.geomspace(4, 60, 160),
        "alpha": np.linspace(0.05, 89.95, 240),
        "kappa": np.linspace(0, 1 / 3, 161),
    }
    expected = by_quadrature(posterior, grids)
    assert result.log_evidence == pytest.approx(expected, abs=4.5 * result.error + 0.01)


@pytest.mark.long
def test_the_prior_of_coupled_parameters_is_normalised():
    """The exponents of Fung's law with b_x b_y > b_xy^2: b_xy is normal, cut at sqrt(b_x b_y)."""
    fixed = {"c0": 3.0, "b_x": 9.0, "b_y": 25.0, "noise_sd": 0.05}
    posterior = Posterior(
        media(), law="fung", mounting="ignored", noise="independent", priors=fixed
    )
    result = marginal_likelihood(posterior, draw_posterior(posterior, PLAN))
    b_xy = np.linspace(-15.0, 15.0, 2001)[1:-1]
    c = np.geomspace(0.01, 100.0, 1500)
    mesh = dict(zip(("c", "b_xy"), np.meshgrid(c, b_xy, indexing="ij"), strict=True))
    logs = posterior.log_density(mesh) + np.log(np.gradient(np.log(c)))[:, None]
    inside = norm.cdf(15.0, 0.0, 30.0) - norm.cdf(-15.0, 0.0, 30.0)
    expected = logsumexp(logs + np.log(b_xy[1] - b_xy[0])) - np.log(inside)
    assert result.log_evidence == pytest.approx(expected, abs=4.5 * result.error + 1e-3)
    # all three uncertain, by plain draws of the priors
    whole = Posterior(media(), law="fung", noise="independent")
    rng = np.random.default_rng(3)
    x, y, xy = (whole.priors[name].sample(rng, 400_000) for name in ("b_x", "b_y", "b_xy"))
    assert log_prior_mass(whole) == pytest.approx(np.log(np.mean(xy**2 < x * y)), abs=0.01)
    assert log_prior_mass(Posterior(media(), noise="independent")) == 0.0


def test_a_likelihood_with_a_misfit_has_none():
    posterior = prepare(media())
    with pytest.raises(ValueError, match="misfit"):
        marginal_likelihood(posterior, None)
    record = marginal_likelihood_record(posterior, None, 1)
    assert record["log_evidence"] is None and "misfit" in record["reason"]
    averaged = Posterior(media(), noise="independent", max_rows=20)
    assert "averaged" in marginal_likelihood_record(averaged, None, 1)["reason"]


@pytest.mark.long
def test_a_run_records_it_and_prestretch_can_be_judged(tmp_path):
    """The specimen was mounted at a stretch: without one, its mounting force is a wonder."""
    result = {}
    for mounting in ("noisy", "free", "ignored"):
        with runs_without_figures():
            run = biaxbayes.sample(
                media(), out=tmp_path / mounting, mounting=mounting, noise="independent", ess=1000
            )
        record = json.loads((run.path / "provenance.json").read_text())
        result[mounting] = record["marginal_likelihood"]
    noisy, free, ignored = result["noisy"], result["free"], result["ignored"]
    error = np.hypot(noisy["error"], free["error"])
    assert abs(noisy["log_evidence"] - free["log_evidence"]) < 4.5 * error
    assert noisy["log_density_of_mounting_reading"] is None
    reading, sd = media().mounting_readings(shared=True)
    expected = norm.logpdf(reading, 0.0, sd).sum()
    assert ignored["log_density_of_mounting_reading"] == pytest.approx(expected, rel=1e-9)
    without = ignored["log_evidence"] + ignored["log_density_of_mounting_reading"]
    assert noisy["log_evidence"] > without + 10
