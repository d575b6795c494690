"""Designs against exact Gaussian answers, and against densities of further readings."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import trapezoid
from scipy.optimize import brentq

import commands
from biaxbayes.figures.simulations import design_figure
from biaxbayes.laws.goh import GOH
from biaxbayes.model.misfit import CurvePoints, Structure
from biaxbayes.model.posterior import Posterior
from biaxbayes.optimal_design.candidates import PIECE_MOUNTING, Reading, standard_candidates
from biaxbayes.optimal_design.design import design, expect
from biaxbayes.parameters import mounting_names
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.protocol import Protocol as MeasuredProtocol
from biaxbayes.verbs.design import print_design
from goh_functions import PARAMETERS
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
    result = expect(Reading("histology", ("alpha",), accuracy), draws, quantities)
    # var(q | y) = var(q) - cov(q, alpha)^2 / (var(alpha) + s^2)
    total = covariance[0, 0] + accuracy**2
    after = np.diag(covariance) - covariance[:, 0] ** 2 / total
    exact = 1.0 - np.sqrt(after / np.diag(covariance))
    # four standard errors of a variance and a correlation of 30,000 draws
    assert result.reduction == pytest.approx(exact, abs=4.0 / np.sqrt(30_000))
    # EIG = ln(1 + var(alpha) / s^2) / 2
    gain = 0.5 * np.log1p(covariance[0, 0] / accuracy**2)
    assert result.gain == pytest.approx(gain, abs=4.0 / np.sqrt(30_000))


def test_two_readings_agree_with_the_exact_gaussian_answer():
    draws, covariance = _gaussian()
    scaled = pd.DataFrame({"alpha": draws["alpha"], "kappa": 100.0 * draws["kappa"]})
    covariance = covariance * np.outer([1.0, 100.0], [1.0, 100.0])
    quantities = {n: scaled[n].to_numpy() for n in scaled}
    result = expect(Reading("both", ("alpha", "kappa"), 3.0), scaled, quantities)
    after = np.linalg.inv(np.linalg.inv(covariance) + np.eye(2) / 9.0)
    exact = 1.0 - np.sqrt(np.diag(after) / np.diag(covariance))
    assert result.reduction == pytest.approx(exact, abs=4.0 / np.sqrt(30_000))
    gain = 0.5 * np.log(np.linalg.det(np.eye(2) + covariance / 9.0))
    assert result.gain == pytest.approx(gain, abs=8.0 / np.sqrt(30_000))


@pytest.fixture(scope="module")
def run():
    data = specimen(MATERIAL, ratios=EQUIBIAXIAL, increments=15)
    return sampled(data, ess=200.0, walkers=Plan.walkers)  # many draws for what is drawn from them


@pytest.fixture(scope="module")
def candidates(run):
    return {c.name: c for c in standard_candidates(run.posterior(), run.draws)}


def test_readings_weigh_as_in_the_posterior_that_holds_them(run, candidates):
    """The distance of two draws in units of the errors, against a density of both protocols."""
    protocol, posterior = candidates["1:0.5"], run.posterior()
    earlier, _ = posterior.specimen.mounting_readings(shared=True)
    draws = run.draws.iloc[::1000].assign(noise_sd=0.002)
    # the outcome: what the draw with the nearest mounting load would read without errors, so that
    # the mounting readings are pooled without further scatter
    off = np.abs(draws[["mounting_force_x", "mounting_force_y"]] - earlier[0]).max(axis=1)
    first = int(np.argmin(off))
    outcome = protocol.expected(draws)[first]
    load = outcome.reshape(protocol.stretch.shape)
    further = MeasuredProtocol("next", *protocol.stretch.T, *load.T, rest_rows=1)
    protocols = (*posterior.specimen.protocols, further)
    joint = Posterior(replace(posterior.specimen, protocols=protocols), **posterior.options())
    gained = joint.log_density(draws) - posterior.log_density(draws)
    readings, noise = protocol.response(draws)
    square = (np.square(readings - readings[first]) / noise).sum(axis=1)
    assert gained - gained[first] == pytest.approx(-0.5 * square, rel=1e-6, abs=1e-4)


def test_a_further_protocol_is_mounted_as_one_of_those_before():
    data = specimen(MATERIAL, ratios=((1.0, 1.0), (1.0, 0.5)), increments=15)
    values = dict(zip(PARAMETERS, MATERIAL.values, strict=True))
    states = dict(zip([p.name for p in data.protocols], ((1.01, 1.02), (1.03, 1.04)), strict=True))

    def loads(mounting_stretch: str, **mounted: tuple[float, float]) -> np.ndarray:
        stretches = {
            name: value
            for state, pair in mounted.items()
            for name, value in zip(mounting_names("stretch", state), pair, strict=True)
        }
        draws = pd.DataFrame([values | stretches] * 200)
        posterior = Posterior(data, noise="independent", mounting_stretch=mounting_stretch)
        (protocol,) = [c for c in standard_candidates(posterior, draws) if c.name == "1:0"]
        return protocol.load(draws)

    own = loads("per-protocol", **states)
    of_states = [loads("shared", **{"": pair}) for pair in states.values()]
    is_of = np.array([np.isclose(own, one, rtol=1e-12).all(axis=(1, 2)) for one in of_states])
    assert (is_of.sum(axis=0) == 1).all() and is_of[0].sum() == 100
    np.testing.assert_array_equal(loads("per-protocol", **states), own)


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
    noise = np.r_[misfit.noise_sd, np.full(m, data.noise_sd)]
    assert protocol.weights.sum() == pytest.approx(1.0)
    whole = np.diag(noise**2) * (protocol.weights @ misfit.terms.noise**2)
    friction = (protocol.weights @ misfit.terms.friction**2) * misfit.points.friction_covariance(
        misfit.points
    )
    whole[:n, :n] += misfit.reading @ friction @ misfit.reading.T
    scale = points.toe_scale
    between = np.outer(scale, scale) * Structure(1.0, plane=True).matrix(points, points)
    between *= protocol.weights @ misfit.terms.toe**2
    for h, a, weight in zip(
        misfit.terms.structure, misfit.terms.amplitude, protocol.weights, strict=True
    ):
        if weight > 1e-9:
            between += weight * a**2 * misfit.structures[h].covariance(points, points)
    whole += reading @ between @ reading.T
    gain = np.linalg.solve(whole[:n, :n], whole[:n, n:])
    covariance = whole[n:, n:] - whole[n:, :n] @ gain
    mean = protocol.load(draws).reshape(2, -1)
    mean = mean + posterior.residuals(draws) @ gain
    readings, noise = protocol.response(draws)
    assert noise == pytest.approx(1.0)
    # squared distance of the two draws in units of the errors
    apart = mean[1] - mean[0]
    square = np.square(readings[1] - readings[0]).sum()
    assert square == pytest.approx(apart @ np.linalg.solve(covariance, apart), rel=1e-6)


def test_other_ratios_tell_more_than_a_repeat(run):
    """Equibiaxial stretch alone trades kappa with alpha: only another ratio settles it."""
    compared = ("1:0", "0:1", "1:0.5", "repeat 1:1")
    chosen = [c for c in standard_candidates(run.posterior(), run.draws) if c.name in compared]
    result = design(run.posterior(), run.draws, chosen, rank_by="kappa")
    names = [e.name for e in result.expected]
    rank = {name: i for i, name in enumerate(names)}
    assert rank["1:0"] < rank["repeat 1:1"]
    assert rank["0:1"] < rank["repeat 1:1"]
    assert len(rank) == len(compared)
    kappa = result.quantities.index("kappa")
    repeat = result.expected[rank["repeat 1:1"]]
    assert 0.0 <= repeat.reduction[kappa] < 0.3
    assert result.expected[rank["1:0"]].reduction[kappa] > 0.7
    table = result.to_frame()
    assert len(table) == len(chosen) * len(result.quantities)
    figure = design_figure(result)
    assert figure.get_figwidth() * 25.4 == pytest.approx(180.0)


def test_candidates_are_ranked_by_what_was_asked(run):
    angle, dispersion = Reading("angle", ("alpha",), 1e-6), Reading("dispersion", ("kappa",), 1e-4)
    for rank_by, first in (("kappa", "dispersion"), ("alpha", "angle"), ("information", "angle")):
        found = design(run.posterior(), run.draws, [dispersion, angle], rank_by=rank_by)
        assert found.expected[0].name == first, rank_by


def test_loads_beyond_what_was_tested_come_with_a_caution(run, capsys):
    """In the table, the figure and the terminal, in the same words."""
    p = run.posterior().specimen.protocols[0]
    end = 1.0 + 1.25 * (np.array([p.stretch_x.max(), p.stretch_y.max()]) - 1.0)
    further, repeat = f"1:1 to {' × '.join(f'{v:.3g}' for v in end)}", "repeat 1:1"
    every = standard_candidates(run.posterior(), run.draws)
    chosen = [c for c in every if c.name in (further, repeat, "1:0")]
    result = design(run.posterior(), run.draws, [*chosen, Reading("angle", ("alpha",), 5.0)])
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
    print_design(result)
    assert f"caution: {further} {words}" in capsys.readouterr().out


def test_a_design_ends_with_what_to_measure_next(run):
    result = design(run.posterior(), run.draws, [Reading("angle", ("alpha",), 0.1)])
    share = 100.0 * result.expected[0].reduction[result.quantities.index("alpha")]
    assert result.conclusion.startswith("measure next: angle")
    assert f"alpha by {share:.0f} %" in result.conclusion
    useless = design(run.posterior(), run.draws, [Reading("angle", ("alpha",), 1e4)])
    assert "no candidate narrows" in useless.conclusion


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
    assert found.expected[0].peak.unit == "N"


def test_rows_beyond_those_planned_average_the_noise_of_strips(run):
    """A planned row is the mean of several of a record, which has less noise; the first is not."""
    posterior, draws = run.target, run.draws
    pair = next(c for c in standard_candidates(posterior, draws) if c.name == "strips x and y")
    assert pair.repeats == 1.0
    one, many = (
        (root @ root.T).diagonal().reshape(-1, 2)
        for root in (pair._errors[1], replace(pair, repeats=4.0)._errors[1])
    )
    specimen = posterior.specimen
    # the noise of the square relative to its largest load
    noise = specimen.noise_sd / specimen.peak_load * pair.load(pair.median)[0].max(axis=0)
    np.testing.assert_allclose(one[1:] - many[1:], np.tile(0.75 * noise**2, (len(one) - 1, 1)))
    np.testing.assert_allclose(one[0], many[0])


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
    assert design(posterior, draws.iloc[::20], [tube]).expected[0].peak is None


@pytest.mark.long
def test_the_command_writes_into_the_run_or_where_it_is_told(small_copy, tmp_path, capsys):
    for folder, more in ((small_copy.path, ()), (tmp_path / "next", ("--out", tmp_path / "next"))):
        code, said, _ = commands.run(capsys, "design", small_copy.path, *more)
        assert code == 0 and str(folder / "design.csv") in said
        best = pd.read_csv(folder / "design.csv")["candidate"][0]
        assert f"measure next: {best}" in said and (folder / "design.pdf").exists()
