"""What is reported of the mounting stretch of the tissue, by fits of all laws."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import biaxbayes
from biaxbayes.fitting.law_fits import (
    CLOSE_RMS,
    LawFit,
    LawFits,
    better_law_message,
    fit_law,
    fit_laws,
    quick_better_law,
)
from biaxbayes.identifiability.identify import mounting_intervals
from biaxbayes.identifiability.mounting_interval import MountingInterval, interval_from_laws
from biaxbayes.laws import material
from quick_posteriors import small_specimen

NAMES = ("mounting_stretch_x", "mounting_stretch_y")


def law_fit(law="goh", rms=1.0, stretch=1.02, sd=0.001, smooth=False) -> LawFit:
    pair = np.full((1, 2), stretch)
    return LawFit(law, rms, rms, pair, np.full((1, 2), sd), smooth, True)


def state(*fits: LawFit, noise: float = 1.0, interval=(1.018, 1.022), measured: bool = False):
    """What is reported of both directions where these laws were fitted."""
    posterior = SimpleNamespace(
        mounts=("",),
        law=SimpleNamespace(name="goh"),
        specimen=SimpleNamespace(metadata=dict.fromkeys(NAMES, "1.02") if measured else {}),
    )
    result = LawFits(tuple(sorted(fits, key=lambda f: f.rms)), noise, 100.0)
    low, high = interval
    diagnostics = SimpleNamespace(
        low=low, median=0.5 * (low + high), high=high, by_prior=(False, False)
    )
    out = mounting_intervals(posterior, result, dict.fromkeys(NAMES, diagnostics))
    assert out[NAMES[0]] == out[NAMES[1]] or np.isnan(out[NAMES[0]].high)
    return out[NAMES[0]]


def test_laws_that_agree_state_a_value():
    result = state(law_fit(), law_fit("fung", 1.1, 1.021), law_fit("hgo", 9.0, 1.3))
    assert result.is_value and "goh and fung" in result.reason
    # own errors of every law, and of their strains what a further law may add
    assert result.low == pytest.approx(1.02 - 1.645 * 0.001 - 0.09 * 0.020)
    assert result.high == pytest.approx(1.021 + 1.645 * 0.001 + 0.09 * 0.021)
    # the interval within the run's own law counts where that law describes the record
    wider = state(law_fit(), law_fit("fung", 1.1, 1.021), interval=(1.01, 1.03))
    assert (wider.low, wider.high) == (1.01, 1.03)
    other = state(law_fit(rms=3.0), law_fit("fung"), law_fit("hgo"), interval=(1.01, 1.03))
    assert other.low > 1.01 and other.high < 1.03


def test_laws_that_differ_state_the_low_end_alone():
    result = state(law_fit(), law_fit("fung", 1.1, 1.09), law_fit("hgo", 9.0, 0.9))
    assert result.low == pytest.approx(1.02 - 1.645 * 0.001 - 0.09 * 0.02) and np.isnan(result.high)
    assert "at most 0.035 (goh and fung)" in result.reason and not result.is_value
    # a law without the low end of the others, but as good, moves it
    lower = state(law_fit(), law_fit("fung", 1.1, 1.0, 0.01))
    assert lower.low == pytest.approx(1.0 - 1.645 * 0.01)


def test_a_low_end_is_that_of_two_laws_at_least():
    """One law that describes the record alone tells nothing of how far laws differ."""
    best = law_fit("fung", 1.0, 1.2, 0.02)
    alone = state(best, law_fit("goh", 5.0, 1.15), law_fit("hgo", 6.0, 1.05))
    assert alone.low == pytest.approx(1.15 - 1.645 * 0.001 - 0.09 * 0.15)
    assert "at most 0.035 (fung and goh)" in alone.reason
    far = state(best, law_fit("goh", 5.0, 0.8))
    assert np.isnan(far.low) and "below the best estimate (fung and goh)" in far.reason


def test_a_wide_interval_is_no_value():
    alone = state(law_fit("fung"), law_fit("goh", 5.0))
    assert alone.is_value and alone.reason == "the laws that fit best agree (fung and goh)"
    wide = state(law_fit("fung", sd=0.02), law_fit("goh", 5.0))
    assert not wide.is_value and "at most 0.035 (fung and goh)" in wide.reason
    lost = state(law_fit(), law_fit("fung", 1.1, 1.3, 1.5))
    assert np.isnan(lost.low) and np.isnan(lost.high) and "below the best estimate" in lost.reason


def test_a_law_is_not_thrown_out_by_a_reading_two_sigma_off():
    """Two sds of the mounting reading, and a fifth more misfit that counts for few readings."""
    fung = replace(law_fit("fung", 1.2, 1.03), reading_chi2=4.0)
    few, many = (replace(law_fit(), n_effective=n) for n in (4.0, 200.0))
    assert [f.law for f in LawFits((few, fung), 0.1, 100.0).fitting] == ["goh", "fung"]
    assert [f.law for f in LawFits((many, fung), 0.1, 100.0).fitting] == ["goh"]
    # the interval of a law that fits is never cut by the others
    result = LawFits((few, fung), 0.1, 100.0)
    low, high = 1.005, 1.032
    interval = interval_from_laws(result, 0, 0, "goh", (low, high))
    assert interval.low <= low and interval.high >= high


def test_a_law_that_does_not_fit_does_not_count_between_two_that_do():
    """The second misses the loads less than the third, but it misses the mounting reading."""
    between = replace(law_fit("fung", 1.2, 1.2), reading_chi2=50.0)
    best = replace(law_fit(), n_effective=4.0)
    result = LawFits((best, between, law_fit("hgo", 1.25, 1.021)), 0.1, 100.0)
    assert [f.law for f in result.compared] == ["goh", "hgo"]
    interval = interval_from_laws(result, 0, 0, "goh", (1.018, 1.022))
    assert interval.is_value and interval.high < 1.03


def test_the_interval_of_the_run_is_widened_by_its_smooth_misfit():
    own = replace(law_fit(), mounting_widening=np.full((1, 2), 2.0))
    result = state(own, law_fit("fung", 1.1, 1.02), interval=(1.015, 1.025))
    assert (result.low, result.high) == (pytest.approx(1.01), pytest.approx(1.03))


def test_an_end_that_the_prior_decides_is_open():
    result = LawFits((law_fit(), law_fit("fung", 1.1, 1.021)), 1.0, 100.0)

    def interval_of(interval: tuple[float, float], by_prior: tuple[bool, bool]) -> MountingInterval:
        return interval_from_laws(result, 0, 0, "goh", interval, by_prior=by_prior)

    low = interval_of((1.010, 1.022), (True, False))
    assert np.isnan(low.low) and low.reason == "the prior determines the lower end"
    high = interval_of((1.019, 1.030), (False, True))
    assert np.isfinite(high.low) and np.isnan(high.high)
    assert high.reason == "the prior determines the upper end"
    assert interval_of((1.010, 1.030), (True, True)).reason == "the prior determines both ends"
    # ends of the laws are the data's
    assert interval_of((1.019, 1.022), (True, True)).is_value


def test_a_measured_mounting_stretch_is_reported_as_it_is():
    result = state(law_fit(), law_fit("fung", 1.0, 1.3), measured=True)
    assert (result.low, result.high) == (1.018, 1.022) and "measured" in result.reason


def test_statements_are_weaker_with_a_worse_load_cell():
    """The same fits with the noise doubled: never a value from none, never a narrower range."""
    rng = np.random.default_rng(7)
    strength = {True: 2, False: 1}
    for _ in range(200):
        fits = [
            law_fit(
                f"law {k}",
                rms=float(np.exp(rng.normal(0.0, 0.5))),
                stretch=1.02 + 0.01 * float(rng.standard_normal()),
                sd=0.003 * float(rng.random()),
                smooth=bool(rng.random() < 0.3),
            )
            for k in range(4)
        ]
        better, worse = (state(*fits, noise=noise) for noise in (0.7, 1.4))
        assert strength[worse.is_value] <= strength[better.is_value]
        if np.isfinite(worse.low) and np.isfinite(better.low) and better.is_value == worse.is_value:
            assert worse.low <= better.low
        if worse.is_value:
            assert worse.high >= better.high


def test_a_better_law_is_named_only_where_it_is_distinctly_better():
    goh, fung = law_fit("goh", 4.0), law_fit("fung", 2.4)
    output = better_law_message(LawFits((fung, goh), 0.1, 100.0), "goh")
    assert output.startswith("fung fits better than goh (root mean square error 2.4 and 4 kPa)")
    assert not better_law_message(LawFits((replace(fung, rms=3.5), goh), 0.1, 100.0), "goh")
    # a difference below the noise counts where it rests on many independent readings, and where
    # the other law fits without a smooth misfit
    assert better_law_message(LawFits((fung, goh), 2.0, 100.0), "goh")
    smooth, few = replace(fung, smooth=True), replace(fung, n_effective=3.0)
    for best in (smooth, few):
        assert not better_law_message(LawFits((best, goh), 2.0, 100.0), "goh")
    assert not better_law_message(LawFits((goh, replace(fung, rms=5.0)), 0.1, 100.0), "goh")


def test_the_error_of_a_mounting_stretch_is_that_of_repeated_specimens():
    """Its sd against the scatter of fits to specimens with other noise, the mounting's included."""
    made = small_specimen()
    rng = np.random.default_rng(5)
    result, sds = [], []
    for _ in range(24):
        protocols = []
        for p in made.protocols:
            noise = 0.002 * rng.standard_normal((2, p.rows))
            protocols.append(replace(p, load_x=p.load_x + noise[0], load_y=p.load_y + noise[1]))
        fit = fit_law(replace(made, protocols=tuple(protocols), load_noise=None), "goh")
        result.append(fit.mounting_stretch[0])
        sds.append(fit.sd[0])
    # of 24 specimens a sd is known to 15 %; a smooth misfit that is not excluded adds to it
    ratio = np.std(result, axis=0, ddof=1) / np.median(sds, axis=0)
    assert np.all((ratio > 0.45) & (ratio < 1.4)), ratio


def test_laws_are_fitted_to_a_goh_specimen():
    result = fit_laws(small_specimen(), ("goh", "hgo", "fung"), rows=20, starts=2)
    assert result is not None
    assert result.fits[0].law == "goh" and not result.fits[0].smooth
    assert result.fitting[0].law == "goh"
    assert all(f.rms <= CLOSE_RMS * max(result.fits[0].rms, result.noise) for f in result.fitting)
    table = result.to_frame()
    assert list(table["law"]) == [f.law for f in result.fits]
    assert table["mounting_stretch_x"][0] == result.fits[0].mounting_stretch[0, 0]
    assert quick_better_law(small_specimen()) == ""


@pytest.mark.long
def test_no_end_is_wrong_where_the_mounting_reading_is_two_sigma_off():
    """Fung tissue, noise of 1 % of the peak: its law had been thrown out by a reading."""
    values = {"c0_kPa": 6.0, "c_kPa": 5.0, "b_x": 9.0, "b_y": 5.0, "b_xy": 2.5}
    specimen, _ = biaxbayes.simulate(
        material=material("fung", **values),
        prestretch=(1.02, 1.03),
        total_stretch=1.25,
        ratios=[(1, 1), (1, 0.5), (0.5, 1)],
        increments=30,
        noise_N=0.018,
        edge=(20.0, 15.0),
        thickness=1.2,
        seed=10,
    )
    result = fit_laws(specimen)
    assert result is not None and "fung" in [f.law for f in result.fitting]
    for axis, true in enumerate((1.02, 1.03)):
        interval = interval_from_laws(result, 0, axis)
        assert np.isfinite(interval.low)
        assert not interval.low > true and not interval.high < true
