"""Designs against exact Gaussian answers, and against sampling again."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import trapezoid
from scipy.optimize import brentq
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from biaxbayes.figures.simulations import design_figure
from biaxbayes.identifiability.determined import largest_equibiaxial
from biaxbayes.laws.goh import GOH
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.misfit import AMPLITUDES, NOISE_FACTORS, CurvePoints
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import with_sampling_constants
from biaxbayes.optimal_design.candidates import PIECE_MOUNTING, Reading, standard_candidates
from biaxbayes.optimal_design.design import design
from biaxbayes.optimal_design.information_gain import (
    OutcomePosterior,
    design_quantities,
    expect,
    weighted_sd,
)
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.protocol import Protocol as MeasuredProtocol
from biaxbayes.verbs.design import print_design
from quick_posteriors import EQUIBIAXIAL, sampled, specimen
from readable import in_view

MATERIAL = GOH(15.0, 60.0, 8.0, 42.0, 0.1)


def _gaussian(sd_alpha=6.0, sd_kappa=0.05, correlation=-0.8, n=30_000):
    covariance = np.array([[sd_alpha**2, 0.0], [0.0, sd_kappa**2]])
    covariance[0, 1] = covariance[1, 0] = correlation * sd_alpha * sd_kappa
    values = np.random.default_rng(4).multivariate_normal([45.0, 0.15], covariance, n)
    return pd.DataFrame(values, columns=["alpha", "kappa"]), covariance


@pytest.mark.parametrize("accuracy", [2.0, 6.0, 20.0])
def test_histology_agrees_with_the_exact_gaussian_answer(accuracy):
    draws, covariance = _gaussian()
    quantities = {n: draws[n].to_numpy() for n in draws}
    reading = Reading("histology", ("alpha",), accuracy)
    result = expect(reading, draws, quantities, np.random.default_rng(1), outcomes=400)
    # var(q | y) = var(q) - cov(q, alpha)^2 / (var(alpha) + s^2)
    total = covariance[0, 0] + accuracy**2
    after = np.diag(covariance) - covariance[:, 0] ** 2 / total
    exact = 1.0 - np.sqrt(after / np.diag(covariance))
    assert np.all(np.abs(result.reduction - exact) < 4.0 * result.error + 0.005)
    assert result.error.max() < 0.02
    assert result.at_least == pytest.approx(exact, abs=0.01)
    # EIG = ln(1 + var(alpha) / s^2) / 2
    gain = 0.5 * np.log1p(covariance[0, 0] / accuracy**2)
    assert abs(result.gain - gain) < 4.0 * result.gain_error
    assert result.gain_error < 0.1


def test_two_readings_agree_with_the_exact_gaussian_answer():
    draws, covariance = _gaussian()
    scaled = pd.DataFrame({"alpha": draws["alpha"], "kappa": 100.0 * draws["kappa"]})
    covariance = covariance * np.outer([1.0, 100.0], [1.0, 100.0])
    reading = Reading("both", ("alpha", "kappa"), 3.0)
    quantities = {n: scaled[n].to_numpy() for n in scaled}
    result = expect(reading, scaled, quantities, np.random.default_rng(2), outcomes=400)
    after = np.linalg.inv(np.linalg.inv(covariance) + np.eye(2) / 9.0)
    exact = 1.0 - np.sqrt(np.diag(after) / np.diag(covariance))
    assert np.all(np.abs(result.reduction - exact) < 4.0 * result.error + 0.005)


@pytest.fixture(scope="module")
def run():
    data = specimen(MATERIAL, ratios=EQUIBIAXIAL, increments=15)
    return sampled(data, ess=200.0, walkers=Plan.walkers)  # many draws for what is drawn from them


def _stretch(run):
    return largest_equibiaxial(run.draws, run.target.specimen)


@pytest.fixture(scope="module")
def precise(run):
    """A fibre angle known far better than before: hardly a draw of the run has weight."""
    posterior = with_sampling_constants(run.posterior())
    candidate = Reading("precise", ("alpha",), 5e-4 * run.draws["alpha"].std())
    names = tuple(design_quantities(posterior, run.draws))
    return posterior, OutcomePosterior(posterior, candidate, run.draws, names, _stretch(run))


def test_new_draws_agree_with_sampling_at_a_known_angle(run, precise):
    """Against the sampler with the angle fixed."""
    posterior, after = precise
    angle = float(np.quantile(run.draws["alpha"], 0.3))
    log_weight = after.candidate.log_likelihood(np.array([[angle]]), run.draws)[0]
    result = after.after(np.array([angle]), log_weight, np.random.default_rng(1))
    assert result.effective > 400
    fixed = Posterior(posterior.specimen, **{**posterior.options(), "priors": {"alpha": angle}})
    chains = draw_posterior(fixed, Plan(ess=1500.0, seed=3, walkers=32)).quantities
    table = pd.DataFrame({name: q.ravel() for name, q in chains.items()})
    exact = design_quantities(fixed, table, after.stretch)
    shared = [n for n in exact if n in after.quantities]
    assert {"C1", "k1", "k2", "kappa", "mounting_stretch_x"} <= set(shared)
    for name in shared:
        ratio = result.sd[after.quantities.index(name)] / exact[name].std()
        # sds of a thousand draws each, and tails heavier than a Gaussian's
        assert abs(ratio - 1.0) < 4.0 * np.sqrt(1.0 / 1600 + 1.0 / 3000) * 1.5, name
    # log Z of a normal reading is the log of the angle's density times the normal's volume
    alpha = run.draws["alpha"]
    near = np.abs(alpha - angle) < 0.25 * alpha.std()
    log_density = np.log(near.mean() / (0.5 * alpha.std()))
    expected = log_density + np.log(after.candidate.sd * np.sqrt(2.0 * np.pi))
    assert result.log_evidence == pytest.approx(expected, abs=0.25)


def test_new_draws_agree_with_reweighting_where_both_do(run):
    """Outcomes of an accuracy that leaves hundreds of draws: spreads, and the mean likelihood."""
    posterior = with_sampling_constants(run.posterior())
    candidate = Reading("angle", ("alpha",), 0.3 * run.draws["alpha"].std())
    quantities = design_quantities(posterior, run.draws)
    values = np.column_stack(list(quantities.values()))
    after = OutcomePosterior(posterior, candidate, run.draws, tuple(quantities), _stretch(run))
    rng = np.random.default_rng(2)
    simulated = candidate.outcomes(run.draws.iloc[::2000], rng)
    weights = candidate.log_likelihood(simulated, run.draws)
    spread, effective = weighted_sd(weights, values)
    # an outcome far out leaves few draws to reweight
    usable = np.flatnonzero(effective > 300)
    assert len(usable) > 0.8 * len(simulated)
    for j, outcome in [(j, simulated[j]) for j in usable]:
        result = after.after(outcome, weights[j], rng)
        np.testing.assert_allclose(result.sd, spread[j], rtol=0.25)
        known = logsumexp(weights[j]) - np.log(len(run.draws))
        assert result.log_evidence == pytest.approx(known, abs=0.2)


@pytest.mark.long
def test_a_precise_reading_is_gone_into(run, precise):
    """With the posterior at hand its numbers are trusted, and the angle's own is exact."""
    posterior, after = precise
    quantities = design_quantities(posterior, run.draws)
    alone = expect(after.candidate, run.draws, quantities, np.random.default_rng(3), outcomes=20)
    assert not alone.trusted
    rng = np.random.default_rng(3)
    result = expect(after.candidate, run.draws, quantities, rng, outcomes=20, posterior=posterior)
    assert result.trusted
    assert result.effective > 400
    i = list(quantities).index("alpha")
    assert result.reduction[i] == pytest.approx(1.0 - 5e-4, abs=1e-4)
    assert result.at_least[i] <= result.reduction[i] + 0.01


@pytest.fixture(scope="module")
def candidates(run):
    return {c.name: c for c in standard_candidates(run.posterior(), run.draws)}


def test_protocol_likelihood_is_a_normal_density(run, candidates):
    protocol = candidates["1:0.5"]
    draws = run.draws.iloc[[3, 500, 900]]
    outcomes = protocol.outcomes(draws, np.random.default_rng(5))
    result = protocol.log_likelihood(outcomes, draws)
    load = protocol.load(draws)
    sd = np.ones_like(load) * draws["noise_sd"].to_numpy()[:, None, None]
    sd[:, 0] = protocol.posterior.specimen.noise_sd
    exact = np.column_stack(
        [
            multivariate_normal.logpdf(outcomes, mean.ravel(), np.diag(s.ravel() ** 2))
            for mean, s in zip(load, sd, strict=True)
        ]
    )
    # Up to a term common to all draws: differences between draws are what counts.
    assert result - result[:, :1] == pytest.approx(exact - exact[:, :1], abs=1e-4)


def test_an_outcome_weighs_as_in_the_posterior_that_holds_it(run, candidates):
    protocol, posterior = candidates["1:0.5"], run.posterior()
    draws = run.draws.iloc[::1000]
    outcome = protocol.outcomes(draws.iloc[:1], np.random.default_rng(5))
    earlier, sd = posterior.specimen.mounting_readings(shared=True)
    # within the noise of the earlier one: the two are pooled without further scatter
    outcome[0, :2] = earlier[0] + 0.3 * sd[0]
    load = outcome.reshape(protocol.stretch.shape)
    further = MeasuredProtocol("next", *protocol.stretch.T, *load.T, rest_rows=1)
    protocols = (*posterior.specimen.protocols, further)
    joint = Posterior(replace(posterior.specimen, protocols=protocols), **posterior.options())
    gained = joint.log_density(draws) - posterior.log_density(draws)
    result = protocol.log_likelihood(outcome, draws)[0]
    assert result - result[0] == pytest.approx(gained - gained[0], abs=1e-4)


@pytest.mark.parametrize("name", ["1:0", "repeat 1:1"])
def test_readings_of_a_protocol_have_the_misfit_of_the_run(name):
    """Against the joint covariance of the run's readings and the new ones, given the former."""
    data = specimen(MATERIAL, ratios=((1.0, 1.0), (1.0, 0.5)), increments=15)
    posterior = Posterior(data)
    values = {"C1": 15.0, "k1": 61.0, "k2": 8.0, "alpha": 42.0, "kappa": 0.1}
    values |= {"mounting_stretch_x": 1.01, "mounting_stretch_y": 1.02}
    draws = pd.DataFrame([values, values | {"C1": 16.0}])
    (protocol,) = [c for c in standard_candidates(posterior, draws) if c.name == name]
    misfit, at = posterior.misfit, posterior.paths.path(protocol.stretch)
    assert set(at.protocol) == ({0} if name.startswith("repeat") else {-1})
    points, n, m = CurvePoints.joined([misfit.points, at]), len(misfit.noise_sd), len(at.path)
    reading = np.zeros((n + m, len(points.path)))
    reading[:n, : len(misfit.points.path)] = misfit.reading
    reading[n:, len(misfit.points.path) :] = np.eye(m)
    factors = np.array([NOISE_FACTORS[component.noise] for component in misfit.components])
    noise = np.r_[misfit.noise_sd, np.full(m, data.noise_sd)]
    whole = np.diag(noise**2) * (protocol.weights.sum(axis=1) @ factors**2)
    toe = misfit.toe_covariance(points, points)
    whole += reading @ toe @ reading.T
    for component, weights in zip(misfit.components, protocol.weights, strict=True):
        between = (weights @ AMPLITUDES**2) * component.structure.covariance(points, points)
        whole += reading @ between @ reading.T
    gain = np.linalg.solve(whole[:n, :n], whole[:n, n:])
    covariance = whole[n:, n:] - whole[n:, :n] @ gain
    mean = protocol.load(draws).reshape(2, -1)
    mean = mean + posterior.residuals(draws) @ gain
    outcomes = protocol.outcomes(draws, np.random.default_rng(5))
    exact = np.column_stack([multivariate_normal.logpdf(outcomes, f, covariance) for f in mean])
    result = protocol.log_likelihood(outcomes, draws)
    assert result - result[:, :1] == pytest.approx(exact - exact[:, :1], abs=1e-4)


@pytest.mark.long
def test_other_ratios_tell_more_than_a_repeat(run):
    """Equibiaxial stretch alone trades kappa with alpha: only another ratio settles it."""
    compared = ("1:0", "0:1", "1:0.5", "repeat 1:1")
    chosen = [c for c in standard_candidates(run.posterior(), run.draws) if c.name in compared]
    result = design(run.posterior(), run.draws, chosen, rank_by="kappa", outcomes=30)
    names = [e.name for e in result.expected]
    rank = {name: i for i, name in enumerate(names)}
    assert rank["1:0"] < rank["repeat 1:1"]
    assert rank["0:1"] < rank["repeat 1:1"]
    assert len(rank) == len(compared)
    kappa = result.quantities.index("kappa")
    repeat = result.expected[rank["repeat 1:1"]]
    assert 0.0 <= repeat.at_least[kappa] < 0.3
    table = result.to_frame()
    assert len(table) == len(chosen) * len(result.quantities)
    figure = design_figure(result)
    assert figure.get_figwidth() * 25.4 == pytest.approx(180.0)


def test_loads_beyond_what_was_tested_come_with_a_caution(run, capsys):
    """In the table, the figure and the terminal, in the same words."""
    p = run.posterior().specimen.protocols[0]
    end = 1.0 + 1.25 * (np.array([p.stretch_x.max(), p.stretch_y.max()]) - 1.0)
    further, repeat = f"1:1 to {' × '.join(f'{v:.3g}' for v in end)}", "repeat 1:1"
    every = standard_candidates(run.posterior(), run.draws)
    chosen = [c for c in every if c.name in (further, repeat, "1:0")]
    result = design(
        run.posterior(), run.draws, [*chosen, Reading("angle", ("alpha",), 5.0)], outcomes=4
    )
    tested = run.posterior().specimen.peak_load
    assert list(result.cautions()) == [further]
    words = result.cautions()[further]
    assert f"{tested:.3g} N" in words
    table = result.to_frame().groupby("candidate")[["peak_load_q95", "caution"]].first()
    assert table.loc[further, "caution"] == words
    assert table.loc[further, "peak_load_q95"] > 1.2 * tested > table.loc[repeat, "peak_load_q95"]
    assert (table.drop(index=further)["caution"] == "").all()
    drawn = " ".join(text for text, _ in in_view(design_figure(result)))
    assert " ".join(words.split()) in " ".join(drawn.split())
    print_design(result, "N")
    assert f"caution: {further} {words}" in capsys.readouterr().out


def test_a_design_ends_with_what_to_measure_next(run):
    result = design(run.posterior(), run.draws, [Reading("angle", ("alpha",), 0.1)], outcomes=20)
    share = 100.0 * result.expected[0].reduction[result.quantities.index("alpha")]
    assert result.conclusion.startswith("measure next: angle")
    assert f"alpha by {share:.0f} %" in result.conclusion
    useless = design(run.posterior(), run.draws, [Reading("angle", ("alpha",), 1e4)], outcomes=20)
    assert "no candidate narrows" in useless.conclusion
    doubtful = replace(result, expected=(replace(result.expected[0], untrusted=1.0),))
    assert "no candidate can be recommended" in doubtful.conclusion


def test_strips_are_those_of_a_virtual_test_and_their_unknowns_are_errors(run):
    posterior, draws = run.target, run.draws
    pair = next(c for c in standard_candidates(posterior, draws) if c.name == "strips x and y")
    one = draws.iloc[[7]]
    load = pair.load(one)[0]
    values = {name: float(one[name].iloc[0]) for name in posterior.law.names}
    material = posterior.law.material_at(tuple(values[name] for name in posterior.law.names))
    area, along = posterior.specimen.area, 1.0 + PIECE_MOUNTING[0]
    for k in (0, 1):
        total = along * pair.stretch[-1, k]

        def across(y, k=k, total=total):
            return float(material.cauchy(*((total, y) if k == 0 else (y, total)))[1 - k])

        width = brentq(across, 0.5, 1.2)
        s = float(material.cauchy(*((total, width) if k == 0 else (width, total)))[k])
        assert load[-1, k] == pytest.approx(area[k] * s / total, rel=1e-9)
    # a stiffness that may be off by 10 % and the mounting stretch move the end of the curve
    root = pair._errors[1]
    sd = np.sqrt((root @ root.T).diagonal())[-2:]
    assert np.all(sd > posterior.settings.piece_sd * 0.8 * np.abs(pair.load(pair.median)[0, -1]))
    found = design(posterior, draws, [pair, *standard_candidates(posterior, draws)[:1]])
    assert found.expected[0].name == "strips x and y"
    assert found.peaks[0].unit == "N"


def test_a_planned_tube_has_the_pressure_of_its_wall(run):
    posterior, draws = run.target, run.draws
    tube = next(c for c in standard_candidates(posterior, draws) if c.name.startswith("tube"))
    one = draws.iloc[[7]]
    values = [float(one[name].iloc[0]) for name in posterior.law.names]
    around, along = tube.stretch[-1]
    # a wall of 1 and an outer radius of 5: (ro^2 - r^2) lz = B^2 - R^2
    outer = 5.0 * around
    r = np.linspace(np.sqrt(outer**2 - 9.0 / along), outer, 2001)
    stress, _ = posterior.law.material_at(tuple(values)).cauchy(
        r / np.sqrt(25.0 - (outer**2 - r**2) * along), np.full(r.size, along)
    )
    assert tube.load(one)[0, -1, 0] == pytest.approx(trapezoid(stress / r, r), rel=1e-4)
    assert design(posterior, draws.iloc[::20], [tube], outcomes=10).peaks == (None,)
