"""Laws weighed on a specimen as a page that opens anywhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import pandas as pd

import biaxbayes
from biaxbayes.comparison.law_weights import STACKED, LawComparison
from biaxbayes.figures.style import figure_bytes
from biaxbayes.identifiability.stated import MEASURED, Stated, cure
from biaxbayes.parameters import Quantities
from biaxbayes.reports.glossary import chosen_terms
from biaxbayes.reports.page import embedded, page_template

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["laws_page", "stated_rows"]

TERMS = (
    "material laws",
    "residual, misfit",
    "weight of a law",
    "density of what was left out",
    "nats",
    "effective readings",
    "mounting stretch",
    "stated of the tissue",
    "median, 90 % interval",
    "credible band",
    "predictive band",
    "converged, tentative, unusable",
)
"""Of the glossary, what the page speaks of."""


def laws_page(compared: LawComparison, figures: Mapping[str, Figure]) -> str:
    """Give the page of a comparison of laws.

    Parameters
    ----------
    compared : LawComparison
    figures : mapping of str to Figure
        By the stems of their files.
    """
    table = compared.table
    laws = table[table["law"] != STACKED]
    foretell = laws.sort_values("left_out_rms").iloc[0]
    mixture = table.set_index("law").loc[STACKED]
    stated = stated_rows(compared.stated)
    open_ends = [row["quantity"].name for row in stated if not row["is_value"]]
    return page_template("laws.html.jinja").render(
        specimen=compared.specimen,
        best=(
            f"{foretell['law']} foretells best what it was not shown: it misses by "
            f"{foretell['left_out_rms']:.3g} kPa (root mean square); the mixture of all laws by "
            f"{mixture['left_out_rms']:.3g} kPa."
        ),
        laws=[_law_row(row) for row in _heaviest_first(table)],
        left_out=sorted(compared.left_out.items()),
        stated=stated,
        cure=cure(open_ends) if open_ends else "",
        parts=_part_rows(compared.parts),
        glossary=chosen_terms(*TERMS),
        version=biaxbayes.__version__,
        figures={name: embedded(figure_bytes(figure, "png")) for name, figure in figures.items()},
    )


def _heaviest_first(table: pd.DataFrame) -> list[dict[Any, Any]]:
    laws = table[table["law"] != STACKED].sort_values("weight", ascending=False, kind="stable")
    return [*laws.to_dict("records"), *table[table["law"] == STACKED].to_dict("records")]


def _number(value: Any, form: str) -> str:
    return format(value, form) if value == value else ""


def _law_row(row: dict[Any, Any]) -> dict[str, Any]:
    weight = _number(row.get("weight"), ".2f")
    low, high = row.get("weight_low"), row.get("weight_high")
    if weight and low == low and low is not None:
        weight += f" ({low:.2f} to {high:.2f})"
    cells = [
        _number(row["rms"], ".3g"),
        _number(row.get("left_out_rms"), ".3g"),
        _number(row.get("left_out_density"), ".1f"),
        weight,
    ]
    name = "mixture" if row["law"] == STACKED else row["law"]
    return {"law": name, "state": row["state"], "cells": cells}


def stated_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """What is stated of each mounting stretch, in words.

    Parameters
    ----------
    table : DataFrame
        Of a :class:`~biaxbayes.comparison.law_weights.LawComparison`.
    """
    known, out = Quantities(()), []
    for row in table.to_dict("records"):
        stated = Stated(row["stated_low"], row["stated_high"], row["stated_reason"])
        quantity = known[row["quantity"]]
        words = stated.in_words(quantity.parameter)
        out.append(
            {
                "quantity": quantity,
                "words": words if words != "nothing" else "nothing is stated",
                "reason": stated.reason,
                "is_value": stated.is_value or stated.reason == MEASURED,
            }
        )
    return out


def _part_rows(parts: pd.DataFrame) -> list[dict[str, Any]]:
    out = []
    for name, rows in parts.groupby("part", sort=False):
        mixture = rows[rows["law"] == STACKED].iloc[0]
        best = rows[rows["law"] != STACKED].sort_values("left_out_rms").iloc[0]
        cells = [
            f"{mixture['left_out_rms']:.3g}",
            f"{best['law']}, {best['left_out_rms']:.3g}",
            f"{mixture['readings']:.0f}, worth {mixture['effective_readings']:.2g}",
            f"{100 * mixture['band_coverage']:.0f} %",
            f"{mixture['band_width']:.3g}",
        ]
        out.append({"part": name, "cells": cells})
    return out
