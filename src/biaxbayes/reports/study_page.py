"""study.html, all specimens of a study on one page, and the tables and figure beside it."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.comparison.compare import WARNING
from biaxbayes.figures.quantities import number
from biaxbayes.identifiability.verdict import FIXED
from biaxbayes.laws import all_parameters
from biaxbayes.parameters import DIMENSION, LOAD, MATERIAL, STRETCH, Quantities, Quantity
from biaxbayes.reports.page import page_template, pictures
from biaxbayes.reports.words import VERDICT_TERMS, chosen_terms, cut, derived_words
from biaxbayes.studies.result import StudyResult
from biaxbayes.text_files import atomic_write_bytes, atomic_write_text, write_csv

FIGURE = "study-specimens"
TERMS = (
    "posterior",
    "prior",
    "median, 90 % interval",
    "mounting stretch",
    *VERDICT_TERMS,
    "converged, tentative, unusable",
    "structure tensor",
    "tangent stiffness, small-strain stiffness",
    "mean",
    "sd between",
    "factor",
    "above zero, below zero",
)
"""Of the glossary, what the page speaks of."""
WIDE = 8.0
DASH = "–"
KNOWN_QUANTITIES = Quantities(all_parameters())
"""What the names of a study's tables are."""


def study_page(result: StudyResult) -> str:
    """The page as HTML: no scripts, no network; the links lead to the reports of the runs.

    Parameters
    ----------
    result : StudyResult
        Its folder holds the figure.
    """
    states = result.states
    total = sum(states.values())
    shown = [q.name for q in KNOWN_QUANTITIES.judged()]
    names = [n for n in shown if (result.table["quantity"] == n).any()]
    return page_template("study.html.jinja").render(
        name=cut(result.name),
        total=total,
        converged=states.get("converged", 0),
        states=[(k, v) for k, v in states.items() if k != "converged"],
        failures=[(cut(k), cut(v, 300)) for k, v in result.failures.items()],
        columns=[(KNOWN_QUANTITIES[n], unit_text(KNOWN_QUANTITIES[n].unit)) for n in names],
        specimens=_specimens(result, names),
        figures=pictures(result.folder, (FIGURE,)),
        layers=_groups(result.groups, "layer"),
        donors=_groups(result.groups, "donor"),
        contrasts=_contrasts(result.contrasts),
        compared=result.distances.empty is False,
        warning=WARNING,
        notes=[cut(n, 400) for n in result.notes],
        own=[cut(name, 40) for name in result.own_columns],
        glossary=chosen_terms(*TERMS),
        version=biaxbayes.__version__,
    )


def unit_text(text: object) -> str:
    """A unit of a table as the page has it."""
    return {"deg": "°", "1": ""}.get(str(text), str(text))


def _specimens(result: StudyResult, names: list[str]) -> list[dict[str, Any]]:
    found: dict[tuple[str, str], dict[Any, Any]] = {
        (str(r["specimen"]), str(r["quantity"])): r for r in result.table.to_dict("records")
    }
    out = []
    for s in result.specimens.to_dict("records"):
        page = f"{s['folder']}/report.html"
        there = (result.folder / page).is_file()
        out.append(
            {
                "label": cut(s["specimen"], 60),
                "page": page if there else "",
                "donor": cut(s["donor"], 40),
                "layer": cut(s["layer"], 40),
                "own": [cut(s[name], 40) for name in result.own_columns],
                "state": s["state"],
                "cells": [_cell(found.get((str(s["specimen"]), n))) for n in names],
            }
        )
    return out


def _cell(row: dict[Any, Any] | None) -> dict[str, Any]:
    """The reported interval and its verdict as text."""
    if row is None:
        return {"interval": DASH, "verdict": ""}
    if row["verdict"] == FIXED:
        return {"interval": f"{float(row['q50']):.4g}", "verdict": FIXED}
    interval, verdict = (str(row[k]) if isinstance(row[k], str) else "" for k in CELL)
    return {"interval": interval or DASH, "verdict": verdict}


CELL = ("reported", "verdict")


def _groups(groups: pd.DataFrame, by: str) -> list[dict[str, Any]]:
    """Tables of the groups, one each, with the rows that a group identifies anything of."""
    out = []
    for group, part in groups[groups["group_by"] == by].groupby("group", sort=False):
        rows = [
            _group_row(r)
            for r in part.to_dict("records")
            if r["identified"] > 0 and _told(str(r["quantity"]))
        ]
        first = part.iloc[0]
        out.append(
            {
                "name": cut(group, 60),
                "specimens": int(first["specimens"]),
                "converged": int(first["converged"]),
                "rows": rows,
            }
        )
    return out


def _group_row(r: dict[Any, Any]) -> dict[str, Any]:
    low, centre, high = (float(r[k]) for k in ("lowest", "centre", "highest"))
    log = low > 0.0 and high / low > WIDE
    between = float(r["sd_between"])
    if math.isnan(between):
        told = DASH
    elif r["scale"] == "log":
        told = f"factor {math.exp(between):.2f}"
    else:
        told = f"{between:.2g}"
    numbers = [number(v, low, high, log=log) for v in (centre, low, high)]
    return {
        "quantity": named(r["quantity"]),
        "unit": unit_text(r["unit"]),
        "identified": f"{r['identified']} of {r['converged']}",
        "centre": numbers[0],
        "range": f"{numbers[1]} to {numbers[2]}" if low < high else DASH,
        "between": told,
    }


def _told(name: str) -> bool:
    """Whether groups are told of it: not of errors and loads, which are no tissue's."""
    known = KNOWN_QUANTITIES.get(name)
    return known is None or (
        known.parameter.kind in (MATERIAL, STRETCH, DIMENSION) and (known.parameter.unit != LOAD)
    )


def named(name: object) -> Quantity | str:
    """A quantity, which the page turns into its symbol, or words."""
    return KNOWN_QUANTITIES.get(str(name)) or derived_words(str(name))


def _contrasts(contrasts: pd.DataFrame) -> list[dict[str, Any]]:
    out = []
    for (a, b), part in contrasts.groupby(["layer_a", "layer_b"], sort=False):
        rows = []
        for r in part.to_dict("records"):
            low, mean, high = (float(r[f"{k}_difference"]) for k in ("lowest", "mean", "highest"))
            known = r["identified"] > 0
            numbers = [number(v, low, high) for v in (mean, low, high)] if known else []
            rows.append(
                {
                    "quantity": named(r["quantity"]),
                    "unit": unit_text(r["unit"]),
                    "identified": f"{r['identified']} of {r['pairs']}",
                    "greater": str(r["b_greater"]) if known else DASH,
                    "less": str(r["b_less"]) if known else DASH,
                    "mean": numbers[0] if known else DASH,
                    "range": f"{numbers[1]} to {numbers[2]}" if known and low < high else DASH,
                }
            )
        out.append({"a": cut(a, 40), "b": cut(b, 40), "rows": rows})
    return out


# --- the files of a study: tables, figure and page -----------------------------------------------


TABLE, PAGE = "study", "study.html"


def write_study(result: StudyResult) -> list[Path]:
    """Write every file of a study into its folder; ``study.parquet`` where pyarrow is installed."""
    from biaxbayes.figures.study import study_figure
    from biaxbayes.figures.style import save_pictures

    folder = result.folder
    written = []
    tables = {
        TABLE: result.table,
        "study-groups": result.groups,
        "study-contrasts": result.contrasts,
        "study-distances": result.distances,
    }
    for stem, table in tables.items():
        path = folder / f"{stem}.csv"
        if table.empty and stem != TABLE:
            path.unlink(missing_ok=True)
            continue
        write_csv(path, table, digits=8)
        written.append(path)
    parquet = _parquet(result.table)
    if parquet is not None:
        path = folder / f"{TABLE}.parquet"
        atomic_write_bytes(path, parquet)
        written.append(path)
    has_numbers = bool(np.isfinite(result.table["q50"].astype(float)).any())
    figure = study_figure(result.table) if has_numbers else None
    written += save_pictures(figure, folder, FIGURE)
    page = folder / PAGE
    atomic_write_text(page, study_page(result))
    return [*written, page]


def _parquet(table: pd.DataFrame) -> bytes | None:
    """The table with typed columns, where pyarrow is there to write it."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        return None
    typed = table.convert_dtypes()
    buffer = io.BytesIO()
    typed.to_parquet(buffer, engine="pyarrow", index=False)
    return buffer.getvalue()
