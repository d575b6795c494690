"""One set of numbers: whoever writes about a run gives the same quantiles with the same digits."""

import csv
import html
import json
import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.figures.identifiability import identifiability_figure
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.identifiability.reported import DASH, quantile_texts
from biaxbayes.identifiability.verdict import VERDICTS
from biaxbayes.laws import law_named
from biaxbayes.parameters import MOUNTING_PARAMETERS
from biaxbayes.reports.methods import closing_message, latex_table
from biaxbayes.reports.page import report_page
from biaxbayes.runs.result import as_record, result_from_record


@pytest.fixture(params=["media_run", "small_run"])
def run(request):
    """With a smooth misfit, where little is identified, and without, where much is."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def rows(run):
    with (run.path / "report.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def texts(run, row) -> tuple[str, str, str]:
    """Median and ends as every table and figure prints them."""
    parameter = run.quantities[row["parameter"]].parameter
    return quantile_texts(*(float(row[k]) for k in ("q50", "q05", "q95")), parameter)


def test_every_row_has_its_quantiles_a_verdict_and_a_reason(run, rows):
    assert len(rows) == (7 if run.settings.has_misfit else 6)
    for row in rows:
        assert row["verdict"] in VERDICTS and row["reason"]
        quantiles = run.draws[row["parameter"]].quantile([0.05, 0.5, 0.95])
        numbers = [float(row[k]) for k in ("q05", "q50", "q95")]
        assert numbers == pytest.approx(quantiles.to_list(), rel=1e-7)
        assert numbers[0] < numbers[1] < numbers[2]
        _, low, high = texts(run, row)
        wanted = {f"{low} to {high}"}
        if row["verdict"] == "bounded":
            wanted = {f"above {low}", f"below {high}"}
        assert row["interval"] in wanted


COLUMNS = ("interval", "unit", "verdict", "reason")


def test_terminal(run, rows):
    lines = closing_message(run).splitlines()
    table = [re.split(r" {2,}", line) for line in lines[1 : 1 + len(rows)]]
    for cells, row in zip(table, rows, strict=True):
        wanted = [row["parameter"], texts(run, row)[0], *(row[k] for k in COLUMNS if row[k])]
        assert cells == wanted


def test_page(run, rows):
    page = report_page(run)
    assert page.index("What to report") < page.index("<table")
    first = page.partition("<tbody>")[2].partition("</tbody>")[0]
    result = []
    for line in first.strip().splitlines():
        cells = [html.unescape(re.sub(r"<[^>]+>", "", c)) for c in line.split("</t")][1:6]
        result.append([c.split(">", 1)[-1] for c in cells])
    for cells, row in zip(result, rows, strict=True):
        assert cells == [texts(run, row)[0], *(row[k] for k in COLUMNS)]


def test_latex(run, rows):
    body = latex_table(run).partition("\\midrule")[2].partition("\\bottomrule")[0]
    for line, row in zip(body.strip().splitlines(), rows, strict=True):
        cells = [c.strip().removesuffix("\\\\").strip() for c in re.split(r"(?<!\\)&", line)][1:]
        plain = [re.sub(r"\\(.)", r"\1", c) for c in cells]
        assert plain == [texts(run, row)[0], *(row[k] for k in COLUMNS)]


def test_a_predicted_stress_is_the_stress_to_report(run):
    """At the end of the test: of more draws, so to the Monte Carlo error of its ends."""
    table = pd.read_csv(run.path / "report-stresses.csv")
    nominal = table[table["quantity"].str.startswith("nominal stress")]
    assert len(nominal) >= 4
    p = run.specimen.protocols[0]
    ends = nominal[nominal["quantity"].str.contains(f"stretch of {p.name}$|stretch$")].iloc[-2:]
    predicted = biaxbayes.predict(run, p.stretch, stress="piola", reference="measured").iloc[-1]
    for axis, row in zip("xy", ends.to_dict("records"), strict=True):
        assert row["quantity"].startswith(f"nominal stress {axis}")
        width = row["high"] - row["low"]
        for end, name in (("low", "credible_low"), ("median", "median"), ("high", "credible_high")):
            assert predicted[f"piola_{axis}_kPa_{name}"] == pytest.approx(row[end], abs=0.3 * width)


def test_stresses_at_total_stretches_are_given_only_where_the_mounting_stretches_are(run):
    stretches = [r for r in run.result.reported if r.name.startswith("mounting_stretch")]
    known = all(r.verdict == "identified" for r in stretches)
    for table in (run.result.determined, run.result.stresses):
        assert table["quantity"].str.startswith("Cauchy stress").any() == known


def test_a_test_that_determines_little_says_so(media_run):
    """And what to do: the advice follows in the same line."""
    reported = [replace(r, verdict="not identified") for r in media_run.result.reported]
    reported[3] = replace(reported[3], verdict="identified")
    poor = replace(media_run.result, reported=tuple(reported), advice="to narrow C1: pull more")
    assert poor.low_information.startswith("this test determines 1 of 7 parameters (alpha): ")
    assert replace(poor, state="tentative").low_information == ""
    rich = [replace(r, verdict="identified") for r in reported]
    assert replace(poor, reported=tuple(rich)).low_information == ""
    poor_run = replace(media_run)
    poor_run.__dict__["result"] = poor
    message, page = closing_message(poor_run), report_page(poor_run)
    assert f"{poor.low_information}; to narrow C1: pull more" in message
    assert "Most parameters are not determined." in page and "1 of 7 parameters" in page


def test_chains_that_have_not_converged_give_no_verdict_and_no_number_anywhere(media_run, tmp_path):
    judged = identify_draws(media_run.posterior(), media_run.draws, "tentative")
    assert {(r.verdict, r.reason) for r in judged.reported} == {
        ("no verdict", "chains have not converged")
    }
    assert all(math.isnan(v) for r in judged.reported for v in (r.median, r.low, r.high))
    record = as_record(replace(media_run.result, state="tentative", reported=judged.reported))
    again = result_from_record(record, media_run.law, media_run.quantities, tmp_path)
    assert {(row.median, row.interval) for row in again.rows} == {(DASH, DASH)}
    tentative = replace(media_run)
    tentative.__dict__["result"] = again
    assert "no verdict" in latex_table(tentative) and "not identified" not in latex_table(tentative)
    first = report_page(tentative).partition("<tbody>")[2].partition("</tbody>")[0]
    assert first.count("no verdict") == 7
    texts = [
        t.get_text() for ax in identifiability_figure(judged, again.rows).axes for t in ax.texts
    ]
    assert texts.count("no verdict") == 7


def test_digits():
    """Two of the width of the interval; of a range of decades two of each number."""
    C1, alpha, kappa = (law_named("goh").parameter(n) for n in ("C1", "alpha", "kappa"))
    stretch = MOUNTING_PARAMETERS[0]
    assert quantile_texts(1.01802, 1.01493, 1.02118, stretch) == ("1.0180", "1.0149", "1.0212")
    assert quantile_texts(38.44, 33.07, 41.02, alpha) == ("38.4", "33.1", "41.0")
    assert quantile_texts(2.468, 0.1453, 27.11, C1) == ("2.5", "0.15", "27")
    assert quantile_texts(1234.0, 1100.0, 1420.0, C1) == ("1230", "1100", "1420")
    assert quantile_texts(0.2, 0.2, 0.2, kappa) == (kappa.number(0.2),) * 3
    # a range that is not of a scale has no decades
    assert quantile_texts(0.0964, 0.0096, 0.2757, kappa) == ("0.10", "0.01", "0.28")
    # the median never lies outside its interval, to the digit
    rng = np.random.default_rng(1)
    for _ in range(500):
        low, median, high = np.sort(rng.lognormal(0.0, 2.0, 3))
        for parameter in (C1, alpha, stretch):
            middle, first, last = map(float, quantile_texts(median, low, high, parameter))
            assert first <= middle <= last


def test_summary_evidence_and_result_have_the_same_quantiles(run, rows):
    evidence = run.result.identifiability.set_index("parameter")
    record = json.loads((run.path / "results.json").read_text(encoding="utf-8"))
    stored = {r["name"]: r for r in record["reported"]}
    assert [*stored] == [row["parameter"] for row in rows]
    for row in rows:
        name, numbers = row["parameter"], [float(row[k]) for k in ("q05", "q50", "q95")]
        assert run.summary.loc[name, ["q05", "q50", "q95"]].to_list() == pytest.approx(
            numbers, rel=1e-7
        )
        columns = ["posterior_q05", "posterior_median", "posterior_q95"]
        assert evidence.loc[name, columns].to_list() == pytest.approx(numbers, rel=1e-7)
        own = run.result[name]
        assert [own.low, own.median, own.high] == pytest.approx(numbers, rel=1e-7)
        assert (own.verdict, own.reason) == (row["verdict"], row["reason"])
        assert [stored[name][k] for k in ("verdict", "reason")] == [row["verdict"], row["reason"]]


def test_only_one_table_has_stresses_to_report(media_run):
    table = pd.read_csv(media_run.path / "report-stresses.csv")
    all_of_them = media_run.result.determined.set_index(["quantity", "stretch_x", "stretch_y"])
    assert len(table) >= 4
    for row in table.to_dict("records"):
        own = all_of_them.loc[(row["quantity"], row["stretch_x"], row["stretch_y"])]
        for column in ("low", "median", "high"):
            assert row[column] == pytest.approx(own[column], rel=1e-6)
    page = report_page(media_run)
    before, evidence = page.split('<h2 id="evidence">')
    assert "ominal stress x" in before
    assert "ominal stress x" not in evidence.partition('<h2 id="convergence">')[0]
