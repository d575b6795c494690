"""The reported table: one interval or bound, one verdict, one reason for every parameter."""

import math
from dataclasses import replace

import numpy as np
import pytest

import biaxbayes
from biaxbayes.fitting.law_fits import LawFit, LawFits
from biaxbayes.identifiability.identify import Identifiability, identify_draws, run_law_fits
from biaxbayes.model.draw import draw_posterior
from biaxbayes.runs.archive import draw_table
from biaxbayes.sampling.sampler import Plan

STRETCHES = ("mounting_stretch_x", "mounting_stretch_y")
TRUTH = {"C1": 8.0, "k1": 30.0, "k2": 6.0, "alpha": 40.0, "kappa": 0.1}
VERDICTS = {"identified", "bounded", "only in combination", "not identified"}


@pytest.fixture(scope="module")
def clean() -> Identifiability:
    """Three protocols of GOH, noise only."""
    specimen, _ = biaxbayes.simulate(
        material=biaxbayes.GOH(*TRUTH.values()),
        prestretch=(1.02, 1.03),
        total_stretch=1.2,
        ratios=[(1, 1), (1, 0.5), (0.5, 1)],
        increments=30,
        noise_N=0.001,
        edge=(20.0, 15.0),
        thickness=1.2,
        seed=3,
    )
    posterior = biaxbayes.prepare(specimen)
    result = draw_posterior(posterior, Plan(ess=300, max_steps=1500, ensembles=2, walkers=32))
    draws = draw_table(result.quantities)
    return identify_draws(posterior, draws, "converged", fits=run_law_fits(posterior))


def rows(result: Identifiability):
    return {row.name: row for row in result.reported}


def with_fit(result: Identifiability, **changes) -> Identifiability:
    """The same diagnostics where the run's own law fits in another way."""
    assert result.fits is not None
    fits = tuple(replace(f, **changes) if f.law == "goh" else f for f in result.fits.fits)
    return replace(result, fits=replace(result.fits, fits=fits))


def test_a_clean_record_identifies_and_holds_the_truth(clean):
    result = rows(clean)
    assert list(result) == [*TRUTH, *STRETCHES]
    assert {row.verdict for row in result.values()} <= VERDICTS
    truth = TRUTH | dict(zip(STRETCHES, (1.02, 1.03), strict=True))
    for name, row in result.items():
        assert row.reason and "\n" not in row.reason
        if row.verdict == "identified":
            assert row.low < row.high and not row.partners
        if row.verdict == "only in combination":
            assert row.partners
        assert not truth[name] < row.low and not truth[name] > row.high
    assert sum(row.verdict == "identified" for row in result.values()) >= 4
    assert all(result[name].verdict == "identified" for name in STRETCHES)


def test_an_interval_is_widened_about_its_median_where_the_law_misses(clean):
    plain = rows(with_fit(clean, widening={}))["C1"]
    row = rows(with_fit(clean, widening={"C1": 1.5}, discrepancy_sd=0.021))["C1"]
    diagnostics = clean["C1"].diagnostics
    assert plain.verdict == row.verdict == "identified"
    assert plain.low == pytest.approx(diagnostics.low) and plain.high == pytest.approx(
        diagnostics.high
    )
    # C1 is compared in logs
    assert math.log(row.high / diagnostics.median) == pytest.approx(
        1.5 * math.log(plain.high / diagnostics.median)
    )
    assert row.reason.startswith("widened 1.5 times for the model error of GOH")


def test_what_the_misfit_leaves_open_is_not_identified(clean):
    row = rows(with_fit(clean, widening={"C1": 400.0}, discrepancy_sd=0.2))["C1"]
    assert row.verdict == "not identified" and math.isnan(row.low) and math.isnan(row.high)
    assert "the model error of GOH" in row.reason
    # as wide as that, the dispersion is bounded or open, never a value
    kappa = rows(with_fit(clean, widening={"kappa": 20.0}))["kappa"]
    assert kappa.verdict != "identified"


def test_what_trades_with_an_unknown_parameter_needs_a_sharp_interval(clean):
    """A factor of 3.2 is a value beside a known partner, not where that may be anywhere."""
    diagnostics = clean["k1"].diagnostics
    traded = replace(diagnostics.partners, names=("kappa",), spread_given_partners=0.2)
    ends = {"low": diagnostics.median / 1.8, "high": diagnostics.median * 1.8}
    wide = replace(diagnostics, partners=traded, **ends)
    parameters = tuple(
        replace(p, diagnostics=wide) if p.name == "k1" else p for p in clean.parameters
    )
    loose = replace(clean, parameters=parameters)
    assert rows(with_fit(loose, widening={}))["k1"].verdict == "identified"
    row = rows(with_fit(loose, widening={"kappa": 40.0}))["k1"]
    assert row.verdict == "only in combination" and row.partners == ("kappa",)


def test_a_value_spans_no_order_of_magnitude(clean):
    diagnostics = clean["k1"].diagnostics
    alone = replace(diagnostics.partners, spread_given_partners=1.0)
    ends = {"low": diagnostics.median / 20.0, "high": diagnostics.median * 20.0}
    wide = replace(diagnostics, partners=alone, **ends)
    parameters = tuple(
        replace(p, diagnostics=wide, posterior_verdict="identified") if p.name == "k1" else p
        for p in clean.parameters
    )
    row = rows(replace(clean, parameters=parameters, fits=None))["k1"]
    assert row.verdict == "not identified" and "a factor of 4e+02" in row.reason


def test_a_law_that_another_beats_has_no_parameters(clean):
    fits = clean.fits.fits
    worse = LawFits(
        tuple(replace(f, rms=9.0, rmse_kPa=9.0) if f.law == "goh" else f for f in fits)[::-1],
        clean.fits.noise,
        clean.fits.peak,
    )
    ordered = replace(worse, fits=tuple(sorted(worse.fits, key=lambda f: f.rms)))
    result = rows(replace(clean, fits=ordered))
    assert all(result[name].verdict == "not identified" for name in TRUTH)
    assert "fits better than goh" in result["C1"].reason and " and 9 kPa" in result["C1"].reason


def test_draws_that_have_not_converged_identify_nothing(clean):
    parameters = tuple(replace(p, posterior_verdict="no verdict") for p in clean.parameters)
    result = replace(clean, parameters=parameters, state="tentative")
    assert {(r.verdict, r.reason) for r in result.reported} == {
        ("no verdict", "chains have not converged")
    }


def test_stretches_are_those_of_the_laws_that_fit(clean):
    """Whatever the posterior says, an end that another law moves is moved in the one row."""
    for name in STRETCHES:
        interval, row = clean[name].mounting, rows(clean)[name]
        np.testing.assert_equal((row.low, row.high), (interval.low, interval.high))
        assert row.low <= clean[name].diagnostics.low and row.high >= clean[name].diagnostics.high


def test_a_law_fit_without_errors_widens_nothing():
    fit = LawFit("goh", 1.0, 1.0, np.full((1, 2), 1.02), np.full((1, 2), 0.001), False, True)
    assert fit.widening == {} and fit.mounting_widening is None
