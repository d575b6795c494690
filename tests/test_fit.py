"""Deterministic fits: the paper's virtual experiments, Jacobians, hostile numerics, the command."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

import biaxbayes
from biaxbayes.errors import InputError, TaredSpecimen
from biaxbayes.figures.specimen import fits_figure
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.fit import METHODS, PRESTRETCH_METHODS, fit, fit_all
from biaxbayes.fitting.least_squares import descend
from biaxbayes.fitting.residuals import BalancedMounting, FreeMounting, LoadResiduals
from biaxbayes.laws.goh import GOH
from biaxbayes.laws.published import MATERIALS
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.specimens.rows import MeasuredRows
from biaxbayes.specimens.specimen import Protocol, Specimen
from biaxbayes.specimens.specimen_file import read_specimen, write_specimen
from commands import exit_code, refused, run
from goh_functions import (
    GOH_LAW,
    LOWER,
    UPPER,
    cauchy_stress,
    coordinates_of,
    material_at,
    stress_response,
)
from readable import assert_readable

PRESTRETCHES = (1.005, 1.02)
TRUTH = {"smoljkic-m55": "Table 3", "weisbecker-media": "Table 4"}


def values(material: GOH) -> np.ndarray:
    return np.array(material.values)


def constrained(specimen, mounting="noisy", **amount):
    return FitSetup.from_options(specimen, mounting).fitted(**amount)


def specimen_of(
    material: GOH,
    mounting=(1.01, 1.01),
    *,
    pair="force",
    geometry="unloaded",
    ratios=((1.0, 1.0),),
    mountings=None,
    **path,
) -> Specimen:
    """A noise-free specimen as a lab would write it, from the closed form."""
    path = path or {"total_stretch": 1.2}
    protocols = []
    for index, ratio in enumerate(ratios):
        lm = np.array(mountings[index] if mountings else mounting)
        test = virtual_test(
            material, mounting_stretch=tuple(lm), ratio=ratio, thickness_mm=1.35, **path
        )
        force = test.force_N
        # A lab's stress: force over the section it measured, at the state it measured it
        section = 20.0 * 1.35e-3 / (lm if geometry == "mounted" else np.ones(2))
        load = force if pair == "force" else force / section
        if pair == "cauchy":
            load = load * test.measured
        protocols.append(Protocol(f"p{index}", *test.measured.T, *load.T))
    lm = np.ones(2)
    if pair == "force" and geometry == "mounted":
        lm = np.array(mountings[0] if mountings else mounting)
    edges = {"edge_x_mm": 20.0 * lm[0], "edge_y_mm": 20.0 * lm[1], "thickness_mm": 1.35 / lm.prod()}
    return Specimen("virtual", tuple(protocols), pair, geometry, **edges)


def with_misfit(specimen: Specimen, relative_sd=0.02, noise=6e-4, seed=3) -> Specimen:
    rng = np.random.default_rng(seed)
    protocols = []
    for p in specimen.protocols:
        wave = np.sin(np.linspace(0, 9, p.rows)) * relative_sd
        x = p.load_x * (1 + wave) + noise * rng.standard_normal(p.rows)
        y = p.load_y * (1 - wave) + noise * rng.standard_normal(p.rows)
        protocols.append(replace(p, load_x=x, load_y=y))
    return replace(specimen, protocols=tuple(protocols), load_noise=noise)


MEDIA = MATERIALS["donor2-media"].material


# --- the paper's virtual experiments --------------------------------------------------------


@pytest.mark.parametrize("name", TRUTH)
@pytest.mark.parametrize("prestretch", PRESTRETCHES)
@pytest.mark.parametrize("method", PRESTRETCH_METHODS)
def test_prestretch_methods_return_the_truth_from_five_random_starts(name, prestretch, method):
    material = MATERIALS[name].material
    specimen = specimen_of(material, (prestretch, prestretch))
    for seed in range(5):
        result = fit(specimen, method, starts=1, seed=seed)
        assert result.converged
        np.testing.assert_allclose(values(result.material), values(material), rtol=5e-5)
        np.testing.assert_allclose(result.mounting_stretch, prestretch, atol=1e-6)


def test_optima_on_bounds_are_named():
    result = fit(specimen_of(MATERIALS["smoljkic-m55"].material, (1.02, 1.02)), "standard")
    assert result.at_bound == ("k2", "alpha", "kappa")
    assert result.material.alpha_deg == 90.0


# --- stress pairs, geometries, protocols ----------------------------------------------------


@pytest.mark.parametrize("pair", ["force", "piola", "cauchy"])
@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
@pytest.mark.parametrize("method", PRESTRETCH_METHODS)
def test_truth_from_every_stress_pair_and_geometry(pair, geometry, method):
    specimen = specimen_of(MEDIA, (1.02, 1.008), pair=pair, geometry=geometry)
    result = fit(specimen, method)
    assert result.converged
    np.testing.assert_allclose(values(result.material), values(MEDIA), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(result.mounting_stretch, [[1.02, 1.008]], rtol=1e-6)
    np.testing.assert_allclose(
        result.mounting_load, [specimen.mounting_reading(specimen.protocols[0])], rtol=1e-5
    )
    assert result.r2 == pytest.approx(1.0, abs=1e-9)
    assert max(np.abs(r).max() for r in result.residuals) < 1e-7 * specimen.peak_load
    assert result.residuals[0].shape == (100, 2)


@pytest.mark.parametrize("method", PRESTRETCH_METHODS)
def test_each_protocol_may_have_its_own_mounting_stretch(method):
    lms = [(1.01, 1.02), (1.015, 1.012), (1.03, 1.01)]
    specimen = specimen_of(MEDIA, ratios=[(1, 1), (1, 0.5), (0.5, 1)], mountings=lms)
    result = fit(specimen, method, mounting_stretch="per-protocol")
    np.testing.assert_allclose(result.mounting_stretch, lms, rtol=1e-5)
    np.testing.assert_allclose(values(result.material), values(MEDIA), rtol=1e-4, atol=1e-5)
    assert result.record()["mounting_stretch_x"] == pytest.approx([1.01, 1.015, 1.03], rel=1e-5)
    shared = specimen_of(MEDIA, (1.01, 1.02), ratios=[(1, 1), (1, 0.5)])
    result = fit(shared, method)
    np.testing.assert_allclose(result.mounting_stretch, [[1.01, 1.02]], rtol=1e-5)


def test_fibre_switch_is_part_of_the_model():
    material = GOH(10.0, 60.0, 5.0, 30.0, 0.05, fibre_switch=True)
    # Strong y stretch against fibres near x puts their strain below zero on part of the path
    specimen = specimen_of(
        material, (1.01, 1.01), ratios=[(-0.8, 1), (1, 1)], measured_stretch=1.15
    )
    on = fit(specimen, fibre_switch=True)
    off = fit(specimen, fibre_switch=False)
    np.testing.assert_allclose(values(on.material), values(material), rtol=1e-4)
    assert on.material.fibre_switch and off.rmse_kPa > 100 * on.rmse_kPa


# --- derivatives ----------------------------------------------------------------------------


@pytest.mark.parametrize("fibre_switch", [False, True])
def test_stress_response_against_complex_step(fibre_switch):
    rng = np.random.default_rng(0)
    stretch = rng.uniform(0.95, 1.3, (20, 2))
    for t, kappa in ((0.3, 0.1), (0.999, 0.0), (1e-6, 1 / 3), (0.5, 0.3)):
        point = np.array([5.0, 20.0, 8.0, t, kappa])
        got, by_point, by_log = stress_response(point, stretch, fibre_switch=fibre_switch)

        def stress(p, s):
            alpha = np.arccos(np.sqrt(p[3]))
            C1, k1, k2, _, kappa = p
            stress = cauchy_stress(C1, k1, k2, alpha, kappa, *s.T, fibre_switch=fibre_switch)
            return np.column_stack(stress)

        np.testing.assert_allclose(got, stress(point, stretch), rtol=1e-12)
        h = 1e-30
        for i in range(5):
            step = point.astype(complex)
            step[i] += 1j * h
            expected = stress(step, stretch).imag / h
            np.testing.assert_allclose(by_point[..., i], expected, rtol=1e-8, atol=1e-8)
        for i in range(2):
            step = stretch.astype(complex)
            step[:, i] *= 1 + 1j * h
            expected = stress(point, step).imag / h
            np.testing.assert_allclose(by_log[..., i], expected, rtol=1e-9, atol=1e-9)


def test_stress_response_is_regular_at_90_degrees():
    # In alpha the derivative vanishes there; in cos^2 alpha it does not.
    point = coordinates_of(GOH(5.0, 20.0, 8.0, 90.0, 0.1))
    assert point[3] == 0.0 and material_at(point).alpha_deg == 90.0
    stretch = np.array([[1.1, 1.2]])
    near = point.copy()
    near[3] = 1e-7
    stress, by_point, _ = stress_response(point, stretch)
    slope = (stress_response(near, stretch)[0] - stress) / 1e-7
    np.testing.assert_allclose(by_point[..., 3], slope, rtol=1e-4)


PAIRS = [("unloaded", "force"), ("mounted", "cauchy")]


@pytest.mark.parametrize(("geometry", "pair"), PAIRS)
@pytest.mark.parametrize("quantity", ["cauchy", "load"])
@pytest.mark.parametrize("kind", [LoadResiduals, FreeMounting, BalancedMounting, "noisy"])
def test_residual_jacobians_against_differences(geometry, pair, quantity, kind):
    lms = [(1.02, 1.008), (1.01, 1.03)]
    specimen = specimen_of(MEDIA, ratios=[(1, 1), (1, 0.6)], mountings=lms, pair=pair)
    specimen = with_misfit(replace(specimen, geometry=geometry), noise=1e-5)
    data = MeasuredRows.from_specimen(specimen, shared=False)
    free = np.array([0, 1, 2, 3, 4])
    point = coordinates_of(GOH(3.5, 11.0, 2.5, 42.0, 0.08))
    unknowns = point.copy()
    common = (data, quantity, point, free, data.peaks[0], np.array(lms), GOH_LAW)
    sd = np.full((2, 2), 1e-3 * data.peaks[0])
    if kind == "noisy":
        problem = BalancedMounting(*common, reading_sd=sd)
        unknowns = np.concatenate([unknowns, [0.3, -0.2, 0.1, 0.4]])
    else:
        problem = kind(*common)
        if kind is FreeMounting:
            unknowns = np.concatenate([unknowns, np.ravel(lms)])
    _, exact = problem.evaluate(unknowns)
    for i in range(unknowns.size):
        h = 1e-5 * max(abs(unknowns[i]), 0.1)
        up, down = unknowns.copy(), unknowns.copy()
        up[i] += h
        down[i] -= h
        difference = (problem.residual(up) - problem.residual(down)) / (2 * h)
        scale = np.abs(difference).max()
        np.testing.assert_allclose(exact[:, i], difference, atol=2e-7 * scale + 1e-9)


def test_descent_is_never_beaten_by_scipy_on_a_noisy_specimen():
    for seed, name in enumerate(("donor1", "donor2-adventitia", "weisbecker-media")):
        published = MATERIALS[name]
        specimen = with_misfit(
            specimen_of(published.material, (1.01, 1.015), measured_stretch=1.15), seed=seed
        )
        data = MeasuredRows.from_specimen(specimen, shared=True, mounting="zeroed")
        make = (data, "load", np.zeros(5), np.arange(5), data.peaks[0], np.ones((1, 2)), GOH_LAW)
        start = np.array([5.0, 5.0, 10.0, 0.4, 0.15])
        ours = descend(LoadResiduals(*make), start, LOWER, UPPER)
        problem = LoadResiduals(*make)

        def jacobian(x, problem=problem):
            with np.errstate(all="ignore"):
                return problem.evaluate(x)[1]

        tight = dict.fromkeys(("ftol", "xtol", "gtol"), 1e-14)
        theirs = least_squares(
            problem.residual, start, jacobian, bounds=(LOWER, UPPER), x_scale="jac", **tight
        )
        assert ours.converged
        assert ours.cost <= 2 * theirs.cost * (1 + 1e-8)


def test_what_is_called_converged_is_stationary():
    # A step that was cut to the box once passed for convergence, far from any minimum.
    rng = np.random.default_rng(11)
    specimen = specimen_of(MATERIALS["smoljkic-m55"].material, (1.02, 1.02))
    data = MeasuredRows.from_specimen(specimen, shared=True)
    problem = LoadResiduals(
        data, "cauchy", np.zeros(5), np.arange(5), 100.0, np.ones((1, 2)), GOH_LAW
    )
    ends = []
    for _ in range(40):
        start = rng.uniform([1, 1, 0, 0, 0], [100, 300, 50, 1, 1 / 3])
        end = descend(problem, start, LOWER, UPPER)
        ends.append(end.converged)
        if not end.converged:
            continue
        r, J = problem.evaluate(end.unknowns)
        gradient = J.T @ r
        cosine = gradient / np.maximum(np.linalg.norm(J, axis=0) * np.linalg.norm(r), 1e-300)
        inside = (end.unknowns > LOWER) & (end.unknowns < UPPER)
        assert np.all(np.abs(cosine[inside]) < 1e-4)
        assert np.all(gradient[end.unknowns <= LOWER] >= 0.0)
        assert np.all(gradient[end.unknowns >= UPPER] <= 0.0)
    assert np.mean(ends) > 0.9


# --- the start of the sampler ---------------------------------------------------------------


def test_fit_minimises_the_objective_of_independent_errors():
    specimen = with_misfit(specimen_of(MEDIA, (1.012, 1.02)))
    result = constrained(specimen)
    assert result.converged
    w = np.sqrt(np.mean(np.concatenate(result.residuals) ** 2))
    reading, sd = specimen.mounting_readings(shared=True)
    data = MeasuredRows.from_specimen(specimen, shared=True).loaded()

    def objective(theta, lm):
        material = GOH(*theta)
        p0 = np.array(material.piola(*lm)) * specimen.area
        model = np.column_stack(material.piola(*(data.stretch * lm).T)) * specimen.area
        return ((data.load - model) ** 2).sum() / w**2 + (((reading[0] - p0) / sd[0]) ** 2).sum()

    theta, lm = values(result.material), result.mounting_stretch[0]
    least = objective(theta, lm)
    rng = np.random.default_rng(1)
    for size in (1e-4, 1e-3, 1e-2):
        for _ in range(200):
            other = theta * (1 + size * rng.standard_normal(5))
            assert objective(other, lm * (1 + 0.1 * size * rng.standard_normal(2))) >= least - 1e-6


def test_noisy_tends_to_exact_as_the_load_cell_improves():
    specimen = with_misfit(specimen_of(MEDIA, (1.012, 1.02)))
    exact = constrained(specimen, "exact")
    gaps = []
    for noise in (6e-4, 6e-5, 6e-6):
        result = constrained(replace(specimen, load_noise=noise))
        gaps.append(np.abs(result.mounting_load - exact.mounting_load).max())
    assert gaps[0] > 10 * gaps[1] > 100 * gaps[2] > 0
    noise_free = constrained(replace(specimen, load_noise=0.0))
    assert values(noise_free.material) == pytest.approx(values(exact.material), rel=1e-12)


def test_ignored_and_zeroed_have_no_mounting_state():
    specimen = with_misfit(specimen_of(MEDIA, (1.012, 1.02)))
    for reading in ("ignored", "zeroed"):
        result = constrained(specimen, reading)
        assert np.all(result.mounting_stretch == 1.0)
        # What the model carries at a stretch of one is zero but for rounding.
        assert np.abs(result.mounting_load).max() < 1e-14
    ignored = constrained(specimen, "ignored")
    assert ignored.material.C1_kPa > constrained(specimen, "zeroed").material.C1_kPa


# --- fixed parameters ------------------------------------------------------------------------


FIXED = [{"kappa": 0.1}, {"alpha": 45.0}, {"C1": 3.0, "k2": 2.0}, {"k1": 10.0}, {"alpha": 90.0}]


@pytest.mark.parametrize(("method", "fixed"), list(zip(METHODS, FIXED, strict=True)))
def test_fixed_parameters_stay(method, fixed):
    specimen = with_misfit(specimen_of(MEDIA, (1.012, 1.02)))
    result = fit(specimen, method, fixed=fixed, starts=3)
    record = result.record()
    keys = {"C1": "C1_kPa", "k1": "k1_kPa", "alpha": "alpha_deg"}
    for name, value in fixed.items():
        assert record[keys.get(name, name)] == pytest.approx(value, abs=1e-10)
        assert name not in result.at_bound


def test_all_parameters_fixed_is_an_evaluation():
    fixed = {"C1": 2.98, "k1": 12.47, "k2": 1.88, "alpha": 39.0, "kappa": 0.0}
    result = fit(specimen_of(MEDIA, (1.009, 1.01)), fixed=fixed)
    np.testing.assert_allclose(result.mounting_stretch, [[1.009, 1.01]], rtol=1e-9)
    assert result.converged and result.iterations == 0


@pytest.mark.parametrize(
    "fixed", [{"c10": 1.0}, {"kappa": 0.4}, {"alpha": -1.0}, {"C1": float("nan")}]
)
def test_impossible_holds_are_refused(fixed):
    with pytest.raises(InputError, match=next(iter(fixed))):
        fit(specimen_of(MEDIA), fixed=fixed)


# --- hostile numerics -----------------------------------------------------------------------


def hostile(load_x, load_y, stretch=None) -> Specimen:
    load_x, load_y = np.asarray(load_x, float), np.asarray(load_y, float)
    stretch = np.linspace(1.0, 1.2, load_x.size) if stretch is None else np.asarray(stretch, float)
    return Specimen("hostile", (Protocol("1", stretch, stretch, load_x, load_y),), "piola")


HOSTILE = {
    "two rows": hostile([1.0, 30.0], [1.0, 25.0]),
    "compressive mounting force": hostile(np.linspace(-500, 50, 30), np.linspace(-500, 40, 30)),
    "mounting force beyond any stretch": hostile(np.linspace(1e5, 2e5, 30), np.zeros(30) + 1e-3),
    "falling load": hostile(np.linspace(40, 1, 30), np.linspace(30, 1, 30)),
    "huge loads": hostile(np.geomspace(1e6, 1e12, 30), np.geomspace(1e6, 1e12, 30)),
    "tiny loads": hostile(np.geomspace(1e-14, 1e-12, 30), np.geomspace(1e-14, 1e-12, 30)),
    "large stretch": hostile(
        np.geomspace(1, 1e3, 30), np.geomspace(1, 900, 30), np.linspace(1, 5, 30)
    ),
    "constant load": hostile(np.full(20, 5.0), np.full(20, 5.0)),
    "one axis only": hostile(np.linspace(1, 50, 20), np.zeros(20)),
    "noise": hostile(*np.random.default_rng(0).normal(0, 5, (2, 40)) + [[0.1], [0.1]]),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_specimens_end_in_a_result(name):
    specimen = HOSTILE[name]
    for method in METHODS:
        result = fit(specimen, method, starts=2)
        assert result.method == method
        json.dumps(result.record(), allow_nan=False)
        assert np.isfinite(values(result.material)).all()
        assert np.isfinite(result.mounting_stretch).all()
    for reading in ("noisy", "ignored", "zeroed"):
        result = constrained(specimen, reading, starts=2)
        assert np.isfinite(values(result.material)).all()


# Fixed at values this soft, no material carries 50 kPa within a mounting stretch of two.
SOFT = {"C1": 1.0, "k1": 1e-3, "k2": 0.0}
HEAVY = hostile(np.linspace(50, 90, 30), np.linspace(50, 80, 30))


def test_tared_specimen_allows_two_methods():
    tared = specimen_of(MEDIA, (1.01, 1.01)).zeroed()
    for method in PRESTRETCH_METHODS:
        with pytest.raises(TaredSpecimen, match="`mounting_force`"):
            fit(tared, method)
    assert [result.method for result in fit_all(tared)] == ["standard", "zeroed"]


# --- the command ----------------------------------------------------------------------------


@pytest.fixture
def media_file(tmp_path):
    path = tmp_path / "media.csv"
    write_specimen(with_misfit(specimen_of(MEDIA, (1.012, 1.02))), path)
    return path


def test_table_json_and_python_say_the_same_and_errors_are_those_of_the_method_paper(
    capsys, media_file, tmp_path
):
    truth, out = tmp_path / "truth.json", tmp_path / "fits"
    truth.write_text(json.dumps({"C1": 10.0, "k1": 100.0, "kappa": 0.0}))
    words = ("fit", media_file, "--truth", truth)
    assert run(capsys, *words, "--out", out)[0] == 0
    _, text, _ = run(capsys, *words, "--json")
    table, records = pd.read_csv(out / "fits.csv"), json.loads(text)
    assert [r["method"] for r in records] == list(METHODS) == list(table["method"])
    for row, record in zip(table.to_dict("records"), records, strict=True):
        # Eq. 8: the mean over the parameters that have a true value other than zero
        by_hand = (abs(record["C1_kPa"] / 10.0 - 1.0) + abs(record["k1_kPa"] / 100.0 - 1.0)) / 2
        assert record.pop("parameter_error") == pytest.approx(by_hand, rel=1e-12)
        assert row["parameter_error"] == pytest.approx(by_hand, rel=1e-6)
        assert row["mae_kPa"] == pytest.approx(record["mae_kPa"], rel=1e-6)
        assert 0.0 < record["mae_kPa"] <= record["rmse_kPa"]
    own = fit(read_specimen(media_file), "linden").record()
    assert {k: records[3][k] for k in own} == own


def test_a_law_that_does_not_describe_the_record_has_no_fit_to_report(capsys, media_file):
    words = ("--fix", "k1=1", "--fix", "C1=1", "--fix", "kappa=0.3")
    code, shown, warned = run(capsys, "fit", media_file, "--method", "constrained", *words)
    assert code == 0 and "do not use its parameters" in warned
    assert "Report constrained" not in shown and "has an interval" in shown


def test_the_figure_of_fits_shows_them_over_the_data(capsys, media_file, tmp_path):
    code, shown, _ = run(capsys, "fit", media_file, "--out", tmp_path, "--fix", "kappa=0")
    assert code == 0 and "Report constrained" in shown
    assert (tmp_path / "fits.pdf").read_bytes().startswith(b"%PDF")
    specimen = read_specimen(media_file)
    figure = fits_figure(specimen, fit_all(specimen))
    assert_readable(figure, 85.0)
    # A curve over the data is what the fit says of it: data less the residual.
    upper, lower = figure.axes[:2]
    drawn = upper.lines[1].get_ydata() + lower.lines[0].get_ydata()
    protocol = specimen.protocols[0]
    np.testing.assert_allclose(drawn, protocol.load_x[protocol.rest_rows :], rtol=1e-12)


def test_tared_file_on_the_command_line(capsys, tmp_path):
    path = tmp_path / "tared.csv"
    whole = specimen_of(MEDIA, (1.012, 1.02))
    write_specimen(whole.zeroed(), path)
    code, out, err = run(capsys, "fit", path, "--json")
    assert code == 0 and [r["method"] for r in json.loads(out)] == ["standard", "zeroed"]
    err = refused(capsys, "fit", path, "--method", "linden")
    assert "--mounting-force" in err
    force = whole.mounting_reading(whole.protocols[0])
    code, out, _ = run(
        capsys, "fit", path, "--method", "constrained", "--json", "--mounting-force", *force
    )
    assert code == 0
    assert json.loads(out)[0]["mounting_stretch_y"] == pytest.approx(1.02, abs=1e-6)


def test_exit_code_of_a_fit_that_did_not_converge(capsys, tmp_path):
    path = tmp_path / "heavy.csv"
    write_specimen(HEAVY, path)
    fixed = [word for name, value in SOFT.items() for word in ("--fix", f"{name}={value}")]
    code, out, err = run(capsys, "fit", path, "--method", "constrained", *fixed)
    assert code == 3 and "NO" in out and "not converged: constrained" in err
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize(
    "arguments",
    [("--fix", given) for given in ("kappa", "kappa=much", "kappa=0.5", "g=1")]
    + [("--mounting-force", "1", "1")],
)
def test_bad_options_end_with_one_line(capsys, media_file, arguments):
    refused(capsys, "fit", media_file, *arguments)


# --- records without noise: converged where only the rounding of the file is left ---

STIFF = ["16.1", "104.7", "10", "25.7", "0.017"]
STEEP = ["3.88", "17.08", "50", "5.47", "0.1833"]
TEST = ["--prestretch", "1.019", "1.02", "--total-stretch", "1.15", "--increments", "40"]


@pytest.mark.parametrize(
    "arguments",
    [
        ("--goh", *STIFF, *TEST),
        ("--goh", *STEEP, *TEST, "--loads", "cauchy"),
        ("--material", "donor2-intima"),
    ],
)
def test_what_is_simulated_without_noise_is_fitted_by_all_five(capsys, tmp_path, arguments):
    path = tmp_path / "virtual.csv"
    assert exit_code("simulate", *arguments, "--out", path) == 0
    capsys.readouterr()
    assert exit_code("fit", path) == 0
    shown = capsys.readouterr()
    assert "NO" not in shown.out and "not converged" not in shown.err
    assert "takes the mounted state as unloaded" in shown.out


def test_a_fit_of_a_tube_describes_no_mounting_force(capsys, tmp_path):
    path, of_tube = tmp_path / "tube.csv", ("unloaded_outer_diameter_mm=8", "--thickness", 0.9)
    test = ("--test", "tube", "--header", *of_tube, "--total-stretch", 1.28, "--axial-stretch", 1.1)
    assert exit_code("simulate", "--goh", 15, 40, 4, 40, 0.15, *test, "--out", path) == 0
    capsys.readouterr()
    assert exit_code("fit", path) == 0
    assert "mounting force" not in capsys.readouterr().out


def rounded(specimen, decimals: int):
    """The same record in a file of so many decimals."""

    def cut(p):
        curves = ("stretch_x", "stretch_y", "load_x", "load_y")
        return replace(p, **{name: np.round(getattr(p, name), decimals) for name in curves})

    return replace(specimen, protocols=tuple(map(cut, specimen.protocols)))


@pytest.mark.long
def test_few_digits_are_rounding_too():
    material = biaxbayes.GOH(*map(float, STIFF))
    specimen, _ = biaxbayes.simulate(
        material=material, prestretch=(1.019, 1.02), total_stretch=1.15, increments=40
    )
    for decimals in (8, 5):
        assert all(result.converged for result in fit_all(rounded(specimen, decimals)))


def test_a_fit_that_misses_more_than_the_digits_is_not_called_converged(monkeypatch, tmp_path):
    """The same file, the descent cut short: what is left is no rounding."""
    path = tmp_path / "virtual.csv"
    assert exit_code("simulate", "--goh", *STIFF, *TEST, "--out", path) == 0
    specimen = read_specimen(path)
    assert fit(specimen, "linden").converged

    def cut_short(*arguments, **options):
        return descend(*arguments, **{**options, "steps": 8})

    monkeypatch.setattr("biaxbayes.fitting.least_squares.descend", cut_short)
    assert not fit(specimen, "linden", starts=1).converged


def test_same_seed_same_fit():
    specimen = with_misfit(specimen_of(MEDIA, (1.012, 1.02)))
    for method in METHODS:
        assert fit(specimen, method, seed=4).record() == fit(specimen, method, seed=4).record()
