"""population.html: what specimens have in common on one page, with its methods paragraph."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

import biaxbayes
from biaxbayes.parameters import unit_words
from biaxbayes.reports.names import cut
from biaxbayes.reports.page import page_template, pictures

__all__ = ["PAGE", "population_methods", "population_page"]

PAGE = "population.html"
DASH = "–"
FIGURES = {
    "population-forest": (
        "Specimens alone and pooled",
        "Grey: the specimen's own run; coloured: pooled; diamond: the group's median with its 90 % "
        "interval; thin line: a new specimen.",
    ),
    "population-pairs": (
        "New specimens",
        "Contours hold 50 and 90 % of new specimens; points are the tested ones, pooled.",
    ),
    "new-specimen-bands": (
        "Stress of a new specimen",
        "Equibiaxial Cauchy stress: band of 90 % of new specimens, over the equibiaxial records.",
    ),
}


def population_page(
    folder: Path, tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]
) -> str:
    """The page as HTML: no scripts, no network.

    Parameters
    ----------
    folder : Path
        Holds the figures.
    tables : mapping of str to DataFrame
        ``groups``, ``specimens`` and ``contrasts``.
    record : mapping
        As in population.json.
    """
    there = pictures(folder, tuple(FIGURES))
    own = tables["specimens"].drop_duplicates("specimen")
    convergence = record["convergence"]
    converged = convergence["state"] == "converged"
    return page_template("population.html.jinja").render(
        name=cut(record["name"]),
        specimens=len(own),
        donors=int(own["donor"].nunique()),
        state=convergence["state"],
        told="converged" if converged else f"{convergence['state']}: {convergence['reason']}",
        left_out=[(cut(k), cut(v, 300)) for k, v in record["left_out"].items()],
        notes=[cut(n, 500) for n in record["notes"]],
        figures=[(*FIGURES[stem], picture) for stem, picture in there.items()],
        groups=_groups(tables["groups"]),
        contrasts=_contrasts(tables["contrasts"]),
        methods=population_methods(tables, record),
        version=biaxbayes.__version__,
    )


def _number(value: float) -> str:
    return DASH if math.isnan(value) else f"{value:.3g}"


def _cell(r: Mapping[Any, Any], part: str) -> str:
    low, median, high = (_number(float(r[f"{part}_{q}"])) for q in ("q05", "q50", "q95"))
    return DASH if median == DASH else f"{median} ({low} to {high})"


def _unit(unit: object) -> str:
    return {"deg": "°", "1": ""}.get(str(unit), str(unit))


def _groups(table: pd.DataFrame) -> list[dict[str, Any]]:
    out = []
    for group, part in table.groupby("group", sort=False):
        rows = []
        for r in part.to_dict("records"):
            log = " (log)" if r["scale"] == "log" else ""
            sds = [_cell(r, part) + log for part in ("sd_donors", "sd_specimens")]
            cells = [_cell(r, "mean"), *sds, _cell(r, "new_specimen"), _cell(r, "new_donor")]
            rows.append({"quantity": r["quantity"], "unit": _unit(r["unit"]), "cells": cells})
        first = part.iloc[0]
        out.append(
            {
                "name": cut(group, 60),
                "specimens": int(first["specimens"]),
                "donors": int(first["donors"]),
                "rows": rows,
            }
        )
    return out


def _contrasts(table: pd.DataFrame) -> list[dict[str, Any]]:
    out = []
    for (a, b), part in table.groupby(["group_a", "group_b"], sort=False):
        rows = []
        for r in part.to_dict("records"):
            log = r["scale"] == "log"
            ends = [float(r[f"difference_{q}"]) for q in ("q05", "q50", "q95")]
            low, median, high = (_number(math.exp(min(x, 700.0)) if log else x) for x in ends)
            kind = "ratio" if log else f"difference{unit_words(str(r['unit']))}"
            share = float(r["probability_positive"])
            rows.append(
                {
                    "quantity": r["quantity"],
                    "kind": kind,
                    "median": median,
                    "interval": f"{low} to {high}",
                    "share": DASH if math.isnan(share) else f"{share:.3f}",
                }
            )
        out.append({"a": cut(a, 40), "b": cut(b, 40), "rows": rows})
    return out


def population_methods(tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]) -> str:
    """One paragraph for a paper, with the population's own numbers."""
    groups = tables["groups"].drop_duplicates("group")
    counted = "; ".join(
        f"{cut(r['group'], 60)}: {r['specimens']} specimens of {r['donors']} donors"
        for r in groups.to_dict("records")
    )
    pooled = record["pooled"]
    logs = [name for name, v in pooled.items() if v["scale"] == "log"]
    others = [name for name in pooled if name not in logs]
    scales = []
    if logs:
        scales.append(f"the natural logs of {_and(logs)}")
    if others:
        scales.append(f"{_and(others)} cut at the physical edges")
    priors = "; ".join(
        f"{name}: mean {v['mean']}, sds {v['sd_donors']} between donors and {v['sd_specimens']} "
        "between specimens"
        for name, v in pooled.items()
    )
    convergence = record["convergence"]
    judged = (
        f"R-hat was at most {convergence['worst_rhat']:.3f} and the effective sample size of "
        f"every reported quantity at least {convergence['worst_ess']:.0f}."
        if convergence["state"] == "converged"
        else f"The chains did not converge ({convergence['reason']})."
    )
    left = f" Left out: {_and(list(record['left_out']))}." if record["left_out"] else ""
    return (
        f"A hierarchical model pooled the specimens ({counted}). {_first_up(_and(scales))} of a "
        "specimen were normal around the mean of its group plus the effect of its donor, which "
        "the donor's specimens shared; each specimen kept the likelihood of its single run, the "
        f"run's prior of the pooled parameters divided out. Priors were, {priors}. Draws of the "
        "single runs served as proposals (Lunn et al. 2013), beside moves by the specimens' own "
        f"likelihoods and joint moves of all specimens. {judged}{left}"
    )


def _and(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _first_up(text: str) -> str:
    return text[:1].upper() + text[1:]
