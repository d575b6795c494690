"""The reported table as text: the same words and digits wherever it is printed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from biaxbayes.errors import printable
from biaxbayes.identifiability.reported import Reported
from biaxbayes.parameters import Parameter, Quantities, Quantity

NONE = "–"
"""In place of an interval where nothing is reported."""
WIDE = 8.0
"""Ratio of the ends of an interval from which each has two significant digits."""


@dataclass(frozen=True)
class ReportRow:
    """One row of the reported table, as text.

    Attributes
    ----------
    quantity : Quantity
    interval : str
        ``1.0149 to 1.0212``, ``above 1.0071``, ``below 0.21`` or a dash.
    unit : str
        Empty for pure numbers.
    verdict : {"identified", "bounded", "only in combination", "not identified"}
    reason : str
    """

    quantity: Quantity
    interval: str
    unit: str
    verdict: str
    reason: str

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.quantity.name

    @property
    def interval_with_unit(self) -> str:
        """The interval with its unit behind it."""
        unit = self.unit if self.interval != NONE else ""
        return f"{self.interval} {unit}".strip()


def report_rows(reported: Sequence[Reported], quantities: Quantities) -> list[ReportRow]:
    """The rows as text, in their order."""
    return [
        ReportRow(
            quantities[r.name],
            interval_text(r.low, r.high, quantities[r.name].parameter),
            r.unit,
            r.verdict,
            r.reason,
        )
        for r in reported
    ]


def report_frame(reported: Sequence[Reported], quantities: Quantities) -> pd.DataFrame:
    """The table of ``report.csv``: ends as numbers, and the interval as it is printed."""
    rows = report_rows(reported, quantities)
    return pd.DataFrame(
        [
            (r.name, row.unit, r.low, r.high, row.interval, row.verdict, row.reason)
            for r, row in zip(reported, rows, strict=True)
        ],
        columns=["parameter", "unit", "low", "high", "interval", "verdict", "reason"],
    )


def interval_text(low: float, high: float, parameter: Parameter) -> str:
    """An interval or a bound as text, without its unit.

    Both ends have two digits of the width of the interval; a bound has the digits of its parameter.
    """
    if math.isnan(low) and math.isnan(high):
        return NONE
    if math.isnan(high):
        return f"above {parameter.number(low)}"
    if math.isnan(low):
        return f"below {parameter.number(high)}"
    width = high - low
    if parameter.logarithmic and low > 0.0 and high > WIDE * low:
        return f"{float(f'{low:.2g}'):g} to {float(f'{high:.2g}'):g}"
    if not (width > 0.0 and math.isfinite(width)):
        return f"{parameter.number(low)} to {parameter.number(high)}"
    digits = min(1 - math.floor(math.log10(width)), 8)
    first, last = (f"{round(v, digits) + 0.0:.{max(digits, 0)}f}" for v in (low, high))
    return f"{first} to {last}"


def row_lines(rows: Sequence[ReportRow], most: int | None = None) -> list[str]:
    """The table for a terminal, one line per parameter; at most so many, the last says so."""
    cells = [(printable(r.name), r.interval, r.unit, r.verdict, printable(r.reason)) for r in rows]
    if most is not None and len(cells) > most:
        more = len(cells) - most + 1
        cells = [*cells[: most - 1], (f"... {more} more in report.csv", "", "", "", "")]
    widths = [max((len(row[k]) for row in cells), default=0) for k in range(4)]
    return [
        "  ".join([*(f"{c:<{w}}" for c, w in zip(row, widths, strict=False)), row[4]]).rstrip()
        for row in cells
    ]
