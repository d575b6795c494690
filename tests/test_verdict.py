"""Verdicts and their sentences, decided by diagnostics that is written down."""

from __future__ import annotations

from dataclasses import replace

import pytest

from biaxbayes.identifiability.marginals import ComparisonScale, Edge
from biaxbayes.identifiability.partners import Partners
from biaxbayes.identifiability.verdict import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    Diagnostics,
    Thresholds,
    decide,
    verdict_sentence,
)
from biaxbayes.model.priors import Tie
from biaxbayes.parameters import Quantity
from goh_functions import GOH_LAW

KAPPA, K1 = GOH_LAW.parameter("kappa"), GOH_LAW.parameter("k1")
LOOSE = Diagnostics(
    parameter=KAPPA,
    median=0.15,
    low=0.05,
    high=0.25,
    prior_sd=0.1,
    posterior_sd=0.04,
    prior_excluded=0.6,
    edges=(),
    partners=Partners((), 1.0, 1.0),
    modes=1,
    prior_sensitivity=0.0,
    likelihood_sensitivity=0.5,
)
SHARP = replace(LOOSE, low=0.10, high=0.19)
WIDE = replace(LOOSE, low=0.04)  # wider than twice a sharp interval
TRADED = Partners(("k1", "alpha"), 0.3, 0.4)
T = Thresholds()


def edge(side: int, kind: str = "physical", support: float = 0.5, value: float = 0.0) -> Edge:
    return Edge(side, value, kind, 0.01, 0.05, 0.03, support)


LOW, HIGH = edge(0), edge(1, value=1 / 3)


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
        # ends
        (replace(LOOSE, edges=(LOW,)), BOUNDED),
        (replace(LOOSE, edges=(HIGH,)), BOUNDED),
        (replace(LOOSE, edges=(replace(LOW, support=0.147),)), BOUNDED),
        (replace(LOOSE, edges=(replace(LOW, support=0.146),)), IDENTIFIED),
        (replace(LOOSE, edges=(LOW, HIGH)), NOT_IDENTIFIED),
        (replace(LOOSE, edges=(edge(1, "user"),)), NOT_IDENTIFIED),
        (replace(LOOSE, edges=(edge(0, "prior"),)), NOT_IDENTIFIED),
        # one-sided needs a quarter of the prior excluded, or the contraction of an interval
        (replace(LOOSE, edges=(LOW,), prior_excluded=0.25, posterior_sd=0.09), BOUNDED),
        (replace(LOOSE, edges=(LOW,), prior_excluded=0.24, posterior_sd=0.09), NOT_IDENTIFIED),
        (replace(LOOSE, edges=(LOW,), prior_excluded=0.24), BOUNDED),
        # a trade comes before an open end
        (replace(WIDE, edges=(LOW,), partners=TRADED), COMBINATION),
        # refits more than twice as wide as the interval (0.2) come before all else
        (replace(LOOSE, refits=(0.0, 0.41), partners=TRADED), NOT_IDENTIFIED),
        (replace(LOOSE, refits=(0.1, 0.49)), IDENTIFIED),
    ],
)
def test_evidence_decides(diagnostics, verdict):
    assert decide(diagnostics, T) == verdict


def test_a_partner_that_may_lie_at_its_end_asks_for_a_sharp_interval():
    loose, sharp = (replace(e, partners=TRADED) for e in (LOOSE, SHARP))
    assert decide(loose, T) == IDENTIFIED
    assert decide(loose, T, partner_is_weak=True) == COMBINATION
    assert decide(sharp, T, partner_is_weak=True) == IDENTIFIED


def test_what_may_mean_nothing_is_never_identified():
    assert decide(SHARP, T, undefined=True) == NOT_IDENTIFIED
    assert decide(replace(SHARP, partners=TRADED), T, undefined=True) == COMBINATION


def kappa(verdict: str, diagnostics: Diagnostics | None, prior: object = 0.1, **how: str) -> str:
    scale = ComparisonScale(Quantity(KAPPA), prior)
    return verdict_sentence(scale, verdict, diagnostics, T, "tentative", **how)


@pytest.mark.parametrize(
    ("verdict", "diagnostics", "parts"),
    [
        (IDENTIFIED, replace(SHARP, prior_sensitivity=0.049), ["0.100 to 0.190 (90 %)"]),
        (IDENTIFIED, LOOSE, ["identified, but loosely, 0.050 to 0.250 (90 %)"]),
        (IDENTIFIED, replace(SHARP, prior_sensitivity=0.05), ["sensitive to the prior"]),
        (IDENTIFIED, replace(SHARP, modes=2), ["2 separate peaks"]),
        (BOUNDED, replace(LOOSE, edges=(LOW,)), ["below 0.250 (95 %)", "0 (aligned fibres)"]),
        (BOUNDED, replace(LOOSE, edges=(HIGH,)), ["above 0.050 (95 %)", "1/3 (isotropic)"]),
        (COMBINATION, replace(LOOSE, partners=TRADED), ["with k1 and alpha; alone 0.050 to 0.250"]),
        (COMBINATION, replace(LOOSE, partners=replace(TRADED, names=("k1",))), ["40 %"]),
        (NOT_IDENTIFIED, replace(LOOSE, posterior_sd=0.08), ["reduce the prior variance by 36 %"]),
        (NOT_IDENTIFIED, replace(LOOSE, posterior_sd=0.12), ["reduce the prior variance by 0 %"]),
        (
            NOT_IDENTIFIED,
            replace(LOOSE, edges=(LOW, edge(1, "user", value=0.27))),
            ["limited by the prior bound 0.270"],
        ),
        (NO_VERDICT, LOOSE, ["have not converged (tentative)"]),
        (FIXED, None, ["fixed at 0.1"]),
    ],
)
def test_a_verdict_is_one_sentence_with_its_numbers(verdict, diagnostics, parts):
    sentence = kappa(verdict, diagnostics)
    assert sentence.startswith("kappa: ") and "\n" not in sentence
    assert all(part in sentence for part in parts), sentence
    sensitive = diagnostics is not None and diagnostics.prior_sensitivity >= 0.05
    assert ("sensitive to the prior" in sentence) == sensitive


def test_sentences_say_ties_units_and_what_means_nothing():
    assert kappa(FIXED, None, Tie(0.5, "k1")) == "kappa: tied, 0.5 times k1"
    why = "means nothing at kappa 1/3"
    assert kappa(NOT_IDENTIFIED, SHARP, undefined=why).endswith(f"%; {why}")
    e = replace(LOOSE, parameter=K1, low=10.0, high=19.9)
    output = verdict_sentence(ComparisonScale(Quantity(K1), 1.0), IDENTIFIED, e, T, "converged")
    assert output == "k1: identified, 10 to 19.9 kPa (90 %)"  # sharp: the ends' ratio is below 2
    e = replace(LOOSE, parameter=K1, low=10.0, high=20.1)
    output = verdict_sentence(ComparisonScale(Quantity(K1), 1.0), IDENTIFIED, e, T, "converged")
    assert output == "k1: identified, but loosely, 10 to 20.1 kPa (90 %)"
