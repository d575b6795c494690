"""One set of numbers: whoever writes about a run gives the same quantiles with the same digits."""

import csv
import html
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.derived.determined import determined
from biaxbayes.derived.known import known_table
from biaxbayes.errors import InputError
from biaxbayes.figures.identifiability import identifiability_figure
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.identifiability.verdict import VERDICTS
from biaxbayes.laws import law_named
from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import MOUNTING_PARAMETERS
from biaxbayes.report_table import DASH, interval_texts
from biaxbayes.reports.methods import closing_message, latex_table
from biaxbayes.reports.run_page import REPORT_CAPTION, report_page
from biaxbayes.runs.run_result import as_record, further_test, result_from_record
from biaxbayes.specimens.specimen_file import read_specimen

DATA = Path(__file__).parents[1] / "data"


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
    return interval_texts(*(float(row[k]) for k in ("q50", "q05", "q95")), parameter)


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
    first = lines.index("Parameters") + 1
    table = [re.split(r" {2,}", line) for line in lines[first : first + len(rows)]]
    for cells, row in zip(table, rows, strict=True):
        wanted = [row["parameter"], texts(run, row)[0], *(row[k] for k in COLUMNS if row[k])]
        assert cells == wanted


def test_page(run, rows):
    page = report_page(run)
    assert page.index("What to report") < page.index("<table")
    table = page.partition(REPORT_CAPTION)[2]
    first = table.partition("<tbody>")[2].partition("</tbody>")[0]
    result = []
    for line in first.strip().splitlines():
        cells = [html.unescape(re.sub(r"<[^>]+>", "", c)) for c in line.split("</t")][1:6]
        result.append([c.split(">", 1)[-1] for c in cells])
    for cells, row in zip(result, rows, strict=True):
        assert cells == [texts(run, row)[0], *(row[k] for k in COLUMNS)]


def test_the_corner_of_two_runs_has_the_interval_or_bound_of_each(run):
    figure = biaxbayes.plot(run, "corner", compare=run)
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    for row in run.result.reported:
        if row.bound:
            assert sum(f"({row.interval})" in entry for entry in entries) == 2
    unknown = sum(row.verdict == "not identified" for row in run.result.reported)
    assert sum("not identified" in entry for entry in entries) == 2 * unknown


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
    predicted = biaxbayes.predict(run, p.stretch, stress="piola", relative_to="mounted").iloc[-1]
    for axis, row in zip("xy", ends.to_dict("records"), strict=True):
        assert row["quantity"].startswith(f"nominal stress {axis}")
        width = row["high"] - row["low"]
        for end, name in (("low", "credible_low"), ("median", "median"), ("high", "credible_high")):
            assert predicted[f"piola_{axis}_kPa_{name}"] == pytest.approx(row[end], abs=0.3 * width)


def test_what_is_known_comes_before_the_parameters(run):
    """Stresses, tangent stiffnesses of the law and their ratio, as the draws have them."""
    lines, page = closing_message(run).splitlines(), report_page(run)
    known = [re.split(r" {2,}", line) for line in lines[: lines.index("Parameters")]]
    cells = {row[0]: row[1:] for row in known if len(row) == 3}
    assert list(cells)[1:] == [
        "nominal stress x (kPa)", "nominal stress y (kPa)", "tangent stiffness x (kPa)",
        "tangent stiffness y (kPa)", "stiffness x over y",
    ]  # fmt: skip
    assert page.index("tangent stiffness x (kPa)") < page.index(REPORT_CAPTION)
    x, y = run.specimen.protocols[0].stretch.max(axis=0)
    draws = run.draws.iloc[:: -(-len(run.draws) // 1000)]
    lm = draws[["mounting_stretch_x", "mounting_stretch_y"]].to_numpy()
    step, material = 1e-5, run.law.material(draws)

    def stress(x, y):
        return np.array(material.cauchy(x * lm[:, :1], y * lm[:, 1:]))[:, :, 0]

    by_x = (stress(x * (1 + step), y) - stress(x * (1 - step), y))[0] / (2 * step)
    by_y = (stress(x, y * (1 + step)) - stress(x, y * (1 - step)))[1] / (2 * step)
    expected = {"stiffness x over y": by_x / by_y, "tangent stiffness x (kPa)": by_x}
    for name, values in expected.items():
        said = [float(v) for v in re.findall(r"[\d.]+", cells[name][-1])]
        width = np.quantile(values, 0.95) - np.quantile(values, 0.05)
        assert said == pytest.approx(np.quantile(values, [0.5, 0.05, 0.95]), abs=0.1 * width)


def test_a_physiological_state_in_the_header_is_reported(media_run, tmp_path):
    """Its stiffness is that of the draws."""
    text = (DATA / "donor2-media.csv").read_text(encoding="utf-8")
    stated = tmp_path / "stated.csv"
    stated.write_text("# physiological_stretch_x: 1.15\n" + text, encoding="utf-8")
    with pytest.raises(InputError, match="physiological_stretch_y"):
        read_specimen(stated)
    both = "# physiological_stretch_x: 1.15\n# physiological_stretch_y: 1.1\n"
    stated.write_text(both + text, encoding="utf-8")
    table = determined(Posterior(read_specimen(stated)), media_run.draws)
    lines = [re.split(r" {2,}", line) for line in known_table(table).lines()]
    assert lines[0][-1] == "in the body (total 1.15, 1.1)"
    cells = {line[0]: line[-1] for line in lines}
    assert cells["nominal stress x (kPa)"] == DASH
    tangent = media_run.law.material(media_run.draws).cauchy_by_log_stretch(1.15, 1.1)[0, 0, :, 0]
    said = [float(v) for v in re.findall(r"[\d.]+", cells["tangent stiffness x (kPa)"])]
    width = np.quantile(tangent, 0.95) - np.quantile(tangent, 0.05)
    assert said == pytest.approx(np.quantile(tangent, [0.5, 0.05, 0.95]), abs=0.1 * width)


@pytest.mark.parametrize(
    ("strips", "said"),
    [
        ((), "cut two strips, along x and y, beside the square"),
        (("x",), "cut a strip along y beside the square"),
        (("x", "y"), "`biaxbayes design RUN` ranks tests"),
    ],
)
def test_advice_does_not_ask_for_strips_that_are_there(media_run, strips, said):
    square = media_run.specimen
    pieces = tuple(read_specimen(DATA / "pieces" / f"strip-{axis}.csv") for axis in strips)
    posterior = Posterior(replace(square, further=pieces))
    advice = further_test(posterior)
    assert said in advice and "biaxbayes design RUN" in advice
    assert ("strip" in advice) == (len(strips) < 2)


def test_stresses_at_total_stretches_are_given_whatever_the_verdicts(run):
    for table in (run.result.determined, run.result.stresses):
        assert table["quantity"].str.startswith("Cauchy stress").any()


def test_a_test_that_determines_little_says_so(media_run):
    """And what to do: one line of advice ends the message."""
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
    low = poor.low_information
    assert message.index("T" + low[1:]) < message.index("To narrow C1: pull more")
    assert message.splitlines()[-2] == "To narrow C1: pull more"
    assert "Most parameters are not determined." in page and "1 of 7 parameters" in page


def test_chains_that_have_not_converged_give_no_verdict_and_no_number_anywhere(media_run, tmp_path):
    judged = identify_draws(media_run.posterior(), media_run.draws, "tentative")
    assert {(r.verdict, r.reason) for r in judged.reported} == {
        ("no verdict", "chains have not converged")
    }
    assert all(math.isnan(v) for r in judged.reported for v in (r.median, r.low, r.high))
    record = as_record(replace(media_run.result, state="tentative", reported=judged.reported))
    again = result_from_record(record, media_run.law, media_run.quantities, tmp_path)
    assert {(row.text, row.interval) for row in again.reported} == {(DASH, DASH)}
    tentative = replace(media_run)
    tentative.__dict__["result"] = again
    assert "no verdict" in latex_table(tentative) and "not identified" not in latex_table(tentative)
    first = report_page(tentative).partition("<tbody>")[2].partition("</tbody>")[0]
    assert first.count("no verdict") == 7
    texts = [
        t.get_text() for ax in identifiability_figure(judged, again.reported).axes for t in ax.texts
    ]
    assert texts.count("no verdict") == 7


def test_the_contraction_of_the_figure_is_that_of_the_page(media_run):
    judged = identify_draws(media_run.posterior(), media_run.draws, "converged")
    figure = identifiability_figure(judged, judged.reported)
    drawn = [t.get_text() for ax in figure.axes for t in ax.texts]
    page = report_page(media_run)
    for p in judged.parameters:
        text = f"{100.0 * min(max(p.diagnostics.contraction, 0.0), 0.999):.3g} %"
        assert text in drawn and f">{text}<" in page, p.scale.parameter.name


def test_digits():
    """Two of the width of the interval; of a range of decades two of each number."""
    C1, alpha, kappa = (law_named("goh").parameter(n) for n in ("C1", "alpha", "kappa"))
    stretch = MOUNTING_PARAMETERS[0]
    assert interval_texts(1.01802, 1.01493, 1.02118, stretch) == ("1.0180", "1.0149", "1.0212")
    assert interval_texts(38.44, 33.07, 41.02, alpha) == ("38.4", "33.1", "41.0")
    assert interval_texts(2.468, 0.1453, 27.11, C1) == ("2.5", "0.15", "27")
    assert interval_texts(6.5, 2.6e-20, 6.6, C1) == ("6.5", "0", "6.6")
    assert interval_texts(5.0, 1.0, math.inf, C1) == ("5", "1", "inf")
    assert interval_texts(100.0, 1.0, 1e12, C1) == ("100", "1", "1e+12")
    # no end of a scale, and no median, has fewer than two significant digits
    assert interval_texts(46.2, 24.8, 148.0, C1) == ("46", "25", "150")
    assert interval_texts(15.9, 9.6, 71.3, C1) == ("16", "9.6", "71")
    assert interval_texts(1234.0, 1100.0, 1420.0, C1) == ("1230", "1100", "1420")
    assert interval_texts(0.2, 0.2, 0.2, kappa) == (kappa.number(0.2),) * 3
    # a range that is not of a scale has no decades
    assert interval_texts(0.0964, 0.0096, 0.2757, kappa) == ("0.10", "0.01", "0.28")
    # the median never lies outside its interval, to the digit
    rng = np.random.default_rng(1)
    for _ in range(500):
        low, median, high = np.sort(rng.lognormal(0.0, 2.0, 3))
        for parameter in (C1, alpha, stretch):
            middle, first, last = map(float, interval_texts(median, low, high, parameter))
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
