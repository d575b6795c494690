"""The reported table: median, 90 % interval, verdict and reason of each parameter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from biaxbayes.errors import listed
from biaxbayes.identifiability.verdict import (
    COMBINATION,
    FIXED,
    IDENTIFIED,
    MEASURED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    Assessment,
    ParameterVerdict,
)
from biaxbayes.parameters import MATERIAL, OfQuantity, Quantity
from biaxbayes.report_table import DASH, Column, Table, interval_texts


@dataclass(frozen=True)
class Reported(OfQuantity):
    """Reported row of one parameter.

    Attributes
    ----------
    quantity : Quantity
    median, low, high : float
        50, 5 and 95 % quantiles of the draws; NaN of draws that have not converged.
    verdict : str
        One of :data:`.VERDICTS`, or "no verdict".
    reason : str
        One short phrase.
    bound : {"", "low", "high"}
        Which end of the interval holds alone, as a 95 % bound.
    partners : tuple of str
        Correlated parameters in combination with which it is known; empty for other verdicts.
    """

    quantity: Quantity
    median: float
    low: float
    high: float
    verdict: str
    reason: str
    bound: str = ""
    partners: tuple[str, ...] = ()

    @property
    def texts(self) -> tuple[str, str, str]:
        """Median and ends of the interval in print."""
        return interval_texts(self.median, self.low, self.high, self.quantity.parameter)

    @property
    def text(self) -> str:
        """The median in print."""
        return self.texts[0]

    @property
    def interval(self) -> str:
        """`1.0149 to 1.0212`, `above 1.0071`, `below 0.21` or a dash."""
        _, low, high = self.texts
        if math.isnan(self.median):
            return DASH
        return {"low": f"above {low}", "high": f"below {high}"}.get(self.bound, f"{low} to {high}")

    @property
    def interval_with_unit(self) -> str:
        """The interval with its unit behind it."""
        return self.interval if self.interval == DASH else f"{self.interval} {self.unit}".strip()

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the interval that hold, by the verdict; NaN for the others."""
        known = self.verdict in (IDENTIFIED, MEASURED, COMBINATION)
        low, high = (self.low, self.high) if known else (math.nan, math.nan)
        return (
            self.low if self.bound == "low" else low,
            self.high if self.bound == "high" else high,
        )


def reported(
    parameters: Sequence[ParameterVerdict], *, contradicted_priors: Sequence[str] = ()
) -> tuple[Reported, ...]:
    """Rows of the inferred parameters, in their order, without fixed and tied ones.

    Of a law with a prior of the user's that contradicts the data no parameter is identified.
    """
    out = []
    for p in parameters:
        if p.verdict == FIXED:
            continue
        a, e = p.assessment, p.diagnostics
        if p.verdict == NO_VERDICT or e is None:
            nothing = (math.nan, math.nan, math.nan)
            out.append(Reported(p.scale.quantity, *nothing, NO_VERDICT, a.reason))
            continue
        if contradicted_priors and p.scale.parameter.kind == MATERIAL:
            reason = f"the prior of {listed(list(contradicted_priors))} contradicts the data"
            a = Assessment(NOT_IDENTIFIED, reason)
        partners = e.partners.names if a.verdict == COMBINATION else ()
        values = (e.median, e.low, e.high)
        out.append(Reported(p.scale.quantity, *values, a.verdict, a.reason, a.bound, partners))
    return tuple(out)


# --- the table -----------------------------------------------------------------------------------


def report_frame(reported: Sequence[Reported]) -> pd.DataFrame:
    """The table of ``report.csv``: quantiles as numbers, and the interval as it is printed."""
    return pd.DataFrame(
        [
            (r.name, r.unit, r.median, r.low, r.high, r.interval, r.verdict, r.reason)
            for r in reported
        ],
        columns=["parameter", "unit", "q50", "q05", "q95", "interval", "verdict", "reason"],
    )


def report_table(
    reported: Sequence[Reported],
    label: str = "What to report",
    caption: str = "",
    *,
    meaning: bool = False,
) -> Table:
    """What to report of each parameter, at the end what it means."""
    rows = {r.name: r for r in reported}
    columns = [
        Column("parameter", "Parameter", format=lambda row: rows[row["parameter"]].quantity),
        Column("q50", "Median", format=lambda row: rows[row["parameter"]].text, number=True),
        Column("interval", "Interval", number=True),
        Column("unit", "Unit"),
        Column("verdict", "Verdict", term=True),
        Column("reason", "Reason"),
    ]
    if meaning:
        words = {r.name: r.quantity.parameter.words for r in reported}
        columns.append(Column("", "Meaning", format=lambda row: words[row["parameter"]]))
    return Table(columns, report_frame(reported), label, caption)
