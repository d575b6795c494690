"""Groups of specimens and pairs of layers, against numbers worked out by hand."""

from __future__ import annotations

import math

import pandas as pd
import pytest

from biaxbayes.studies.groups import group_summaries, layer_contrasts


def rows(*cells):
    names = ("specimen", "donor", "layer", "state", "kind", "quantity", "unit", "verdict")
    names += ("q50", "scale", "scale_sd")
    return pd.DataFrame(cells, columns=list(names))


def specimen(label, donor, layer, C1, sd, *, state="converged", verdict="identified"):
    return (label, donor, layer, state, "parameter", "C1", "kPa", verdict, C1, "log", sd)


TABLE = rows(
    specimen("a", "D1", "media", 10.0, 0.1),
    specimen("b", "D2", "media", 40.0, 0.2),
    specimen("c", "D3", "media", 5000.0, 3.0, verdict="not identified"),
    specimen("d", "D4", "media", 9000.0, 0.1, state="tentative"),
    specimen("e", "D1", "intima", 3.0, 0.1, verdict="bounded"),
    ("f", "D5", "", "failed", "parameter", "C1", None, None, math.nan, None, math.nan),
)


def test_only_specimens_that_determine_a_quantity_give_numbers():
    found = group_summaries(TABLE).set_index(["group_by", "group"])
    media = found.loc[("layer", "media")]
    assert (media.specimens, media.converged, media.identified) == (4, 3, 2)
    # geometric mean of 10 and 40
    assert media.centre == pytest.approx(20.0)
    assert (media.lowest, media.highest) == (10.0, 40.0)
    # sd of ln 10 and ln 40 is ln(4) / sqrt(2)
    assert media.sd_of_medians == pytest.approx(math.log(4.0) / math.sqrt(2.0))
    assert media.sd_within == pytest.approx(math.sqrt((0.01 + 0.04) / 2.0))
    assert media.sd_between == pytest.approx(math.sqrt(media.sd_of_medians**2 - 0.025))
    intima = found.loc[("layer", "intima")]
    assert intima.centre == pytest.approx(3.0) and math.isnan(intima.sd_between)
    donor = found.loc[("donor", "D1")]
    assert (donor.specimens, donor.identified) == (2, 2)
    assert found.loc[("all", "all")].specimens == 6
    assert ("layer", "") not in found.index


def test_a_spread_that_the_posteriors_explain_is_none_between_specimens():
    table = rows(
        specimen("a", "", "media", 10.0, 0.5),
        specimen("b", "", "media", 11.0, 0.5),
    )
    assert group_summaries(table).iloc[0].sd_between == 0.0


def distance(donor, a, b, low, middle, high, *, known=True, kind="parameter", stretch=math.nan):
    return {
        "donor": donor,
        "layer_a": a,
        "layer_b": b,
        "kind": kind,
        "quantity": "C1" if kind == "parameter" else kind,
        "unit": "kPa",
        "total_stretch": stretch,
        "difference_q05": low,
        "difference_q50": middle,
        "difference_q95": high,
        "identified_in_both": known,
    }


def test_layers_are_counted_pair_by_pair_in_one_order():
    found = layer_contrasts(
        pd.DataFrame(
            [
                distance("D1", "intima", "media", 1.0, 2.0, 3.0),
                # the same the other way round: media listed first by this donor
                distance("D2", "media", "intima", -6.0, -4.0, -2.0),
                distance("D3", "intima", "media", -1.0, 0.5, 2.0),
                distance("D4", "intima", "media", -9.0, -8.0, -7.0, known=False),
                distance("D5", "media", "media", 5.0, 6.0, 7.0),
                distance("D1", "intima", "media", 1.0, 2.0, 3.0, kind="stress", stretch=1.1),
                distance("D1", "intima", "media", 1.0, 2.0, 3.0, kind="stiffness", stretch=1.1),
                distance("D1", "intima", "media", -3.0, -2.0, -1.0, kind="stiffness", stretch=1.0),
            ]
        )
    ).set_index("quantity")
    assert list(found.index) == ["C1", "stiffness"]
    C1 = found.loc["C1"]
    assert (C1.layer_a, C1.layer_b) == ("intima", "media")
    assert (C1.pairs, C1.identified, C1.b_greater, C1.b_less) == (4, 3, 2, 0)
    assert C1.mean_difference == pytest.approx((2.0 + 4.0 + 0.5) / 3.0)
    assert (C1.lowest_difference, C1.highest_difference) == (0.5, 4.0)
    assert found.loc["stiffness"].b_less == 1


def test_without_pairs_there_is_nothing():
    assert layer_contrasts(pd.DataFrame()).empty
    one = pd.DataFrame([distance("D5", "media", "media", 5.0, 6.0, 7.0)])
    assert layer_contrasts(one).empty
