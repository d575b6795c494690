"""Pages on compared runs and compared laws, with tables and figures at print size."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from biaxbayes.comparison.compare import WARNING, Comparison
from biaxbayes.comparison.law_weights import STACKED, LawComparison
from biaxbayes.errors import InputError
from biaxbayes.figures.comparisons import by_weight, forest_figure, matrix_figure
from biaxbayes.figures.corner import overlay_figure
from biaxbayes.figures.style import figure_bytes, save_pictures
from biaxbayes.identifiability.reported import quantile_texts, report_rows
from biaxbayes.parameters import STRETCH, Quantities
from biaxbayes.reports.study_page import with_unit
from biaxbayes.reports.templates import Row, embedded, page_template
from biaxbayes.text_files import atomic_write_text, write_csv

# --- a comparison of runs ------------------------------------------------------------------------

MOST_OVERLAID = 6
IN_BOTH = "Identified or bounded in both runs"
NOT_IN_BOTH = "Not identified in both: differences are not of the tissue"


def write_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    """Write tables, figures (an overlay of at most six runs) and the page; return the paths."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=folder) from None
    written = [folder / "compare-report.csv", folder / "compare-distances.csv"]
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
            name = str(row["quantity"])
            if pd.notna(row["total_stretch"]):
                name += f" at {row['total_stretch']:.4g}"
            cells = [f"{row[key]:.4g}" for key in numbers]
            cells += [f"{row['standardised']:+.1f}", f"{row['probability_b_greater']:.3f}"]
            cells.append(f"{row['kolmogorov']:.2f}")
            part = parts[IN_BOTH if row["identified_in_both"] else NOT_IN_BOTH]
            part.append((with_unit(name, row["unit"]), *cells))
        pairs.append({"a": a, "b": b, "parts": parts})
    return pairs


# --- laws compared on a specimen -----------------------------------------------------------------


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
