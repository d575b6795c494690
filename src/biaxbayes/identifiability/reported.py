"""The reported table: median, 90 % interval, verdict and reason of each parameter.

Median and interval are the 50, 5 and 95 % quantiles of the draws, the numbers of every other table
and figure of a run. A verdict says how the interval may be used (:mod:`.verdict`); another law that
describes the record as well and contradicts it may take a verdict away, and so may a prior of the
user's that contradicts the data. The rows as text are the same words and digits wherever they are
printed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from biaxbayes.errors import listed, printable, two_digits
from biaxbayes.fitting.law_fits import LawFits
from biaxbayes.identifiability.verdict import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    Assessment,
    Diagnostics,
    ParameterVerdict,
)
from biaxbayes.parameters import MATERIAL, Parameter, Quantities, Quantity
from biaxbayes.text_files import aligned

NOTHING = float("nan")
"""In place of numbers where draws have not converged."""


@dataclass(frozen=True)
class Reported:
    """Reported row of one parameter.

    Attributes
    ----------
    name, unit : str
        Name as in ``summary.csv``; the unit is empty for pure numbers.
    median, low, high : float
        50, 5 and 95 % quantiles of the draws; NaN of draws that have not converged.
    verdict : {"identified", "bounded", "only in combination", "not identified", "no verdict"}
    reason : str
        One short phrase.
    bound : {"", "low", "high"}
        Which end of the interval holds alone, as a 95 % bound.
    partners : tuple of str
        Correlated parameters in combination with which it is known; empty for other verdicts.
    """

    name: str
    unit: str
    median: float
    low: float
    high: float
    verdict: str
    reason: str
    bound: str = ""
    partners: tuple[str, ...] = ()

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the interval that hold, by the verdict; NaN for the others."""
        low = self.low if self.verdict in (IDENTIFIED, COMBINATION) else NOTHING
        high = self.high if self.verdict in (IDENTIFIED, COMBINATION) else NOTHING
        return (
            self.low if self.bound == "low" else low,
            self.high if self.bound == "high" else high,
        )


def reported(
    parameters: Sequence[ParameterVerdict],
    *,
    override: str = "",
    contradictions: Mapping[str, Assessment] | None = None,
) -> tuple[Reported, ...]:
    """Rows of the inferred parameters, in their order, without fixed and tied ones.

    ``override`` is why no parameter of the law is identified (a better law, a prior that
    contradicts the data); ``contradictions`` replace the verdicts on mounting stretches.
    """
    out = []
    for p in parameters:
        if p.verdict == FIXED:
            continue
        a, e = p.assessment, p.diagnostics
        if p.verdict == NO_VERDICT or e is None:
            nothing = (NOTHING, NOTHING, NOTHING)
            out.append(Reported(p.name, p.scale.unit, *nothing, NO_VERDICT, a.reason))
            continue
        if override and p.scale.parameter.kind == MATERIAL:
            a = Assessment(NOT_IDENTIFIED, override)
        a = (contradictions or {}).get(p.name, a)
        partners = e.partners.names if a.verdict == COMBINATION else ()
        values = (e.median, e.low, e.high)
        out.append(Reported(p.name, p.scale.unit, *values, a.verdict, a.reason, a.bound, partners))
    return tuple(out)


GAP, LEAST_GAP = 0.5, 0.1
"""A law contradicts an interval where it lies beyond it by more than this fraction of its width,
and by more than that fraction of the width of a sharp one."""


def contradicted_stretches(
    rows: Sequence[ParameterVerdict], fits: LawFits, law: str, places: Mapping[str, tuple[int, int]]
) -> dict[str, Assessment]:
    """Verdicts on mounting stretches that the fit of another law contradicts.

    Of the laws that describe the record as well as that of the run, one whose mounting stretch lies
    beyond the interval's upper end leaves it bounded from below, and one below the lower end leaves
    it not identified.
    ``places`` are the indices (mounted state, axis) of the stretches in the fits.
    """
    out = {}
    others = fits.as_good_as(law)
    for p in rows:
        e = p.diagnostics
        if p.name not in places or e is None or p.verdict not in (IDENTIFIED, BOUNDED):
            continue
        gap = max(GAP * (e.high - e.low), LEAST_GAP * e.parameter.sharp)
        at = {f.law: float(f.mounting_stretch[places[p.name]]) for f in others}
        below = [name for name, value in at.items() if value < e.low - gap]
        above = [name for name, value in at.items() if value > e.high + gap]
        if below:
            out[p.name] = Assessment(NOT_IDENTIFIED, _disagree(below, at, e))
        elif above and p.verdict == IDENTIFIED:
            out[p.name] = Assessment(BOUNDED, _disagree(above, at, e), "low")
    return out


def _disagree(laws: Sequence[str], at: Mapping[str, float], e: Diagnostics) -> str:
    texts = {law: quantile_texts(at[law], e.low, e.high, e.parameter)[0] for law in laws[:2]}
    named = listed([f"{law} ({text})" for law, text in texts.items()])
    if len(laws) == 1:
        return f"{named} describes the record as well and contradicts it"
    return f"{named} describe the record as well and contradict it"


def measurement_advice(names: Sequence[str]) -> str:
    """Advice on measuring mounting stretches that are not identified, with header lines."""
    lines = " and ".join(f"# {name}: VALUE +- SD" for name in names)
    return (
        "photograph two marks per axis before and after mounting, and write the ratio of their "
        f"distances into the header of the specimen: {lines}"
    )


# --- the rows as text ----------------------------------------------------------------------------

DASH = "–"
"""Stands in place of numbers where there are none."""
COARSE_RATIO = 8.0
"""Ratio of the ends of an interval from which each has two significant digits."""


@dataclass(frozen=True)
class ReportRow:
    """One row of the reported table, as text."""

    quantity: Quantity
    median: str
    interval: str  # `1.0149 to 1.0212`, `above 1.0071`, `below 0.21` or a dash
    unit: str  # empty for pure numbers
    verdict: str
    reason: str
    partners: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.quantity.name

    @property
    def interval_with_unit(self) -> str:
        """The interval with its unit behind it."""
        unit = self.unit if self.interval != DASH else ""
        return f"{self.interval} {unit}".strip()


def report_rows(reported: Sequence[Reported], quantities: Quantities) -> list[ReportRow]:
    """The rows as text, in their order."""
    return [
        ReportRow(
            quantities[r.name],
            *row_numbers(r, quantities[r.name].parameter),
            r.unit,
            r.verdict,
            r.reason,
            r.partners,
        )
        for r in reported
    ]


def report_frame(reported: Sequence[Reported], quantities: Quantities) -> pd.DataFrame:
    """The table of ``report.csv``: quantiles as numbers, and the interval as it is printed."""
    rows = report_rows(reported, quantities)
    return pd.DataFrame(
        [
            (r.name, row.unit, r.median, r.low, r.high, row.interval, row.verdict, row.reason)
            for r, row in zip(reported, rows, strict=True)
        ],
        columns=["parameter", "unit", "q50", "q05", "q95", "interval", "verdict", "reason"],
    )


def row_numbers(r: Reported, parameter: Parameter) -> tuple[str, str]:
    """Median and interval of a row as text; of a bounded parameter the bound."""
    if math.isnan(r.median):
        return DASH, DASH
    median, low, high = quantile_texts(r.median, r.low, r.high, parameter)
    interval = {"low": f"above {low}", "high": f"below {high}"}.get(r.bound, f"{low} to {high}")
    return median, interval


def quantile_texts(
    median: float, low: float, high: float, parameter: Parameter
) -> tuple[str, str, str]:
    """Median and ends of an interval, with two digits of its width; the same wherever printed."""
    values = (median, low, high)
    width = high - low
    if parameter.logarithmic and low > 0.0 and high > COARSE_RATIO * low:
        return tuple(map(two_digits, values))  # type: ignore[return-value]
    if not (width > 0.0 and math.isfinite(width)):
        return tuple(parameter.number(v) for v in values)  # type: ignore[return-value]
    digits = min(1 - math.floor(math.log10(width)), 8)
    return tuple(  # type: ignore[return-value]
        f"{round(v, digits) + 0.0:.{max(digits, 0)}f}" for v in values
    )


def interval_text(low: float, high: float, parameter: Parameter) -> str:
    """An interval as text, or a bound where the other end is NaN."""
    if math.isnan(low) and math.isnan(high):
        return DASH
    if math.isnan(high):
        return f"above {parameter.number(low)}"
    if math.isnan(low):
        return f"below {parameter.number(high)}"
    _, first, last = quantile_texts(low, low, high, parameter)
    return f"{first} to {last}"


def row_lines(rows: Sequence[ReportRow]) -> list[str]:
    """Aligned lines for a terminal."""
    return aligned(
        [
            (printable(r.name), r.median, r.interval, r.unit, r.verdict, printable(r.reason))
            for r in rows
        ]
    )
