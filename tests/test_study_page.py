"""A study's groups by hand; its page and figure: many specimens, hostile names, any width."""

import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from biaxbayes.figures.groups import study_figure
from biaxbayes.reports.answers import answers, sentence
from biaxbayes.reports.study_page import closing_message, group_tables, write_study
from biaxbayes.studies.groups import group_contrasts, group_means, group_summaries
from biaxbayes.studies.study_result import STUDY_COLUMNS, StudyResult
from made_up import table
from readable import assert_readable


@pytest.fixture(scope="module", params=[9, 40])
def result(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    outcome = StudyResult(
        "Study <script>document.title='broken'</script>",
        folder,
        table(request.param),
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


def test_numbers_of_groups_stand_below_each_other(result):
    """Every cell that begins with a number is right-aligned, and so is its heading."""
    page = (result.folder / "study.html").read_text(encoding="utf-8")
    tables = [t for t in page.split("<table>")[1:] if "Range of medians" in t]
    assert tables
    for text in tables:
        body = text.split("</table>")[0]
        heads = re.findall(r'<th scope="col"( class="n")?>', body)
        for row in body.split("<tr>")[2:]:
            cells = re.findall(r'<td( class="n")?>(.)', row)
            for head, (right, first) in zip(heads[1:], cells, strict=True):
                assert not first.isdigit() or (right and head), row


def test_reported_intervals_of_the_parameters_are_the_table_for_a_notebook(result):
    of = replace(result, table=result.table.assign(reported="1.25 to 2.5"))
    shown = of._repr_html_()
    for parameter in ("C1", "kappa", "mounting_stretch_x"):
        assert f"<th>{parameter}</th>" in shown
    assert "stiffness_x at 1" not in shown and "Hx" not in shown
    assert shown.count("<tr") == 1 + len(result.specimens)
    assert "1.25 to 2.5" in shown and "<img src=x" not in shown and "<script" not in shown


def rows(*cells):
    names = ("specimen", "donor", "layer", "state", "kind", "quantity", "unit", "verdict")
    names += ("q05", "q50", "q95", "scale")
    return pd.DataFrame(cells, columns=list(names))


def specimen(label, donor, layer, C1, sd, *, state="converged", verdict="identified"):
    low, high = (C1 * math.exp(z * 1.6449 * sd) for z in (-1.0, 1.0))
    return (label, donor, layer, state, "parameter", "C1", "kPa", verdict, low, C1, high, "log")


TABLE = rows(
    specimen("a", "D1", "media", 10.0, 0.1),
    specimen("b", "D2", "media", 40.0, 0.1),
    specimen("c", "D3", "media", 5000.0, 30.0, verdict="not identified"),
    specimen("d", "D4", "media", 9000.0, 0.1, state="tentative"),
    specimen("e", "D1", "intima", 3.0, 0.1, verdict="bounded"),
    ("f", "D5", "", "failed", "parameter", "C1", None, None, *[math.nan] * 3, None),
)


def test_a_specimen_that_knows_little_weighs_little_and_no_verdict_decides():
    outcome = group_summaries(TABLE).set_index(["group_by", "group"])
    media = outcome.loc[("layer", "media")]
    assert (media.specimens, media.converged) == (4, 3)
    # geometric mean of 10 and 40; the third has a sd of 30 of ln C1
    assert media["mean"] == pytest.approx(20.0, rel=0.01)
    assert media.mean_low < 11.0 and media.mean_high > 36.0
    assert (media.lowest, media.highest) == (10.0, 5000.0)
    # tau of two values 1.39 apart, under half-normal(0.5)
    assert 0.5 < media.sd_between < 1.2
    intima = outcome.loc[("layer", "intima")]
    assert intima["mean"] == pytest.approx(3.0) and math.isnan(intima.sd_between)
    assert outcome.loc[("donor", "D1")].specimens == 2
    assert outcome.loc[("all", "all")].specimens == 6
    assert ("layer", "") not in outcome.index
    words = TABLE.assign(verdict="not identified")
    pd.testing.assert_frame_equal(group_summaries(words), group_summaries(TABLE))


def test_a_spread_that_the_posteriors_explain_is_hardly_any_between_specimens():
    wide, sharp = (
        group_summaries(
            rows(specimen("a", "", "media", 10.0, sd), specimen("b", "", "media", 40.0, sd))
        ).iloc[0]
        for sd in (1.0, 0.001)
    )
    assert wide.sd_between < 0.4 and sharp.sd_between > 0.6


def test_the_terminal_names_what_has_not_converged(tmp_path):
    table = TABLE.reindex(columns=list(STUDY_COLUMNS))
    lines = closing_message(StudyResult("study", tmp_path, table)).splitlines()
    assert lines[0].startswith("6 specimens: ") and "d: tentative" in lines


def test_means_are_those_of_the_model_integrated_by_brute_force():
    """Two groups, on a grid over both means and tau."""
    a, b = (
        (np.array([0.0, 0.3, 0.1]), np.array([0.1, 0.2, 0.4])),
        (np.array([0.6, 0.9]), np.ones(2) * 0.2),
    )
    mu, tau = np.linspace(-4.0, 5.0, 901), np.linspace(1e-4, 2.5, 500)
    log = [
        sum(norm.logpdf(y, mu[:, None], np.hypot(tau, s)) for y, s in zip(*group, strict=True))
        for group in (a, b)
    ]
    own = [np.exp(part - part.max()) for part in log]
    shared = norm.pdf(tau / 0.5)
    # p(mu_b - mu_a): the product of both at each tau, summed over tau
    apart = sum(shared[k] * np.convolve(own[1][:, k], own[0][::-1, k]) for k in range(len(tau)))
    at = np.linspace(-9.0, 9.0, apart.size)
    cumulative = apart.cumsum() / apart.sum()
    found = group_means([a, b], 0.5).difference().quantiles()
    np.testing.assert_allclose(found, np.interp((0.05, 0.5, 0.95), cumulative, at), atol=0.02)


def grouped(*values, donors=None):
    """A specimen a value, in turn of group A and B."""
    donors = donors or [f"D{i}" for i in range(len(values))]
    cells = [
        specimen(f"s{i}", donor, "", value, 0.1)
        for i, (value, donor) in enumerate(zip(values, donors, strict=True))
    ]
    return rows(*cells).assign(disease=["AB"[i % 2] for i in range(len(values))])


def test_groups_are_those_of_the_stated_column_and_their_means_are_compared():
    table = grouped(8.0, 32.0, 12.0, 48.0, 10.0, 40.0)
    (row,) = group_contrasts(table, ["disease"]).to_dict("records")
    assert (row["group_a"], row["group_b"], row["donors_a"], row["donors_b"]) == ("A", "B", 3, 3)
    assert row["difference"] == pytest.approx(4.0, rel=1e-3) and row["direction"] == "larger"
    assert row["probability_larger"] > 0.99
    assert 2.4 < row["difference_low"] < 3.4 and 4.7 < row["difference_high"] < 6.7
    # as wide as it is, with 2.49 sds for 1.64
    half = math.log(row["difference_high"] / row["difference_low"]) / 2.0
    assert math.log(row["detectable"]) == pytest.approx(half * 2.4865 / 1.6449, rel=0.1)


@pytest.mark.parametrize("contraction", [0.748, 0.760])
def test_the_same_specimens_give_the_same_contrast_on_both_sides_of_a_threshold(contraction):
    verdict = "identified" if contraction >= 0.75 else "not identified"
    table = grouped(8.0, 32.0, 12.0, 48.0, 10.0, 40.0)
    told = table.assign(verdict=[verdict] * 3 + ["identified"] * 3)
    pd.testing.assert_frame_equal(
        group_contrasts(told, ["disease"]), group_contrasts(table, ["disease"])
    )


def test_the_prior_of_a_run_is_divided_out_of_each_specimen():
    """Normal posteriors: y_i and s_i are those of the likelihoods alone, whatever the prior."""
    y, s = np.array([0.05, 0.22, 0.1, 0.28, 0.12, 0.3]), np.array([6, 5, 4, 6, 5, 4]) / 100
    contrasts = []
    for middle, sd in ((0.0, 1e6), (1.0 / 6.0, 0.08)):
        d = 1.0 / np.sqrt(1.0 / s**2 + 1.0 / sd**2)
        m = d**2 * (y / s**2 + middle / sd**2)
        table = rows(*(specimen(f"s{i}", f"D{i}", "", 1.0, 0.1) for i in range(6)))
        table = table.assign(quantity="kappa", unit="1", scale="linear", disease=list("ABABAB"))
        table = table.assign(q05=m - 1.6448536 * d, q50=m, q95=m + 1.6448536 * d)
        table["prior_q05"], table["prior_q95"] = middle - 1.6448536 * sd, middle + 1.6448536 * sd
        contrasts.append(group_contrasts(table.assign(prior_q50=middle), ["disease"]))
    pd.testing.assert_frame_equal(*contrasts, rtol=1e-5)
    # with the prior of every specimen left in, a quarter of the difference is gone
    (without,) = group_contrasts(table, ["disease"]).to_dict("records")
    (told,) = contrasts[1].to_dict("records")
    assert without["difference"] < 0.85 * told["difference"]


def test_equal_groups_seldom_differ_and_different_ones_are_found():
    """100 studies of 4 and 4 specimens with a scatter of 0.2, known to 0.05 to 0.4."""
    rng, found = np.random.default_rng(4), {0.0: 0, math.log(1.75): 0}
    for apart in found:
        for _ in range(100):
            s = np.exp(rng.uniform(np.log(0.05), np.log(0.4), (2, 4)))
            y = rng.normal(np.array([[0.0], [apart]]), np.hypot(0.2, s))
            low, _, high = group_means(list(zip(y, s, strict=True)), 0.5).difference().quantiles()
            found[apart] += not low < 0.0 < high
    # 10 % expected, its Monte Carlo error is 3 %
    assert found[0.0] / 100 < 0.10 + 3 * 0.03
    assert found[math.log(1.75)] / 100 > 0.8


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


def test_a_range_of_medians_has_the_digits_of_the_mean():
    values = {"a": 1.0052, "b": 1.0061, "c": 1.0064, "d": 1.0069}
    near = rows(*(specimen(s, s, "media", C1, 0.0002) for s, C1 in values.items()))
    ((_, ranges),) = group_tables(group_summaries(near), "layer")
    (row,) = ranges.cells()
    assert row[5] == "1.005 to 1.007" and len(row[3]) == len("1.005")


def test_sentences():
    row = {"group_a": "A", "group_b": "B", "unit": "kPa", "scale": "log", "donors_a": 4}
    row |= {"donors_b": 4, "difference": 1.5, "difference_low": 1.2, "difference_high": 1.9}
    row |= {"probability_larger": 0.98, "detectable": 1.9, "direction": "larger"}
    stiff = row | {"quantity": "stiffness_x at 1.1"}
    found = "(1.2 to 1.9 times; probability 0.98)"
    assert sentence(stiff) == f"B is 1.5 times as stiff in x at 1.1 {found}"
    assert sentence(row | {"quantity": "k1"}) == f"k1 of B is 1.5 times as large {found}"
    hardly = stiff | {"difference_low": 1.0014}
    assert "(1.001 to 1.9 times; probability 0.98)" in sentence(hardly)
    for low, text in ((1.00004, "1.00004"), (1.0, "1"), (12345.0, "more than 10000")):
        assert f"({text} to 1.9 times" in sentence(stiff | {"difference_low": low})
    unclear = stiff | {"direction": "open", "difference_low": 0.7, "difference_high": 3.4}
    shown = "no difference shown (0.7 to 3.4 times); 8 donors could show 1.9 times"
    assert sentence(unclear) == f"stiffness in x at 1.1: {shown}"
    angle = row | {"quantity": "alpha", "unit": "deg", "scale": "linear", "difference": -5.0}
    angle |= {"difference_low": -8.0, "difference_high": -2.0, "probability_larger": 0.004}
    said = "alpha of B is 5 degrees smaller (-8 to -2 degrees; probability above 0.99)"
    assert sentence(angle | {"direction": "smaller"}) == said
    others = [row | {"quantity": q} for q in ("stiffness_x at 1", "stiffness_x at 1.05", "k1")]
    assert answers([*others, stiff]) == [sentence(stiff), sentence(others[2])]


def test_the_study_answers_at_the_top(tmp_path):
    """Page and terminal say how the groups differ, what the law misses, and no file too many."""
    table = grouped(8.0, 32.0, 12.0, 48.0, 10.0, 40.0).assign(law_misses="")
    table.loc[5, "law_misses"] = "GOH misses protocol 1:1 by 4 % of its peak"
    others = [
        table.assign(quantity=name) for name in ("mounting_stretch_x[1:1]", "stiffness[s5-strip]")
    ]
    table = pd.concat([table, *others]).reindex(columns=[*STUDY_COLUMNS, "disease"])
    table["folder"] = table["reason"] = table["file"] = ""
    outcome = StudyResult("two groups", tmp_path, table)
    write_study(outcome)
    written = {path.name for path in tmp_path.iterdir()}
    page, terminal = (tmp_path / "study.html").read_text(), closing_message(outcome)
    for said in (page.partition("<img")[0], terminal):
        assert "B compared with A" in said.replace("<bdi>", "").replace("</bdi>", "")
        assert "C1 of B is 4 times as large" in said
        assert "s5: GOH misses protocol 1:1" in said and "s4:" not in said
    assert "study-group-contrasts.csv" in written and "study-group-contrasts.csv" in page


def test_one_specimen_of_a_group_is_nothing_to_compare(tmp_path):
    table = grouped(8.0, 32.0, 12.0).reindex(columns=[*STUDY_COLUMNS, "disease"])
    table["folder"] = table["reason"] = table["file"] = ""
    outcome = StudyResult("one", tmp_path, table)
    assert "fewer than 2 converged specimens of a group" in closing_message(outcome)
