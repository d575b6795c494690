"""What the data determine, as rows of the page."""

from __future__ import annotations

import math

import pandas as pd

from biaxbayes.findings.determined import MEASURED, determined, mounting_stated
from biaxbayes.output.figures.numbers import number
from biaxbayes.output.report.names import cut
from biaxbayes.output.report.parameters import refit_ranges
from biaxbayes.output.run import Run

__all__ = ["determined_rows"]

STATES = 3
"""Stretches of each kind that the page states; determined.csv has all."""
WORDS = {
    "Hx": "structure tensor, x",
    "Hy": "structure tensor, y",
    "Hz": "structure tensor, through the thickness",
}


def determined_rows(run: Run) -> list[dict[str, str]]:
    """Quantities that do not depend on how the parameters are split."""
    draws = run.draws.iloc[:: max(1, len(run.draws) // 2000)]
    switch = run.provenance["settings"].get("fibre_switch") is True
    table = determined(
        draws,
        run.specimen,
        fibre_switch=switch,
        refits=refit_ranges(run),
        mounting_known=mounting_stated(run.provenance["settings"].get("priors") or {}),
    )
    out = []
    for r in table[_shown(table)].to_dict("records"):
        low, median, high = (float(r[k]) for k in ("low_90", "median", "high_90"))
        wide = low > 0.0 and high / low > 8.0
        told = [number(v, low, high, log=wide) for v in (median, low, high)]
        ends = [float(r[k]) for k in ("tissue_low_90", "tissue_high_90")]
        tissue = " to ".join(number(v, *ends) for v in ends)
        if math.isnan(ends[0]):
            tissue = "not stated" if str(r["quantity"]).startswith("Cauchy stress") else ""
        x, y = float(r["stretch_x"]), float(r["stretch_y"])
        name = cut(r["quantity"], 90)
        out.append(
            {
                "quantity": WORDS.get(name, name),
                "at": "" if math.isnan(x) else f"{x:g}, {y:g}",
                "unit": str(r["unit"]),
                "median": told[0],
                "interval": f"{told[1]} to {told[2]}",
                "tissue": tissue,
                "width": _percent(100.0 * float(r["relative_width"])),
            }
        )
    return out


def _shown(table: pd.DataFrame) -> pd.Series:
    """The largest states of each kind: they are what the test was made for."""
    measured = table["quantity"].str.contains(MEASURED, regex=False)
    beyond = ~measured & (table["stretch_x"].notna()) & ~table["quantity"].str.startswith("small")
    out = ~measured & ~beyond
    for kind in (beyond, measured):
        # A stress at a measured stretch names its protocol: a state is that and the stretches.
        state = table["quantity"].where(measured, "").str.split(MEASURED).str[-1]
        state = state + table["stretch_x"].astype(str) + " " + table["stretch_y"].astype(str)
        last = list(dict.fromkeys(state[kind]))[-STATES:]
        out |= kind & state.isin(last)
    return out


def _percent(value: float) -> str:
    return (
        f"{value:.2g} %" if value < 10.0 else f"{value:.0f} %" if value < 1e4 else "over 10,000 %"
    )
