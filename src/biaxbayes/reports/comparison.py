"""What a comparison of runs writes: tables, figures, a page, and the terminal's text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from biaxbayes.comparison.compare import WARNING, Comparison
from biaxbayes.errors import printable
from biaxbayes.figures.comparisons import forest_figure, matrix_figure
from biaxbayes.figures.corner import overlay_figure
from biaxbayes.figures.style import figure_bytes, save_pictures
from biaxbayes.identifiability.reported import report_table
from biaxbayes.parameters import Quantity
from biaxbayes.report_table import Column, Row, Table, interval_texts, number, quantiles_of
from biaxbayes.reports.page import (
    Block,
    Section,
    captioned,
    embedded,
    notice,
    page_html,
    paragraph,
    prose,
    remarks,
    subheading,
    titled,
)
from biaxbayes.reports.study_page import UNIT, named
from biaxbayes.reports.text import VERDICT_TERMS
from biaxbayes.text_files import atomic_write_text, make_folder, write_csv

PAGE = "compare.html"
TERMS = (
    *("posterior", "prior", "median, 90 % interval", *VERDICT_TERMS, "mounting stretch"),
    *("structure tensor", "tangent stiffness, small-strain stiffness"),
    *("Cauchy stress, nominal stress", "in sd", "P(larger)", "Kolmogorov", "overlay"),
    *("corner plot", "converged, tentative, unusable"),
)


def write_comparison(comparison: Comparison, folder: Path) -> None:
    """Write tables, figures (an overlay of at most six runs) and the page."""
    make_folder(folder)
    write_csv(folder / "compare-report.csv", comparison.matrix(), digits=6)
    write_csv(folder / "compare-distances.csv", comparison.distances, digits=6)
    figures = {"matrix": matrix_figure(comparison), "forest": forest_figure(comparison)}
    if len(comparison.members) <= 6:
        figures["overlay"] = overlay_figure(
            [m.draws for m in comparison.members],
            comparison.labels,
            known=comparison.members[0].posterior.quantities,
        )
    for stem, figure in figures.items():
        save_pictures(figure, folder, f"compare-{stem}")
    atomic_write_text(folder / PAGE, comparison_page(comparison, figures))


def distance_tables(distances: pd.DataFrame) -> list[Table]:
    """How far apart each pair of runs is."""
    pairs = distances.groupby(["run_a", "run_b"], sort=False)
    return [_distance_table(str(a), str(b), rows) for (a, b), rows in pairs]


def _distance_table(a: str, b: str, rows: pd.DataFrame) -> Table:
    def quantity(r: Row) -> Quantity | str:
        at: str = "" if pd.isna(r["total_stretch"]) else f" at {r['total_stretch']:.4g}"
        return named(f"{r['quantity']}{at}")

    def median(name: str, r: Row) -> str:
        # with the digits of the difference, but two significant ones at least
        width = min(abs(r["difference_q95"] - r["difference_q05"]), abs(r[name]))
        return number(r[name], 0.0, width)

    def difference(r: Row) -> tuple[str, str, str]:
        return interval_texts(*quantiles_of(r, "difference"))

    def interval(r: Row) -> str:
        return " to ".join(difference(r)[1:])

    def determined(r: Row) -> str:
        known = [label for label, side in ((a, "a"), (b, "b")) if r[f"identified_in_{side}"]]
        return ("by neither", f"by {''.join(known)}", "by both")[len(known)]

    columns = [
        Column("quantity", "Quantity", format=quantity),
        UNIT,
        Column("median_a", a, format=partial(median, "median_a"), number=True),
        Column("median_b", b, format=partial(median, "median_b"), number=True),
        Column("difference_q50", "Difference", format=lambda r: difference(r)[0], number=True),
        Column("difference_q05", "90 % interval", format=interval, number=True),
        Column("standardised", "In sd", format="+.1f", number=True, term=True),
        Column("probability_b_greater", "P(larger)", format=".3f", number=True, term=True),
        Column("kolmogorov", "Kolmogorov", format=".2f", number=True, term=True),
        Column("identified_in_both", "Determined", format=determined),
    ]
    return Table(columns, rows, f"{b} minus {a}")


def comparison_page(comparison: Comparison, drawings: Mapping[str, Figure]) -> str:
    """The page of a comparison of runs, with its figures by the stems of their files."""
    figures = {name: embedded(figure_bytes(figure, "png")) for name, figure in drawings.items()}
    states = [f"{m.label} is {m.state}" for m in comparison.members if m.state != "converged"]
    text = f"{', '.join(states)}. Nothing is reported of its parameters."
    about = prose("One 90 % interval or 95 % bound per parameter, with its [verdict].")
    report: list[Block | None] = [
        notice("tentative", "Not every run has converged:", text=text) if states else None,
        remarks("These runs differ in more than the tissue.", comparison.notes),
        paragraph(about),
    ]
    for label, rows in zip(comparison.labels, comparison.reported, strict=True):
        caption = f"90 % intervals and 95 % bounds of {label}"
        report += [subheading(label), report_table(rows, f"What {label} reports", caption)]
    alt = "Verdict and reported interval of every parameter of every run"
    report.append(captioned(figures["matrix"], alt, "The same at a glance."))
    forest = prose(
        "Thick: 50 % of the posterior; thin: 90 %, one-sided where the draws pile up at a limit of "
        "the range. H is the share of the fibres along each axis ([structure tensor]); c with two "
        "indices is the [stiffness]: how much the [Cauchy stress] in the direction of the first "
        "grows with the logarithm of the stretch in that of the second; stretches are from the "
        "unloaded state, the same in both directions."
    )
    about = prose(
        "[In sd]: how far apart, in units of the common width. [P(larger)]: probability that the "
        "run named first is larger. [Kolmogorov]: 0 for equal distributions, 1 without overlap; at "
        "1 no correlation of parameters within a run explains the difference. Determined: by the "
        "runs that identify or bound the quantity. Stretches are equibiaxial, from the unloaded "
        "state."
    )
    distances: list[Block] = [notice("tentative", WARNING), paragraph(about)]
    for table in distance_tables(comparison.distances):
        distances += titled(table)
    overlay: list[Block] = []
    if "overlay" in figures:
        alt = "Pairwise posteriors of the runs over one another"
        caption = (
            "Every parameter (diagonal) and every pair, one colour per run. A narrow slanted cloud "
            "is a correlated pair."
        )
        overlay = [captioned(figures["overlay"], alt, caption)]
    files = "compare-report.csv: what each run reports. compare-distances.csv: every difference."
    laws = ", ".join(dict.fromkeys(m.posterior.law.name for m in comparison.members))
    alt = "Posterior of every quantity in every run"
    sections = [
        Section("report", "What each run reports", report),
        Section("intervals", "Posteriors", [captioned(figures["forest"], alt, forest)]),
        Section("distances", "How far apart the runs are", distances),
        Section("overlay", "Joint posteriors", overlay),
        Section("files", "Files", [paragraph(files)]),
    ]
    return page_html(
        "comparison",
        ", ".join(comparison.labels),
        f"{len(comparison.labels)} runs side by side: what their tests say of the parameters of "
        f"the material law ({laws}) and of the mounting stretches",
        sections,
        TERMS,
    )


def comparison_text(comparison: Comparison, folder: Path) -> str:
    """What each run reports, and the four largest differences of every pair."""
    lines = []
    for label, reported in zip(comparison.labels, comparison.reported, strict=True):
        lines.append(f"{printable(label)}: medians, 90 % intervals and 95 % bounds")
        lines += [f"  {line}" for line in report_table(reported).lines(heads=False)]
    differences = comparison.distances if comparison.converged else comparison.distances[:0]
    if len(differences):
        lines.append("\nlargest differences, in units of the common width:")
    order = differences["standardised"].abs().sort_values(ascending=False).index
    for table in distance_tables(differences.reindex(order)):
        most = replace(table, rows=table.rows.head(4)).without("kolmogorov")
        lines += [f"  {printable(table.label)}", *(f"    {line}" for line in most.lines())]
    lines += [f"note: {note}" for note in (*comparison.notes, WARNING)]
    return "\n".join([*lines, f"\n{folder / PAGE}"])
