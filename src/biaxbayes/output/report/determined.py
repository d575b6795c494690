"""What the data determine, as rows of the page."""

from __future__ import annotations

import math

from biaxbayes.findings.determined import determined
from biaxbayes.output.figures.numbers import number
from biaxbayes.output.run import Run

__all__ = ["determined_rows"]

STATES = 3
"""Stretches that the page states; the table of all comes from the Python function."""
WORDS = {
    "Hx": "structure tensor, x",
    "Hy": "structure tensor, y",
    "Hz": "structure tensor, through the thickness",
}


def determined_rows(run: Run) -> list[dict[str, str]]:
    """Quantities that do not depend on how the parameters are split."""
    from biaxbayes.findings.determined import stated_stretches

    draws = run.draws.iloc[:: max(1, len(run.draws) // 2000)]
    states = stated_stretches(draws, run.specimen)
    # The largest states last: they are what the test was made for.
    shown = states[-STATES:] if len(states) > STATES else states
    switch = run.provenance["settings"].get("fibre_switch") is True
    out = []
    table = determined(draws, run.specimen, stretches=shown, fibre_switch=switch)
    for r in table.to_dict("records"):
        low, median, high = (float(r[k]) for k in ("low_90", "median", "high_90"))
        wide = low > 0.0 and high / low > 8.0
        told = [number(v, low, high, log=wide) for v in (median, low, high)]
        x, y = float(r["stretch_x"]), float(r["stretch_y"])
        out.append(
            {
                "quantity": WORDS.get(str(r["quantity"]), str(r["quantity"])),
                "at": "" if math.isnan(x) else f"{x:g}, {y:g}",
                "unit": str(r["unit"]),
                "median": told[0],
                "interval": f"{told[1]} to {told[2]}",
                "width": _percent(100.0 * float(r["relative_width"])),
            }
        )
    return out


def _percent(value: float) -> str:
    return (
        f"{value:.2g} %" if value < 10.0 else f"{value:.0f} %" if value < 1e4 else "over 10,000 %"
    )
