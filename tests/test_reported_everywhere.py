"""The reported table stands word for word the same wherever a run is written about."""

import csv
import html
import json
import math
import re
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.figures.identifiability import identifiability_figure
from biaxbayes.identifiability.identify import MAX_DIAGNOSTIC_DRAWS, identify_draws
from biaxbayes.identifiability.reported import DASH, interval_text
from biaxbayes.identifiability.verdict import VERDICTS
from biaxbayes.laws import law_named
from biaxbayes.parameters import MOUNTING_PARAMETERS
from biaxbayes.reports.comparison import write_comparison
from biaxbayes.reports.methods import (
    MOST_LINES,
    closing_message,
    latex_table,
    methods,
    results_paragraph,
)
from biaxbayes.reports.page import report_page
from biaxbayes.runs.result import as_record, result_from_record
from biaxbayes.studies.result import rows_of_run


@pytest.fixture(scope="module")
def rows(media_run):
    with (media_run.path / "report.csv").open(newline="", encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert len(table) == 7
    return table


def one_line(text: str) -> str:
    return " ".join(text.split())


def test_every_row_has_one_interval_one_verdict_and_one_reason(media_run, rows):
    for row in rows:
        assert row["verdict"] in VERDICTS and row["reason"]
        ends = [row["low"] != "", row["high"] != ""]
        known = {"identified": 2, "only in combination": 2, "bounded": 1, "not identified": 0}
        assert sum(ends) == known[row["verdict"]]
        assert (row["interval"] == DASH) == (sum(ends) == 0)
    record = json.loads((media_run.path / "results.json").read_text(encoding="utf-8"))
    assert [r["name"] for r in record["reported"]] == [row["parameter"] for row in rows]
    assert [r["reason"] for r in record["reported"]] == [row["reason"] for row in rows]


def test_terminal(media_run, rows):
    lines = closing_message(media_run).splitlines()
    assert len(lines) <= MOST_LINES
    table = [re.split(r" {2,}", line) for line in lines[1 : 1 + len(rows)]]
    for cells, row in zip(table, rows, strict=True):
        columns = ("parameter", "interval", "unit", "verdict", "reason")
        assert cells == [row[k] for k in columns if row[k]]


def test_page(media_run, rows):
    page = report_page(media_run)
    assert page.index("What to report") < page.index("<table")
    first = page.partition("<tbody>")[2].partition("</tbody>")[0]
    result = []
    for line in first.strip().splitlines():
        cells = [html.unescape(re.sub(r"<[^>]+>", "", c)) for c in line.split("</t")][1:5]
        result.append([c.split(">", 1)[-1] for c in cells])
    for cells, row in zip(result, rows, strict=True):
        assert cells == [row[k] for k in ("interval", "unit", "verdict", "reason")]


def test_latex_and_paragraphs(media_run, rows):
    latex, paragraph = latex_table(media_run), results_paragraph(media_run)
    body = latex.partition("\\midrule")[2].partition("\\bottomrule")[0].strip().splitlines()
    for line, row in zip(body, rows, strict=True):
        cells = [c.strip().removesuffix("\\\\").strip() for c in re.split(r"(?<!\\)&", line)][1:]
        plain = [re.sub(r"\\(.)", r"\1", c) for c in cells]
        assert plain == [row[k] for k in ("interval", "unit", "verdict", "reason")]
        if row["interval"] == DASH:
            assert row["parameter"] in paragraph.partition("did not identify")[2]
        else:
            with_unit = f"{row['interval']} {row['unit']}".strip()
            sentence = next(s for s in paragraph.split(". ") if s.startswith(row["parameter"]))
            assert row["verdict"] in sentence and f": {with_unit} (9" in sentence
    # no interval of a parameter that is not in the table, and none among the methods
    assert paragraph.count(" to ") == sum(" to " in row["interval"] for row in rows)
    assert not any(row["interval"] in methods(media_run) for row in rows if row["low"])
    assert f"% Results: {paragraph}" in latex and paragraph in html.unescape(report_page(media_run))


def test_only_one_table_has_stresses_to_report(media_run):
    table = pd.read_csv(media_run.path / "report-stresses.csv")
    all_of_them = media_run.result.determined.set_index(["quantity", "stretch_x", "stretch_y"])
    assert len(table) >= 4
    for row in table.to_dict("records"):
        own = all_of_them.loc[(row["quantity"], row["stretch_x"], row["stretch_y"])]
        assert row["low"] == pytest.approx(own["tissue_low_90"], rel=1e-6)
        assert row["high"] - row["low"] > own["high_90"] - own["low_90"]
    page = report_page(media_run)
    before, evidence = page.split('<h2 id="evidence">')
    assert "Cauchy stress x" in before
    assert "Cauchy stress x" not in evidence.partition('<h2 id="convergence">')[0]


def test_a_test_that_determines_little_says_so(media_run):
    """And what to do: the advice follows in the same line."""
    reported = [
        replace(r, verdict="not identified", low=math.nan, high=math.nan)
        for r in media_run.result.reported
    ]
    reported[3] = media_run.result.reported[3]
    poor = replace(media_run.result, reported=tuple(reported), advice="to narrow C1: pull more")
    assert media_run.result.low_information == ""
    assert poor.low_information.startswith("this test determines 1 of 7 parameters (alpha): ")
    assert replace(poor, state="tentative").low_information == ""
    poor_run = replace(media_run)
    poor_run.__dict__["result"] = poor
    message, page = closing_message(poor_run), report_page(poor_run)
    assert len(message.splitlines()) <= MOST_LINES
    assert f"{poor.low_information}; to narrow C1: pull more" in message
    assert "Most parameters are not determined." in page and "1 of 7 parameters" in page


def test_chains_that_have_not_converged_give_no_verdict_anywhere(media_run, tmp_path):
    judged = identify_draws(media_run.posterior(), media_run.draws, "tentative")
    assert {(r.verdict, r.reason) for r in judged.reported} == {
        ("no verdict", "chains have not converged")
    }
    # a run of an earlier version called them "not identified"
    record = as_record(replace(media_run.result, state="tentative"))
    for row in record["reported"]:
        row |= {"verdict": "not identified", "low": None, "high": None}
    again = result_from_record(record, media_run.law, media_run.quantities, tmp_path)
    assert {r.verdict for r in again.reported} == {"no verdict"}
    tentative = replace(media_run)
    tentative.__dict__["result"] = again
    assert "no verdict" in latex_table(tentative) and "not identified" not in latex_table(tentative)
    first = report_page(tentative).partition("<tbody>")[2].partition("</tbody>")[0]
    assert first.count("no verdict") == 7
    texts = [
        t.get_text() for ax in identifiability_figure(judged, again.rows).axes for t in ax.texts
    ]
    assert texts.count("no verdict") == 7


def test_figure(media_run, rows):
    judged = identify_draws(media_run.posterior(), media_run.draws, media_run.state)
    for width in (85.0, 180.0):
        figure = identifiability_figure(judged, media_run.result.rows, width_mm=width)
        texts = [t.get_text() for ax in figure.axes for t in ax.texts]
        verdicts = [t for t in texts if t in VERDICTS]
        assert verdicts == [row["verdict"] for row in rows]
        others = [one_line(t) for t in texts if t not in VERDICTS]
        for row in rows:
            unit = row["unit"] if row["interval"] != DASH else ""
            assert one_line(f"{row['interval']} {unit} {row['reason']}") in others


def test_comparison_and_study(media_run, rows, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(media_run.path, other)
    both = biaxbayes.compare([media_run, other], labels=["a", "b"])
    write_comparison(both, tmp_path / "compare")
    with (tmp_path / "compare" / "compare-report.csv").open(encoding="utf-8") as file:
        table = [r for r in csv.DictReader(file) if r["run"] == "a"]
    columns = ("parameter", "interval", "verdict", "reason")
    assert [[r[k] for k in columns] for r in table] == [[r[k] for k in columns] for r in rows]
    page = (tmp_path / "compare" / "compare.html").read_text(encoding="utf-8")
    for row in rows:
        assert f"<td>{row['interval']}</td>" in page
    study = {r["quantity"]: r for r in rows_of_run(media_run)}
    for row in rows:
        result = study[row["parameter"]]
        assert (result["reported"], result["verdict"]) == (row["interval"], row["verdict"])


def test_evidence_and_summary_have_the_same_quantiles(media_run):
    assert len(media_run.draws) > MAX_DIAGNOSTIC_DRAWS  # the evidence is judged by some of them
    columns = ["posterior_median", "posterior_q05", "posterior_q95"]
    evidence = media_run.result.identifiability.set_index("parameter")[columns].astype(float)
    summary = media_run.summary.set_index("parameter").loc[evidence.index, ["q50", "q05", "q95"]]
    np.testing.assert_allclose(evidence, summary, rtol=2e-5)


def test_digits():
    C1, alpha = (p for p in law_named("goh").parameters if p.name in ("C1", "alpha"))
    stretch = MOUNTING_PARAMETERS[0]
    nan = float("nan")
    assert interval_text(1.01493, 1.02118, stretch) == "1.0149 to 1.0212"
    assert interval_text(1.00712, nan, stretch) == "above 1.0071"
    assert interval_text(nan, 38.44, alpha) == "below 38.4"
    assert interval_text(33.07, 41.02, alpha) == "33.1 to 41.0"
    assert interval_text(0.1453, 27.11, C1) == "0.15 to 27"
    assert interval_text(nan, nan, C1) == DASH
