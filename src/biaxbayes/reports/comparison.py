"""A comparison as files: tables, figures at print size and a page that opens anywhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

import biaxbayes
from biaxbayes.comparison.compare import WARNING, Comparison
from biaxbayes.csv_tables import write_csv
from biaxbayes.errors import InputError
from biaxbayes.figures.style import figure_bytes
from biaxbayes.reports.glossary import chosen_terms
from biaxbayes.reports.page import embedded, page_template
from biaxbayes.reports.study_page import named, unit_text
from biaxbayes.text_files import atomic_write_bytes, atomic_write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["MOST_OVERLAID", "write_comparison"]

MOST_OVERLAID = 6
TERMS = (
    "posterior",
    "prior",
    "median, 90 % interval",
    "determined",
    "contraction",
    "verdict",
    "identified",
    "one-sided",
    "only in combination",
    "not identified",
    "prior-dominated",
    "no verdict, fixed",
    "edge, hypothesis",
    "mounting stretch",
    "within the law",
    "stated of the tissue",
    "structure tensor",
    "tangent stiffness, small-strain stiffness",
    "Cauchy stress, nominal stress",
    "difference in sd",
    "P(larger)",
    "Kolmogorov",
    "overlay",
    "corner plot",
    "converged, tentative, unusable",
)
"""Of the glossary, what the page speaks of."""


def write_comparison(found: Comparison, folder: Path) -> list[Path]:
    """Write the tables, figures and the page of a comparison.

    Parameters
    ----------
    found : Comparison
    folder : Path
        Made where it does not exist.

    Returns
    -------
    list of Path
        What was written. More than six runs get no overlay, which nobody could read.
    """
    from biaxbayes.figures.compare import forest_figure, matrix_figure
    from biaxbayes.figures.run.corner import overlay_figure

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=folder) from None
    written = []
    tables = {"compare-identifiability": found.matrix(), "compare-distances": found.distances}
    for stem, table in tables.items():
        path = folder / f"{stem}.csv"
        write_csv(path, table, digits=6)
        written.append(path)
    figures = {"matrix": matrix_figure(found), "forest": forest_figure(found)}
    if len(found.members) <= MOST_OVERLAID:
        figures["overlay"] = overlay_figure(
            [m.draws for m in found.members],
            found.labels,
            known=found.members[0].posterior.quantities,
        )
    for stem, figure in figures.items():
        for suffix in ("pdf", "png"):
            path = folder / f"compare-{stem}.{suffix}"
            atomic_write_bytes(path, figure_bytes(figure, suffix))
            written.append(path)
    page = folder / "compare.html"
    atomic_write_text(page, _page(found, figures))
    return [*written, page]


def _page(found: Comparison, figures: dict[str, Figure]) -> str:
    return page_template("compare.html.jinja").render(
        labels=found.labels,
        laws=list(dict.fromkeys(m.posterior.law.name for m in found.members)),
        members=found.members,
        converged=found.converged,
        notes=found.notes,
        verdicts=[
            {"label": label, "words": verdicts.in_words()}
            for label, verdicts in zip(found.labels, found.verdicts, strict=True)
        ],
        warning=WARNING,
        glossary=chosen_terms(*TERMS),
        pairs=_pairs(found.distances),
        version=biaxbayes.__version__,
        figures={name: embedded(figure_bytes(figure, "png")) for name, figure in figures.items()},
    )


def _pairs(distances: pd.DataFrame) -> list[dict[str, Any]]:
    out = []
    for (a, b), rows in distances.groupby(["run_a", "run_b"], sort=False):
        known = rows["determined_in_both"].astype(bool)
        parts = [
            {"title": "Determined in both runs", "rows": _rows(rows[known])},
            {
                "title": "Not determined in both: no difference of tissue",
                "rows": _rows(rows[~known]),
            },
        ]
        out.append({"a": a, "b": b, "parts": parts})
    return out


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    out = []
    for row in table.to_dict("records"):
        name = str(row["quantity"])
        if pd.notna(row["total_stretch"]):
            name += f" at {row['total_stretch']:.4g}"
        numbers = ("median_a", "median_b", "difference_q50", "difference_q05", "difference_q95")
        cells = [f"{row[key]:.4g}" for key in numbers]
        cells += [f"{row['standardised']:+.1f}", f"{row['probability_b_greater']:.3f}"]
        cells.append(f"{row['kolmogorov']:.2f}")
        out.append({"quantity": named(name), "unit": unit_text(row["unit"]), "cells": cells})
    return out
