"""One interval, verdict and reason a parameter: laws and priors take verdicts, never numbers."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.fitting.law_fits import CANDIDATE_LAWS, LawFit, LawFits
from biaxbayes.identifiability.identify import Identifiability, identify_draws, run_law_fits
from biaxbayes.identifiability.verdict import MEASURED, Assessment
from biaxbayes.model.draw import draw_posterior
from biaxbayes.runs.archive import draw_table
from biaxbayes.sampling.sampler import Plan

STRETCHES = ("mounting_stretch_x", "mounting_stretch_y")
TRUTH = {"C1": 8.0, "k1": 30.0, "k2": 6.0, "alpha": 40.0, "kappa": 0.1}
VERDICTS = {"identified", "bounded", "only in combination", "not identified"}


@pytest.fixture(scope="module")
def clean() -> Identifiability:
    """Three protocols of GOH, noise only, with default options."""
    specimen, _ = biaxbayes.simulate(
        material=biaxbayes.GOH(*TRUTH.values()), prestretch=(1.02, 1.03), total_stretch=1.2,
        ratios=[(1, 1), (1, 0.5), (0.5, 1)], increments=20, noise_N=0.001, edge=(20.0, 15.0),
        thickness=1.2, seed=3,
    )  # fmt: skip
    posterior = biaxbayes.prepare(specimen)
    result = draw_posterior(posterior, Plan(ess=300, max_steps=1500, ensembles=2, walkers=32))
    assert result.convergence.state == "converged"
    draws = draw_table(result.quantities)
    return identify_draws(posterior, draws, "converged", fits=run_law_fits(posterior))


def rows(result: Identifiability):
    return {row.name: row for row in result.reported}


def numbers(result: Identifiability):
    return {row.name: (row.low, row.median, row.high) for row in result.reported}


def with_fits(result: Identifiability, **rms_and_stretch) -> Identifiability:
    """The same draws where laws fit with this rms, over the noise, and these mounting stretches."""
    noise = 1.0
    fits = [
        LawFit(law.replace("_", "-"), rms * noise, rms * noise, np.array([stretch]), smooth, True)
        for law, (rms, stretch, smooth) in rms_and_stretch.items()
    ]
    ordered = tuple(sorted(fits, key=lambda f: f.rms))
    return replace(result, fits=LawFits(ordered, noise, 100.0))


def identified(result: Identifiability, *names: str) -> Identifiability:
    """The same diagnostics where parameters are identified."""
    parameters = tuple(
        replace(p, assessment=Assessment("identified", "the data determine it"))
        if p.name in names
        else p
        for p in result.parameters
    )
    return replace(result, parameters=parameters, fits=None)


def test_a_clean_record_identifies_and_holds_the_truth(clean):
    result = rows(clean)
    assert list(result) == [*TRUTH, *STRETCHES]
    assert {row.verdict for row in result.values()} <= VERDICTS
    truth = TRUTH | dict(zip(STRETCHES, (1.02, 1.03), strict=True))
    for name, row in result.items():
        assert row.reason and "\n" not in row.reason
        assert row.low < row.median < row.high
        assert bool(row.partners) == (row.verdict == "only in combination")
        assert row.low < truth[name] < row.high
    assert sum(row.verdict == "identified" for row in result.values()) >= 4


def test_ends_that_hold(clean):
    row = rows(identified(clean, "C1"))["C1"]
    for verdict, bound, ends in (
        ("identified", "", (row.low, row.high)),
        ("only in combination", "", (row.low, row.high)),
        ("bounded", "low", (row.low, math.nan)),
        ("bounded", "high", (math.nan, row.high)),
        ("not identified", "", (math.nan, math.nan)),
    ):
        np.testing.assert_equal(replace(row, verdict=verdict, bound=bound).ends, ends)


def near(clean: Identifiability, widths: float = 0.0) -> tuple[float, float]:
    """Mounting stretches at the medians, or x beyond an end by so many widths of its interval."""
    x, y = (clean[name].diagnostics for name in STRETCHES)
    by = abs(widths) * (x.high - x.low)
    return (x.median if not widths else x.high + by if widths > 0 else x.low - by), y.median


@pytest.mark.parametrize(
    ("widths", "verdict", "bound"),
    [
        (0.0, "identified", ""),
        (0.45, "identified", ""),
        (0.55, "bounded", "low"),
        (-0.45, "identified", ""),
        (-0.55, "not identified", ""),
    ],
)
def test_a_law_that_fits_as_well_and_contradicts_takes_a_verdict_away(
    clean, widths, verdict, bound
):
    sure = identified(clean, *STRETCHES)
    fits = {"goh": (1.0, near(clean), False), "fung": (1.1, near(clean, widths), False)}
    row = rows(with_fits(sure, **fits))["mounting_stretch_x"]
    assert (row.verdict, row.bound) == (verdict, bound)
    if verdict != "identified":
        assert "fung (" in row.reason and "contradicts it" in row.reason
    # the other direction, and every number, is what it was
    assert rows(with_fits(sure, **fits))["mounting_stretch_y"].verdict == "identified"
    assert numbers(with_fits(sure, **fits)) == numbers(clean)


@pytest.mark.parametrize(
    ("own", "rms", "widths", "verdict"),
    [
        (("identified", "the data determine it"), 1.2, -3.0, "identified"),  # it fits worse
        (("bounded", "the prior decides", "low"), 1.0, 3.0, "bounded"),
        (("bounded", "the prior decides", "low"), 1.0, -3.0, "not identified"),
    ],
)
def test_only_a_law_that_fits_as_well_contradicts_and_a_bound_from_below_alone(
    clean, own, rms, widths, verdict
):
    x = replace(clean["mounting_stretch_x"], assessment=Assessment(*own))
    parameters = tuple(x if p.name == x.name else p for p in clean.parameters)
    fits = {"goh": (1.0, near(clean), False), "fung": (rms, near(clean, widths), False)}
    assert rows(with_fits(replace(clean, parameters=parameters), **fits))[x.name].verdict == verdict


def test_a_law_that_another_beats_has_no_parameters_but_keeps_its_numbers(clean):
    sure = identified(clean, *TRUTH, *STRETCHES)
    fits = {"goh": (9.0, near(clean), True), "fung": (1.0, near(clean), False)}
    result = with_fits(sure, **fits)
    table = rows(result)
    assert all(table[name].verdict == "not identified" for name in TRUTH)
    assert all(table[name].verdict == "identified" for name in STRETCHES)
    assert table["C1"].reason == "fung describes the record better"
    assert result.better_law.endswith("better than goh: sample again with --law fung")
    assert numbers(result) == numbers(clean)


def test_a_law_that_is_far_from_the_record_without_its_misfit_has_no_parameters(clean):
    sure = identified(clean, *TRUTH, *STRETCHES)
    curves = {"protocol": ["1", "1", "2"], "unit": "N", "readings": [20, 20, 40]}

    def judged(*rms):
        """The load of protocol 1 is at most 1 N, whichever direction it has."""
        checks = pd.DataFrame({**curves, "rms": rms, "peak": [1.0, 0.5, 2.0]})
        return replace(sure, checks=checks)

    near, far = judged(0.06, 0.06, 0.14), judged(0.02, 0.06, 0.22)
    assert {row.verdict for row in near.reported} == {"identified"}
    assert {row.verdict for row in far.reported} == {"not identified"}
    # sqrt((0.02^2 + 0.06^2) / 4 + 0.11^2 / 2) = 0.084
    reason = "without its misfit GOH is off by 8 % of the peak"
    assert {row.reason for row in far.reported} == {reason}
    assert numbers(far) == numbers(clean)
    measured = Assessment("identified", MEASURED)
    known = [replace(p, assessment=measured) if p.name in STRETCHES else p for p in far.parameters]
    table = rows(replace(far, parameters=tuple(known)))
    assert [n for n, row in table.items() if row.verdict == "identified"] == list(STRETCHES)
    assert not replace(far, state="tentative").law_misses


def test_a_prior_that_contradicts_the_data_takes_all_of_the_law_away(clean):
    sure = replace(identified(clean, *TRUTH, *STRETCHES), contradicted_priors=("alpha",))
    table = rows(sure)
    assert {table[name].reason for name in TRUTH} == {"the prior of alpha contradicts the data"}
    assert {table[name].verdict for name in TRUTH} == {"not identified"}
    assert numbers(sure) == numbers(clean)


def test_the_laws_that_are_asked_are_a_list_that_is_written_down(clean):
    assert {f.law for f in clean.fits.fits} == set(CANDIDATE_LAWS)
