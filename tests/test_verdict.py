"""Verdicts and their reasons, decided by diagnostics that are written down."""

from dataclasses import replace

import pytest

from biaxbayes.identifiability.marginals import ComparisonScale, RangeEnd
from biaxbayes.identifiability.partners import Partners
from biaxbayes.identifiability.verdict import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    MEASURED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    Diagnostics,
    Thresholds,
    assess_material,
    assess_parameters,
    assess_stretch,
)
from biaxbayes.model.priors import Prior, Tie
from biaxbayes.parameters import MOUNTING_PARAMETERS, Quantity
from goh_functions import GOH_LAW

KAPPA, K1, ALPHA = (GOH_LAW.parameter(name) for name in ("kappa", "k1", "alpha"))
STRETCH = next(p for p in MOUNTING_PARAMETERS if p.name == "mounting_stretch_x")
LOOSE = Diagnostics(
    parameter=KAPPA, median=0.15, low=0.05, high=0.25, prior_sd=0.1, posterior_sd=0.04,
    prior_excluded=0.6, ends=(), partners=Partners((), 1.0, 1.0), modes=1,
    prior_sensitivity=0.0, likelihood_sensitivity=0.5,
)  # fmt: skip
SHARP = replace(LOOSE, low=0.10, high=0.19)
WIDE = replace(LOOSE, low=0.04)  # wider than twice a sharp interval
TRADED = Partners(("k1", "alpha"), 0.3, 0.4)
T = Thresholds()
FLAT = Prior("uniform", low=0.0, high=1.0)


def scale(parameter) -> ComparisonScale:
    return ComparisonScale(Quantity(parameter), FLAT)


def assess(diagnostics, parameter=KAPPA, weak=(), undefined=""):
    return assess_material(diagnostics, scale(parameter), T, set(weak), undefined)


def range_end(
    side: int, kind: str = "physical", support: float = 0.5, value: float = 0.0
) -> RangeEnd:
    return RangeEnd(side, value, kind, 0.01, 0.05, 0.03, support)


LOW, HIGH = range_end(0), range_end(1, value=1 / 3)


@pytest.mark.parametrize(
    ("diagnostics", "verdict"),
    [
        (LOOSE, IDENTIFIED),
        (SHARP, IDENTIFIED),
        # the variance must shrink by 75 %: to half the prior's spread
        (replace(LOOSE, posterior_sd=0.0499), IDENTIFIED),
        (replace(LOOSE, posterior_sd=0.0501), NOT_IDENTIFIED),
        # separate peaks are wide and no prior, unless they exclude little of it
        (replace(LOOSE, posterior_sd=0.08, modes=2, prior_excluded=0.5), IDENTIFIED),
        (replace(LOOSE, posterior_sd=0.08, modes=2, prior_excluded=0.49), NOT_IDENTIFIED),
        # a trade counts where the partners cut the spread to half and the interval is wide
        (replace(WIDE, partners=TRADED), COMBINATION),
        (replace(WIDE, partners=replace(TRADED, spread_given_partners=0.5)), COMBINATION),
        (replace(WIDE, partners=replace(TRADED, spread_given_partners=0.51)), IDENTIFIED),
        (replace(LOOSE, partners=TRADED), IDENTIFIED),
        (replace(SHARP, partners=TRADED), IDENTIFIED),
        # as wide as the prior, a trade is no knowledge
        (replace(WIDE, partners=TRADED, posterior_sd=0.1), NOT_IDENTIFIED),
        (replace(WIDE, partners=TRADED, posterior_sd=0.099), COMBINATION),
        # ends
        (replace(LOOSE, ends=(LOW,)), BOUNDED),
        (replace(LOOSE, ends=(HIGH,)), BOUNDED),
        (replace(LOOSE, ends=(replace(LOW, support=0.147),)), BOUNDED),
        (replace(LOOSE, ends=(replace(LOW, support=0.146),)), IDENTIFIED),
        (replace(LOOSE, ends=(LOW, HIGH)), NOT_IDENTIFIED),
        (replace(LOOSE, ends=(range_end(1, "user"),)), NOT_IDENTIFIED),
        (replace(LOOSE, ends=(range_end(0, "prior"),)), NOT_IDENTIFIED),
        # one-sided needs a quarter of the prior excluded, or the contraction of an interval
        (replace(LOOSE, ends=(LOW,), prior_excluded=0.25, posterior_sd=0.09), BOUNDED),
        (replace(LOOSE, ends=(LOW,), prior_excluded=0.24, posterior_sd=0.09), NOT_IDENTIFIED),
        (replace(LOOSE, ends=(LOW,), prior_excluded=0.24), BOUNDED),
        # a trade comes before an open end
        (replace(WIDE, ends=(LOW,), partners=TRADED), COMBINATION),
    ],
)
def test_diagnostics_decide(diagnostics, verdict):
    found = assess(diagnostics)
    assert found.verdict == verdict and found.reason
    assert bool(found.bound) == (verdict == BOUNDED)


def test_a_bound_is_the_end_that_is_not_open():
    below, above = (assess(replace(LOOSE, ends=(end,))) for end in (LOW, HIGH))
    assert (below.bound, above.bound) == ("high", "low")
    assert "aligned fibres" in below.reason and "isotropic" in above.reason


def test_a_partner_that_may_lie_at_its_end_asks_for_a_sharp_interval():
    loose, sharp = (replace(e, partners=TRADED) for e in (LOOSE, SHARP))
    assert assess(loose).verdict == IDENTIFIED
    assert assess(loose, weak=["k1"]).verdict == COMBINATION
    assert assess(loose, weak=["C1"]).verdict == IDENTIFIED
    assert assess(sharp, weak=["k1"]).verdict == IDENTIFIED


def test_what_may_mean_nothing_is_never_identified():
    why = "kappa = 1/3 is not excluded"
    assert assess(SHARP, undefined=why).verdict == NOT_IDENTIFIED
    traded = assess(replace(SHARP, partners=TRADED), undefined=why)
    assert (traded.verdict, traded.reason) == (COMBINATION, why)


def test_a_stiffness_spans_no_order_of_magnitude():
    known = replace(LOOSE, parameter=K1, median=30.0, low=10.0, high=99.0, prior_sd=3.0)
    assert assess(known, K1).verdict == IDENTIFIED
    wide = assess(replace(known, high=101.0), K1)
    assert wide.verdict == NOT_IDENTIFIED and wide.reason == "known only to a factor of 10"


MOUNTED = replace(LOOSE, parameter=STRETCH, median=1.02, low=1.01, high=1.03)


@pytest.mark.parametrize(
    ("changes", "verdict", "bound"),
    [
        ({}, IDENTIFIED, ""),
        ({"by_prior": (False, True)}, BOUNDED, "low"),
        ({"by_prior": (True, False)}, NOT_IDENTIFIED, ""),
        ({"by_prior": (True, True)}, NOT_IDENTIFIED, ""),
        ({"ends": (range_end(1, "prior"),)}, BOUNDED, "low"),
        ({"ends": (range_end(0, "prior"),)}, NOT_IDENTIFIED, ""),
        # hardly narrower than its prior, only the lower end may hold
        ({"posterior_sd": 0.0501}, BOUNDED, "low"),
    ],
)
def test_a_mounting_stretch_may_hold_from_below(changes, verdict, bound):
    found = assess_stretch(replace(MOUNTED, **changes), T, None)
    assert (found.verdict, found.bound) == (verdict, bound)


def test_an_identified_mounting_stretch_rests_on_the_law():
    assert assess_stretch(MOUNTED, T, None).reason == "given the law, the data determine it"


def test_a_mounting_stretch_that_was_measured_is_known_whatever_the_force_says():
    prior = replace(MOUNTED, by_prior=(True, True), posterior_sd=0.1)
    assert assess_stretch(prior, T, (prior.median, 0.1)).verdict == MEASURED


def together(diagnostics, state="converged", given=(), **priors):
    scales = [ComparisonScale(Quantity(p), priors.get(p.name, FLAT)) for p in (K1, ALPHA, KAPPA)]
    found = assess_parameters(scales, diagnostics, GOH_LAW, state, thresholds=T, given=given)
    return {p.name: p.assessment for p in found}


ALL = {
    "k1": replace(LOOSE, parameter=K1, median=30.0, low=20.0, high=45.0),
    "alpha": replace(LOOSE, parameter=ALPHA, median=40.0, low=39.0, high=41.0),
    "kappa": LOOSE,
}


def test_an_angle_of_fibres_that_may_be_isotropic_means_nothing():
    assert {a.verdict for a in together(ALL).values()} == {IDENTIFIED}
    found = together(ALL | {"kappa": replace(LOOSE, ends=(HIGH,))})
    assert found["alpha"].verdict == NOT_IDENTIFIED
    assert "kappa = 1/3" in found["alpha"].reason
    found = together(ALL | {"kappa": replace(LOOSE, ends=(LOW,))})
    assert found["alpha"].verdict == IDENTIFIED


@pytest.mark.parametrize("weak", [{"ends": (LOW,)}, {"posterior_sd": 0.0501}])
def test_a_partner_that_is_open_or_hardly_known_counts_as_weak(weak):
    traded = replace(ALL["k1"], low=15.0, high=45.0, partners=Partners(("kappa",), 0.3, 0.4))
    assert together(ALL | {"k1": traded})["k1"].verdict == IDENTIFIED
    found = together(ALL | {"k1": traded, "kappa": replace(LOOSE, **weak)})
    assert found["k1"].verdict == COMBINATION


def test_what_rests_on_a_prior_that_the_user_gave_says_so():
    known = "the data determine it"
    prior_decides = ALL | {"kappa": replace(LOOSE, posterior_sd=0.0999)}
    assert together(prior_decides)["k1"].reason == known
    found = together(prior_decides, given=["kappa"])
    assert found["k1"].reason == f"given your prior of kappa, {known}"
    assert (found["k1"].verdict, found["kappa"].verdict) == (IDENTIFIED, NOT_IDENTIFIED)
    # a record that narrows the prior speaks for itself
    assert together(ALL, given=["kappa"])["k1"].reason == known


def test_what_is_fixed_or_tied_has_no_verdict_and_neither_have_chains_that_do_not_agree():
    found = together(ALL, k1=20.0, kappa=Tie(0.5, "k1"))
    assert [found[n].verdict for n in ("k1", "alpha", "kappa")] == [FIXED, IDENTIFIED, FIXED]
    for state, given in (("tentative", ALL), ("unusable", {})):
        assert {a.verdict for a in together(given, state).values()} == {NO_VERDICT}
        assert {a.reason for a in together(given, state).values()} == {"chains have not converged"}


def test_a_width_is_listed_once_for_both_directions():
    names = [name for name, _ in T.items(MOUNTING_PARAMETERS)]
    assert names.count("sharp_mounting_stretch") == 1
    assert not [name for name in names if name.endswith(("_x", "_y"))]
