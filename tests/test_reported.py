"""One interval, verdict and reason a parameter; another law is advice."""

import math
from dataclasses import replace

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import load_text
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.fit_result import misfit_sentence
from biaxbayes.fitting.law_fits import (
    CANDIDATE_LAWS,
    LawFits,
    better_law,
    fit_laws,
    left_out_rms,
)
from biaxbayes.fitting.residuals import BalancedMounting
from biaxbayes.identifiability.identify import Identifiability, identify_draws, identify_run
from biaxbayes.identifiability.verdict import Assessment
from biaxbayes.laws import material
from biaxbayes.model.draw import draw_posterior
from biaxbayes.runs.archive import draw_table
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

STRETCHES = ("mounting_stretch_x", "mounting_stretch_y")
TRUTH = {"C1": 8.0, "k1": 30.0, "k2": 6.0, "alpha": 40.0, "kappa": 0.1}
VERDICTS = {"identified", "bounded", "only in combination", "not identified"}


@pytest.fixture(scope="module")
def draw():
    """Three protocols of GOH, noise only, with default options."""
    specimen, _ = biaxbayes.simulate(
        material=biaxbayes.GOH(*TRUTH.values()), prestretch=(1.02, 1.03), total_stretch=1.2,
        ratios=[(1, 1), (1, 0.5), (0.5, 1)], increments=20, noise_N=0.001, edge=(20.0, 15.0),
        thickness=1.2, seed=3,
    )  # fmt: skip
    posterior = biaxbayes.prepare(specimen)
    result = draw_posterior(posterior, Plan(ess=300, max_steps=1500, ensembles=2, walkers=32))
    assert result.convergence.state == "converged"
    return specimen, posterior, draw_table(result.quantities)


@pytest.fixture(scope="module")
def clean(draw) -> Identifiability:
    return identify_draws(*draw[1:], "converged")


def rows(result: Identifiability):
    return {row.name: row for row in result.reported}


def numbers(result: Identifiability):
    return {row.name: (row.low, row.median, row.high) for row in result.reported}


def identified(result: Identifiability, *names: str) -> Identifiability:
    """The same diagnostics where parameters are identified."""
    parameters = tuple(
        replace(p, assessment=Assessment("identified", "the data determine it"))
        if p.name in names
        else p
        for p in result.parameters
    )
    return replace(result, parameters=parameters)


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


@pytest.mark.parametrize(
    ("mean", "sd", "words"),
    [
        ("1.02", "0.0005", "1.02 \u00b1 0.0005 in the header"),
        ("1.02", "0.05", "1.02 \u00b1 0.05 in the header; the record narrows it"),
        ("1.15", "0.01", "1.15 \u00b1 0.01 in the header; the record moves it by"),
    ],
)
def test_a_stretch_that_the_header_gives_is_measured(draw, mean, sd, words):
    specimen, _, draws = draw
    header = specimen.metadata | {"mounting_stretch_x": f"{mean} +- {sd}"}
    known = biaxbayes.prepare(replace(specimen, metadata=header))
    # near the truth whatever the header says: 1.02, and its sd at most 0.0005
    rng = np.random.default_rng(1)
    x = rng.normal(1.02, min(float(sd), 0.0005), len(draws))
    table = rows(identify_draws(known, draws.assign(mounting_stretch_x=x), "converged"))
    row = table["mounting_stretch_x"]
    assert row.verdict == "measured" and row.reason.startswith(words)
    assert (row.low, row.high) == pytest.approx(np.quantile(x, [0.05, 0.95]))
    assert row.ends == (row.low, row.high)
    assert table["mounting_stretch_y"].verdict == "identified"


def test_a_fit_uses_a_stretch_that_the_header_gives(draw):
    specimen = draw[0]
    header = specimen.metadata | {"mounting_stretch_x": "1.03 +- 0.00001"}
    told = replace(specimen, metadata=header)
    free, fixed = (fit_laws(s, ("goh", "fung")) for s in (specimen, told))
    for law in ("goh", "fung"):
        assert abs(free[law].mounting_stretch[0, 0] - 1.03) > 2e-3
        assert fixed[law].mounting_stretch[0, 0] == pytest.approx(1.03, abs=2e-4)
        assert fixed[law].rms > free[law].rms


def test_the_slopes_of_a_fit_with_a_known_stretch_are_those_of_differences(draw):
    header = draw[0].metadata | {"mounting_stretch_x": "1.03 +- 0.01"}
    setup = FitSetup.from_options(replace(draw[0], metadata=header))
    problem = BalancedMounting(
        setup.data.loaded(), "load", setup.point, setup.free, setup.data.peaks,
        np.ones((1, 2)), setup.law, setup.data.mounting_sd,
    )  # fmt: skip
    at = np.append(setup.law.to_fit_coordinates(np.array(list(TRUTH.values()))), [0.1, -0.2])
    residual, slope = problem.evaluate(at)
    assert len(residual) == setup.data.loaded().load.size + 2 + 1
    for i in range(at.size):
        step = 1e-6 * max(abs(at[i]), 1.0) * np.eye(at.size)[i]
        apart = (problem.residual(at + step) - problem.residual(at - step)) / (2.0 * step[i])
        np.testing.assert_allclose(slope[:, i], apart, rtol=1e-4, atol=1e-5 * np.abs(apart).max())


def test_a_better_law_is_advice_and_takes_no_verdict_away(draw):
    _, posterior, draws = draw
    result = identify_run(posterior, draws, "converged")
    assert {f.law for f in result.fits.fits} == set(CANDIDATE_LAWS)
    assert result.better_law == ""  # GOH is right
    alone = identify_draws(posterior, draws, "converged")
    assert rows(result) == rows(alone)


def of_fung(ratios):
    """Fung tissue, which GOH misses by far more than the noise."""
    made, _ = virtual_specimen(
        material("fung", c0=2.0, c=5.0, b_x=4.0, b_y=9.0, b_xy=1.0),
        name="fung", mounting_stretch=(1.02, 1.02), total_stretch=1.3, ratios=ratios, increments=20,
        machine=Machine(noise_N=0.001), seed=3,
    )  # fmt: skip
    return made


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_share_of_the_largest_load_is_said_once(noise):
    text = misfit_sentence("GOH", 18.0, noise, 150.0, "kPa", share=True)
    assert text.startswith("GOH misses this record by 18 kPa (root mean square), 12 % of the ")
    assert text.count("%") == 1 and ("6 times the noise" in text) == (noise > 0.0)


def test_a_small_load_is_printed_in_millinewtons():
    loads = (0.00332, -0.0999, 0.332, 12.0)
    assert [load_text(v, "N") for v in loads] == ["3.3 mN", "-100 mN", "0.33 N", "12 N"]
    assert load_text(0.01, "kPa") == "0.01 kPa"


def test_a_law_is_better_where_it_predicts_a_protocol_left_out():
    several, one = (of_fung(r) for r in (((1, 1), (1, 0.5), (0.5, 1)), ((1, 1),)))
    fits = fit_laws(several, ("goh", "fung"))
    text = better_law(several, fits, "goh")
    assert text.startswith("another law, Fung, misses the record by")
    assert "they predict a protocol left out to" in text and "--law fung" in text
    # the other way round, and where a law fits as well, there is no such advice
    assert better_law(several, fits, "fung") == ""
    worse = replace(fits, fits=tuple(replace(f, rms=9.0) for f in fits.fits))
    assert better_law(several, worse, "goh") == ""
    # three quarters of the rms is the least that counts as better
    for share, better in ((0.72, True), (0.78, False)):
        near = replace(fits["fung"], rms=share * fits["goh"].rms)
        assert bool(better_law(several, replace(fits, fits=(near, fits["goh"])), "goh")) == better
    # left out, the law of the tissue predicts to its noise, 1 mN, and GOH does not
    assert left_out_rms(several, "fung") < 0.003 < left_out_rms(several, "goh")
    gap = LawFits((replace(fits["fung"], rms=0.001), replace(fits["goh"], rms=0.05)), 0.001, 1.0)
    assert "no further protocol shows which predicts better" in better_law(one, gap, "goh")


def test_a_prior_that_contradicts_the_data_takes_all_of_the_law_away(clean):
    sure = replace(identified(clean, *TRUTH, *STRETCHES), contradicted_priors=("alpha",))
    table = rows(sure)
    assert {table[name].reason for name in TRUTH} == {"the prior of alpha contradicts the data"}
    assert {table[name].verdict for name in TRUTH} == {"not identified"}
    assert numbers(sure) == numbers(clean)
