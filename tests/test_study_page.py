"""A study's groups by hand; its page and figure: many specimens, hostile names, any width."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_ind

from biaxbayes.figures.population import study_figure
from biaxbayes.reports.study_page import closing_message, write_study
from biaxbayes.studies.groups import group_contrasts, group_summaries, layer_contrasts
from biaxbayes.studies.result import STUDY_COLUMNS, StudyResult
from made_up import distances, table
from readable import assert_readable


@pytest.fixture(scope="module", params=[9, 40])
def result(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    outcome = StudyResult(
        "Study <script>document.title='broken'</script>",
        folder,
        table(request.param),
        distances(request.param),
        ["D1: different priors of kappa: <i>fixed</i>"],
    )
    write_study(outcome)
    return outcome


@pytest.mark.long
def test_the_figure_fits_a_page_and_nothing_overlaps(result):
    assert_readable(study_figure(result.table, result.group_of), 180.0)


def test_the_page_counts_what_is_reliable(result):
    page = (result.folder / "study.html").read_text(encoding="utf-8")
    total = len(result.specimens)
    assert f"{total - 2} of {total} specimens have converged" in page
    assert "is no table &amp; &lt;worse&gt;" in page
    assert "<script" not in page and "<img src=x" not in page
    assert len(page) < 5_000_000


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
    outcome = group_summaries(TABLE).set_index(["group_by", "group"])
    media = outcome.loc[("layer", "media")]
    assert (media.specimens, media.converged, media.identified) == (4, 3, 2)
    # geometric mean of 10 and 40
    assert media.centre == pytest.approx(20.0)
    assert (media.lowest, media.highest) == (10.0, 40.0)
    # sd of ln 10 and ln 40 is ln(4) / sqrt(2)
    assert media.sd_of_medians == pytest.approx(math.log(4.0) / math.sqrt(2.0))
    assert media.sd_within == pytest.approx(math.sqrt((0.01 + 0.04) / 2.0))
    assert media.sd_between == pytest.approx(math.sqrt(media.sd_of_medians**2 - 0.025))
    intima = outcome.loc[("layer", "intima")]
    assert intima.centre == pytest.approx(3.0) and math.isnan(intima.sd_between)
    donor = outcome.loc[("donor", "D1")]
    assert (donor.specimens, donor.identified) == (2, 2)
    assert outcome.loc[("all", "all")].specimens == 6
    assert ("layer", "") not in outcome.index


def test_a_spread_that_the_posteriors_explain_is_none_between_specimens():
    table = rows(specimen("a", "", "media", 10.0, 0.5), specimen("b", "", "media", 11.0, 0.5))
    assert group_summaries(table).iloc[0].sd_between == 0.0


def distance(donor, a, b, low, middle, high, *, known=True, kind="parameter", stretch=math.nan):
    quantity = "C1" if kind == "parameter" else kind
    values = (donor, a, b, kind, quantity, "kPa", stretch, low, middle, high, known)
    names = "donor layer_a layer_b kind quantity unit total_stretch difference_q05 difference_q50 "
    names += "difference_q95 identified_in_both"
    return dict(zip(names.split(), values, strict=True))


def test_layers_are_counted_pair_by_pair_in_one_order():
    rows = [
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
    outcome = layer_contrasts(pd.DataFrame(rows)).set_index("quantity")
    assert list(outcome.index) == ["C1", "stiffness"]
    C1 = outcome.loc["C1"]
    assert (C1.layer_a, C1.layer_b) == ("intima", "media")
    assert (C1.pairs, C1.identified, C1.b_greater, C1.b_less) == (4, 3, 2, 0)
    assert C1.mean_difference == pytest.approx((2.0 + 4.0 + 0.5) / 3.0)
    assert (C1.lowest_difference, C1.highest_difference) == (0.5, 4.0)
    assert outcome.loc["stiffness"].b_less == 1


def grouped(*values, donors=None):
    """A specimen a value, in turn of group A and B."""
    donors = donors or [f"D{i}" for i in range(len(values))]
    cells = [
        specimen(f"s{i}", donor, "", value, 0.1)
        for i, (value, donor) in enumerate(zip(values, donors, strict=True))
    ]
    return rows(*cells).assign(disease=["AB"[i % 2] for i in range(len(values))])


def test_groups_are_those_of_the_stated_column_and_their_means_are_compared():
    (row,) = group_contrasts(grouped(8.0, 32.0, 12.0, 48.0, 10.0, 40.0), ["disease"]).to_dict(
        "records"
    )
    assert (row["group_a"], row["group_b"], row["donors_a"], row["donors_b"]) == ("A", "B", 3, 3)
    a, b = np.log([8.0, 12.0, 10.0]), np.log([32.0, 48.0, 40.0])
    test = ttest_ind(b, a, equal_var=False).confidence_interval(0.9)
    assert row["difference"] == pytest.approx(4.0) and row["direction"] == "larger"
    found = row["difference_low"], row["difference_high"]
    np.testing.assert_allclose(np.log(found), [test.low, test.high])


def test_donors_of_both_groups_are_compared_with_themselves():
    """Donors differ by a factor of 100, the groups within each by 2."""
    values, donors = (1.0, 2.0, 100.0, 202.0, 10.0, 19.8), ["D1", "D1", "D2", "D2", "D3", "D3"]
    (row,) = group_contrasts(grouped(*values, donors=donors), ["disease"]).to_dict("records")
    assert row["paired"] and row["direction"] == "larger"
    assert row["difference"] == pytest.approx(2.0, rel=0.01)
    (alone,) = group_contrasts(grouped(*values), ["disease"]).to_dict("records")
    assert not alone["paired"] and alone["direction"] == "open"


def test_a_donor_counts_once():
    donors = ["D1", "E1", "D1", "E1", "D1", "E2"]
    (row,) = group_contrasts(grouped(1, 2, 1, 2, 1, 2, donors=donors), ["disease"]).to_dict(
        "records"
    )
    assert (row["donors_a"], row["donors_b"]) == (1, 2) and not isinstance(row["direction"], str)


def test_the_study_answers_at_the_top(tmp_path):
    """Page and terminal say how the groups differ, what the law misses, and no file too many."""
    table = grouped(8.0, 32.0, 12.0, 48.0, 10.0, 40.0).assign(law_misses="")
    table.loc[5, "law_misses"] = "GOH misses the 1:1 protocol by 4 % of its peak"
    others = [
        table.assign(quantity=name, verdict="not identified")
        for name in ("k1", "mounting_stretch_x[1:1]", "stiffness[s5-strip]")
    ]
    table = pd.concat([table, *others]).reindex(columns=[*STUDY_COLUMNS, "disease"])
    table["folder"] = table["reason"] = table["file"] = ""
    table["q05"], table["q95"] = table["q50"] * 0.9, table["q50"] * 1.1
    outcome = StudyResult("two groups", tmp_path, table, pd.DataFrame())
    written = {path.name for path in write_study(outcome)}
    page, terminal = (tmp_path / "study.html").read_text(), closing_message(outcome)
    for said in (page.partition("<img")[0], terminal):
        assert "B compared with A" in said.replace("<bdi>", "").replace("</bdi>", "")
        assert "ratio 4" in said and "larger" in said
        assert "Not identified in 2 donors of each group: k1." in said
        assert "s5: GOH misses the 1:1 protocol" in said and "s4:" not in said
    assert "study-group-contrasts.csv" in written and "study-distances.csv" not in written
    for name in ("study-group-contrasts.csv", "study-distances.csv", "study-contrasts.csv"):
        assert (name in page) == (name in written)
