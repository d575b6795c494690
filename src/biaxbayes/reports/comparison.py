"""What comparisons of runs and of laws write: tables, figures, a page, and the terminal's text."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from biaxbayes.comparison.compare import WARNING, Comparison
from biaxbayes.comparison.law_weights import STACKED, LawComparison
from biaxbayes.errors import printable
from biaxbayes.figures.comparisons import (
    by_weight,
    forest_figure,
    law_bands_figure,
    law_misfit_figure,
    law_mounting_figure,
    matrix_figure,
)
from biaxbayes.figures.corner import overlay_figure
from biaxbayes.figures.style import figure_bytes, save_pictures
from biaxbayes.identifiability.reported import quantile_texts, report_rows, row_lines
from biaxbayes.parameters import STRETCH, Quantities
from biaxbayes.reports.study_page import with_unit
from biaxbayes.reports.templates import Row, embedded, page_template
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import aligned, atomic_write_text, make_folder, write_csv

# --- a comparison of runs ------------------------------------------------------------------------

MOST_OVERLAID = 6
IN_BOTH = "Identified or bounded in both runs"
NOT_IN_BOTH = "Not identified in both: differences are not of the tissue"


def write_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    """Write tables, figures (an overlay of at most six runs) and the page; return the paths."""
    written = [make_folder(folder) / f"compare-{name}.csv" for name in ("report", "distances")]
    for path, table in zip(written, (comparison.matrix(), comparison.distances), strict=True):
        write_csv(path, table, digits=6)
    figures = {"matrix": matrix_figure(comparison), "forest": forest_figure(comparison)}
    if len(comparison.members) <= MOST_OVERLAID:
        figures["overlay"] = overlay_figure(
            [m.draws for m in comparison.members],
            comparison.labels,
            known=comparison.members[0].posterior.quantities,
        )
    for stem, figure in figures.items():
        written += save_pictures(figure, folder, f"compare-{stem}")
    page = folder / "compare.html"
    atomic_write_text(page, comparison_page(comparison, figures))
    return [*written, page]


def comparison_page(comparison: Comparison, figures: Mapping[str, Figure]) -> str:
    """The page of a comparison of runs, with its figures by the stems of their files."""
    reported = [
        (
            member.label,
            [
                (row.quantity, row.median, row.interval, row.unit, row.verdict, row.reason)
                for row in report_rows(rows, member.posterior.quantities)
            ],
        )
        for member, rows in zip(comparison.members, comparison.reported, strict=True)
    ]
    return page_template("compare.html.jinja").render(
        labels=comparison.labels,
        laws=list(dict.fromkeys(m.posterior.law.name for m in comparison.members)),
        members=comparison.members,
        converged=comparison.converged,
        notes=comparison.notes,
        reported=reported,
        warning=WARNING,
        pairs=_pairs(comparison.distances),
        figures={name: embedded(figure_bytes(figure, "png")) for name, figure in figures.items()},
    )


def _pairs(distances: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of every pair of runs, split by whether both runs identify the quantity."""
    numbers = ("median_a", "median_b", "difference_q50", "difference_q05", "difference_q95")
    pairs = []
    for (a, b), table in distances.groupby(["run_a", "run_b"], sort=False):
        parts: dict[str, list[Row]] = {IN_BOTH: [], NOT_IN_BOTH: []}
        for row in table.to_dict("records"):
            cells = [f"{row[key]:.4g}" for key in numbers]
            cells += [f"{row['standardised']:+.1f}", f"{row['probability_b_greater']:.3f}"]
            cells.append(f"{row['kolmogorov']:.2f}")
            part = parts[IN_BOTH if row["identified_in_both"] else NOT_IN_BOTH]
            part.append((with_unit(_name_at_stretch(row), row["unit"]), *cells))
        pairs.append({"a": a, "b": b, "parts": parts})
    return pairs


def comparison_text(comparison: Comparison, folder: Path) -> str:
    """What each run reports, and the largest differences of what both of a pair identify."""
    lines = []
    for member, reported in zip(comparison.members, comparison.reported, strict=True):
        lines.append(f"{printable(member.label)}: medians, 90 % intervals and 95 % bounds")
        own = report_rows(reported, member.posterior.quantities)
        lines += [f"  {line}" for line in row_lines(own)]
    identified = comparison.distances[comparison.distances["identified_in_both"]]
    if len(identified):
        lines.append(
            "\nlargest differences of quantities that both runs identify or bound "
            "(90 % intervals; in common sd):"
        )
    for (a, b), rows in identified.groupby(["run_a", "run_b"], sort=False):
        most = rows.reindex(rows["standardised"].abs().sort_values(ascending=False).index).head(4)
        cells = []
        for r in most.to_dict("records"):
            unit = "" if r["unit"] == "1" else str(r["unit"])
            ends = f"{r['difference_q05']:.4g} to {r['difference_q95']:.4g} {unit}".rstrip()
            cells.append([_name_at_stretch(r), ends, f"{r['standardised']:+.1f}"])
        lines.append(f"  {printable(str(b))} minus {printable(str(a))}")
        lines += [f"    {line}" for line in aligned(cells, right=(2,))]
    lines += [f"note: {note}" for note in (*comparison.notes, WARNING)]
    return "\n".join([*lines, f"\n{folder / 'compare.html'}"])


def _name_at_stretch(row: Mapping[Any, Any]) -> str:
    """A quantity, of a curve with its total stretch."""
    at = row["total_stretch"]
    return str(row["quantity"]) + ("" if pd.isna(at) else f" at {at:.4g}")


# --- laws compared on a specimen -----------------------------------------------------------------


def write_law_comparison(compared: LawComparison, specimen: Specimen, folder: Path) -> None:
    """Write tables, draws and bands of the mixture, figures and the page."""
    tables = {
        "laws.csv": compared.table,
        "left-out.csv": compared.parts,
        "stacked-draws.csv": compared.draws,
        "stacked-bands.csv": compared.bands,
    }
    for name, table in tables.items():
        write_csv(folder / name, table, digits=8)
    drawn = {
        "law-misfit": law_misfit_figure(compared),
        "law-mounting": law_mounting_figure(compared),
        "stacked-bands": law_bands_figure(compared, specimen),
    }
    figures = {stem: figure for stem, figure in drawn.items() if figure is not None}
    for stem, figure in figures.items():
        save_pictures(figure, folder, stem)
    atomic_write_text(folder / "laws.html", laws_page(compared, figures))


def laws_page(compared: LawComparison, figures: Mapping[str, Figure]) -> str:
    """The page of a comparison of laws, with its figures by the stems of their files."""
    table = compared.table
    laws = table[table["law"] != STACKED]
    best = laws.sort_values("left_out_rms_kPa").iloc[0]
    mixture = table.set_index("law").loc[STACKED]
    rows = by_weight(table).to_dict("records")
    stretches = [q for q in STRETCHES if f"{q.name}_q50" in table]
    return page_template("laws.html.jinja").render(
        specimen=compared.specimen,
        best=(
            f"{best['law']} predicts left-out parts best: its rms error is "
            f"{best['left_out_rms_kPa']:.3g} kPa, that of the mixture of all laws "
            f"{mixture['left_out_rms_kPa']:.3g} kPa."
        ),
        laws=[_law_row(row) for row in rows],
        left_out=sorted(compared.left_out.items()),
        stretches=stretches,
        mounting=[
            (_law_name(row), *(f"{m}, {low} to {high}" for m, low, high in stretch_texts(row)))
            for row in rows
            if stretch_texts(row)
        ],
        parts=_part_rows(compared.parts),
        figures={name: embedded(figure_bytes(figure, "png")) for name, figure in figures.items()},
    )


def laws_text(compared: LawComparison, folder: Path) -> str:
    """The laws by weight, the mixture last, with the mounting stretches."""
    stretches = [q.name for q in STRETCHES if f"{q.name}_q50" in compared.table]
    lines = [
        ["", "rms_kPa", "left out", "density", "weight (range)", *stretches],
        ["", "kPa", "kPa", "nats", "", *(["median, 90 %"] * len(stretches))],
    ]
    for row in by_weight(compared.table).to_dict("records"):
        name, state, *numbers = map(str, _law_row(row))
        if not numbers[1]:  # nothing was predicted
            lines.append([name, *[""] * 4, state])
            continue
        mounting = [f"{m}, {low} to {high}" for m, low, high in stretch_texts(row)]
        lines.append([name, *numbers, *mounting])
    return "\n".join(aligned(lines, right=range(1, 4))) + (
        "\n\nrms: error of the fit to all rows; left out: error of predicting the parts left out;\n"
        "density: log predictive density of these, larger is better (2.3 nats more: ten times as\n"
        "probable); weights: fractions of the mixture that predicts best (stacking). The mixture\n"
        "predicts stresses; below the tested stretches, and so for the mounting stretch, its\n"
        f"weights are untested.\n\nopen {folder / 'laws.html'}; tables and figures are beside it"
    )


STRETCHES = Quantities(()).of_kind(STRETCH)


def stretch_texts(row: Mapping[Any, Any]) -> list[tuple[str, str, str]]:
    """Median and ends of the 90 % interval of each mounting stretch in a row of laws.csv."""
    out = []
    for q in STRETCHES:
        median, low, high = (row.get(f"{q.name}_q{k}", float("nan")) for k in ("50", "05", "95"))
        if median == median:
            out.append(quantile_texts(median, low, high, q.parameter))
    return out


def _law_name(row: Mapping[Any, Any]) -> str:
    return "mixture" if row["law"] == STACKED else str(row["law"])


def _number(value: Any, form: str) -> str:
    return format(value, form) if value == value else ""


def _law_row(row: dict[Any, Any]) -> Row:
    weight = _number(row.get("weight"), ".2f")
    low, high = row.get("weight_low"), row.get("weight_high")
    if weight and low == low and low is not None:
        weight += f" ({low:.2f} to {high:.2f})"
    return (
        _law_name(row),
        row["state"],
        _number(row["rms_kPa"], ".3g"),
        _number(row.get("left_out_rms_kPa"), ".3g"),
        _number(row.get("left_out_density_nats"), ".1f"),
        weight,
    )


def _part_rows(parts: pd.DataFrame) -> list[Row]:
    out: list[Row] = []
    for name, rows in parts.groupby("part", sort=False):
        mixture = rows[rows["law"] == STACKED].iloc[0]
        best = rows[rows["law"] != STACKED].sort_values("left_out_rms_kPa").iloc[0]
        cells = [
            f"{mixture['left_out_rms_kPa']:.3g}",
            f"{best['law']}, {best['left_out_rms_kPa']:.3g}",
            f"{mixture['readings']:.0f}",
            f"{100 * mixture['band_coverage']:.0f} %",
            f"{mixture['band_width']:.3g}",
        ]
        out.append((str(name), *cells))
    return out
