"""study.html: all specimens of a study on one page."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

import biaxbayes
from biaxbayes.findings.compare import WARNING
from biaxbayes.findings.study_groups import KNOWN
from biaxbayes.findings.verdict import FIXED
from biaxbayes.output.figures.numbers import number
from biaxbayes.output.report.names import cut
from biaxbayes.output.report.page_template import page_template
from biaxbayes.output.report.pictures import pictures
from biaxbayes.output.study_result import StudyResult

__all__ = ["FIGURE", "study_page"]

FIGURE = "study-specimens"
SHOWN = ("C1", "k1", "k2", "alpha", "kappa", "mounting_stretch_x", "mounting_stretch_y")
WIDE = 8.0
DASH = "–"
WORDS = {
    "Hx": "structure tensor, x",
    "Hy": "structure tensor, y",
    "Hz": "structure tensor, z",
    "stiffness_x": "small-strain stiffness, x",
    "stiffness_y": "small-strain stiffness, y",
    "stiffness_x at 1": "small-strain stiffness, x",
    "stiffness_y at 1": "small-strain stiffness, y",
}
UNITS = {"deg": "°", "1": ""}


def study_page(result: StudyResult) -> str:
    """The page as HTML: no scripts, no network; the links lead to the reports of the runs.

    Parameters
    ----------
    result : StudyResult
        Its folder holds the figure.
    """
    states = result.states
    total = sum(states.values())
    names = [n for n in SHOWN if (result.table["quantity"] == n).any()]
    return page_template("study.html.jinja").render(
        name=cut(result.name),
        total=total,
        reliable=states.get("reliable", 0),
        states=[(k, v) for k, v in states.items() if k != "reliable"],
        failures=[(cut(k), cut(v, 300)) for k, v in result.failures.items()],
        columns=[(n, _unit(result.table, n)) for n in names],
        specimens=_specimens(result, names),
        figures=pictures(result.folder, (FIGURE,)),
        layers=_groups(result.groups, "layer"),
        donors=_groups(result.groups, "donor"),
        contrasts=_contrasts(result.contrasts),
        compared=result.distances.empty is False,
        warning=WARNING,
        notes=[cut(n, 400) for n in result.notes],
        version=biaxbayes.__version__,
    )


def _unit(table: pd.DataFrame, name: str) -> str:
    units = table.loc[(table["quantity"] == name) & table["unit"].notna(), "unit"]
    text = str(units.iloc[0]) if len(units) else ""
    return UNITS.get(text, text)


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
                "state": s["state"],
                "cells": [_cell(found.get((str(s["specimen"]), n))) for n in names],
            }
        )
    return out


def _cell(row: dict[Any, Any] | None) -> dict[str, Any]:
    """Median and interval as text, and whether the specimen determines them."""
    if row is None or not math.isfinite(float(row["q50"])):
        return {"median": DASH, "interval": "", "known": True}
    low, median, high = (float(row[k]) for k in ("q05", "q50", "q95"))
    log = low > 0.0 and high / low > WIDE
    told = [number(v, low, high, log=log) for v in (median, low, high)]
    fixed = row["verdict"] == FIXED or low == high
    interval = "fixed" if fixed else f"{told[1]} to {told[2]}"
    known = fixed or (row["state"] == "reliable" and row["verdict"] in KNOWN)
    return {"median": told[0], "interval": interval, "known": known}


def _groups(groups: pd.DataFrame, by: str) -> list[dict[str, Any]]:
    """Tables of the groups, one each, with the rows that a group determines anything of."""
    out = []
    for group, part in groups[groups["group_by"] == by].groupby("group", sort=False):
        rows = [
            _group_row(r)
            for r in part.to_dict("records")
            if r["determined"] > 0
            and not str(r["quantity"]).startswith(("noise", "mounting_force", "load_offset"))
        ]
        first = part.iloc[0]
        out.append(
            {
                "name": cut(group, 60),
                "specimens": int(first["specimens"]),
                "reliable": int(first["reliable"]),
                "rows": rows,
            }
        )
    return out


def _group_row(r: dict[Any, Any]) -> dict[str, str]:
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
        "quantity": _named(r["quantity"]),
        "unit": UNITS.get(str(r["unit"]), str(r["unit"])),
        "determined": f"{r['determined']} of {r['reliable']}",
        "centre": numbers[0],
        "range": f"{numbers[1]} to {numbers[2]}" if low < high else DASH,
        "between": told,
    }


def _named(quantity: object) -> str:
    """A parameter's own name, which the page turns into its symbol, or words."""
    return WORDS.get(str(quantity), str(quantity))


def _contrasts(contrasts: pd.DataFrame) -> list[dict[str, Any]]:
    out = []
    for (a, b), part in contrasts.groupby(["layer_a", "layer_b"], sort=False):
        rows = []
        for r in part.to_dict("records"):
            low, mean, high = (float(r[f"{k}_difference"]) for k in ("lowest", "mean", "highest"))
            known = r["determined"] > 0
            numbers = [number(v, low, high) for v in (mean, low, high)] if known else []
            rows.append(
                {
                    "quantity": _named(r["quantity"]),
                    "unit": UNITS.get(str(r["unit"]), str(r["unit"])),
                    "determined": f"{r['determined']} of {r['pairs']}",
                    "greater": str(r["b_greater"]) if known else DASH,
                    "less": str(r["b_less"]) if known else DASH,
                    "mean": numbers[0] if known else DASH,
                    "range": f"{numbers[1]} to {numbers[2]}" if known and low < high else DASH,
                }
            )
        out.append({"a": cut(a, 40), "b": cut(b, 40), "rows": rows})
    return out
