"""What ``biaxbayes identify`` says of a run: lines to read, and the same as JSON."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from biaxbayes.identifiability.determined import FARTHEST
from biaxbayes.jobs.products import Identified, verdicts_as_json

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["said_of"]

SHOWN = ("Hx", "Hy", "Hz", "small-strain stiffness xx", "small-strain stiffness yy")


def said_of(found: Identified) -> dict[str, Any]:
    """State of the run, lines to read, the same as JSON.

    Parameters
    ----------
    found : Identified
    """
    lines = found.verdicts.in_words()
    if found.determined is not None:
        directions = found.directions.in_words() if found.directions else []
        words = [*_determined_words(found.determined), *directions]
        lines = [*lines, "", "what the curves themselves say:", *(f"  {line}" for line in words)]
    told = verdicts_as_json(found.verdicts, found.determined, found.directions)
    return {"state": found.state, "lines": lines, "json": json.loads(told)}


def _determined_words(table: pd.DataFrame) -> list[str]:
    """A few quantities, and the stress at the end of the first test."""
    stress = table[table["quantity"].isin(("Cauchy stress x", "Cauchy stress y"))]
    shown = [*table[table["quantity"].isin(SHOWN)].itertuples(), *list(stress.itertuples())[2:4]]
    lines = []
    for row in shown:
        where = f" at {row.stretch_x:g}, {row.stretch_y:g}" if "stress" in str(row.quantity) else ""
        numbers = f"{row.median:.3g} ({row.low_90:.3g} to {row.high_90:.3g})"
        line = f"{row.quantity}{where} {numbers} {row.unit}".rstrip()
        ends = [float(str(v)) for v in (row.tissue_low_90, row.tissue_high_90)]
        if not math.isnan(ends[0]):  # the interval to state: with the error of the model
            line += f"; of the tissue {ends[0]:.3g} to {ends[1]:.3g}"
        elif str(row.quantity).startswith("Cauchy stress"):
            line += f"; of the tissue not stated, the mounting stretch may be {FARTHEST:g} or more"
        lines.append(line)
    return lines
