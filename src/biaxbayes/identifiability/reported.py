"""What to report of every parameter: one interval or bound, one verdict, one short reason.

- `identified`: a two-sided interval, robust to the choice of law, to model error and to the prior
- `bounded`: one limit
- `only in combination`: a two-sided interval, wide because the parameter trades with those named
- `not identified`: no usable limit
- `no verdict`: the chains have not converged, so the run shows nothing about the tissue

Intervals are 90 %, bounds 95 %. A posterior holds within its law. Where the law misses the record
smoothly, its intervals are too narrow: each is widened about its median by the ratio of two errors
of the least squares, with the smooth misfit and without (:mod:`biaxbayes.fitting.law_fit`). Where
another law fits distinctly better, the parameters of this law are not identified. Mounting
stretches are those on which all laws that fit agree (:mod:`.mounting_stretch.interval`).

The rows as text are the same words and digits wherever they are printed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from biaxbayes.errors import listed, printable
from biaxbayes.identifiability.mounting_stretch.interval import MountingInterval, widened
from biaxbayes.identifiability.mounting_stretch.law_fits import LawFits, better_law_message
from biaxbayes.identifiability.verdict import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    Evidence,
    ParameterVerdict,
    Thresholds,
    decide,
)
from biaxbayes.laws.law import Law
from biaxbayes.parameters import MATERIAL, Parameter, Quantities, Quantity
from biaxbayes.text_files import aligned

OPEN = float("nan")
UNCONVERGED = "chains have not converged"
PRIOR_DECIDES = "the prior, not the data, determines it"
WIDEST = 10.0
"""Largest ratio of the ends of an interval that counts as identified, of stiffnesses, exponents."""
NAMED_WIDENING = 1.2
"""The reason gives the widening of an interval from this factor on."""


@dataclass(frozen=True)
class Reported:
    """What to report of one parameter.

    Attributes
    ----------
    name, unit : str
        As in ``summary.csv``; the unit is empty for pure numbers.
    low, high : float
        The 90 % interval, or one end of it (95 %); NaN where an end is open.
    verdict : {"identified", "bounded", "only in combination", "not identified", "no verdict"}
    reason : str
        One short phrase.
    partners : tuple of str
        What it is only known in combination with; else empty.
    """

    name: str
    unit: str
    low: float
    high: float
    verdict: str
    reason: str
    partners: tuple[str, ...] = ()


def reported(
    parameters: Sequence[ParameterVerdict],
    fits: LawFits | None,
    law: Law,
    thresholds: Thresholds,
) -> tuple[Reported, ...]:
    """What to report of the inferred parameters, in their order; not of fixed and tied ones.

    Parameters
    ----------
    fits : LawFits or None
        Fits of all laws to the record.
    law : Law
        Of the run.
    """
    intervals = {
        p.name: _interval(p, p.evidence, fits, law, thresholds)
        for p in parameters
        if p.evidence is not None and p.scale.parameter.kind == MATERIAL
    }
    # partners that may lie at an end of their range, or anywhere
    unknown = {
        p.name
        for p in parameters
        if p.name in intervals
        and (intervals[p.name][2] or _contraction(p, fits, law) < thresholds.contraction)
    }
    out = []
    for p in parameters:
        if p.posterior_verdict == FIXED:
            continue
        if p.posterior_verdict == NO_VERDICT or p.evidence is None:
            out.append(Reported(p.name, p.scale.unit, OPEN, OPEN, NO_VERDICT, UNCONVERGED))
        elif p.scale.parameter.kind == MATERIAL:
            out.append(_material(p, p.evidence, intervals[p.name], unknown, fits, law, thresholds))
        else:
            out.append(mounting_row(p.name, p.mounting))
    return tuple(out)


def mounting_row(name: str, interval: MountingInterval | None) -> Reported:
    """What to report of a mounting stretch, from the interval that the laws agree on."""
    if interval is None:
        return Reported(name, "", OPEN, OPEN, NOT_IDENTIFIED, "no other law was fitted")
    low, high = interval.low, interval.high
    verdict = (NOT_IDENTIFIED, BOUNDED, IDENTIFIED)[int(np.isfinite([low, high]).sum())]
    return Reported(name, "", low, high, verdict, interval.reason)


def _material(
    p: ParameterVerdict,
    e: Evidence,
    interval: tuple[float, float, set[int]],
    unknown: set[str],
    fits: LawFits | None,
    law: Law,
    thresholds: Thresholds,
) -> Reported:
    scale = p.scale
    own = None if fits is None else fits[law.name]
    better_law = "" if fits is None else better_law_message(fits, law.name)
    factor = _widening(p, fits, law)
    low, high, open_sides = interval
    # the verdict on the interval as it is reported
    wide = replace(e, low=low, high=high, posterior_sd=factor * e.posterior_sd)
    verdict = decide(wide, thresholds, meaningless=bool(p.meaningless))
    if verdict != NOT_IDENTIFIED and not unknown.isdisjoint(e.partners.names):
        verdict = decide(wide, thresholds, meaningless=bool(p.meaningless), partner_at_end=True)
    ratio = high / max(low, 1e-300) if scale.logarithmic else 1.0
    widening = ""
    if own is not None and factor >= NAMED_WIDENING:
        widening = f"widened {factor:.2g} times for the model error of {law.called}"
    interval_words = f"its interval, {widening}," if widening else "its interval"
    partners = e.partners.names if e.is_traded(thresholds) else ()
    trades = f"trades with {listed(partners)}" if partners else ""

    def reason_of(*phrases: str) -> str:
        return "; ".join(filter(None, phrases))

    # the first rule that holds: verdict and reason
    rules: list[tuple[object, str, str]] = [
        (better_law, NOT_IDENTIFIED, better_law),
        (p.posterior_verdict == NOT_IDENTIFIED, NOT_IDENTIFIED, _prior_reason(p, e, thresholds)),
        (
            verdict == COMBINATION and wide.contraction <= 0.0,
            NOT_IDENTIFIED,
            f"{interval_words} is as wide as the prior",
        ),
        (verdict == COMBINATION, COMBINATION, reason_of(trades, widening)),
        (
            len(open_sides) == 2,
            NOT_IDENTIFIED,
            f"{interval_words} reaches both ends of the range",
        ),
        (open_sides, BOUNDED, reason_of(_end_reason(p, open_sides), widening)),
        (
            verdict == NOT_IDENTIFIED,
            NOT_IDENTIFIED,
            f"{interval_words} is hardly narrower than the prior" if widening else PRIOR_DECIDES,
        ),
        (
            ratio > WIDEST,
            NOT_IDENTIFIED,
            reason_of(f"known only to a factor of {ratio:.2g}", widening),
        ),
        (True, IDENTIFIED, reason_of(widening or "the data determine it", trades)),
    ]
    verdict, reason = next((v, why) for holds, v, why in rules if holds)
    if verdict == NOT_IDENTIFIED or (verdict == BOUNDED and 0 in open_sides):
        low = OPEN
    if verdict == NOT_IDENTIFIED or (verdict == BOUNDED and 1 in open_sides):
        high = OPEN
    partners = partners if verdict == COMBINATION else ()
    return Reported(p.name, scale.unit, low, high, verdict, reason, partners)


def _widening(p: ParameterVerdict, fits: LawFits | None, law: Law) -> float:
    own = None if fits is None else fits[law.name]
    return 1.0 if own is None else own.widening.get(p.scale.kind, 1.0)


def _contraction(p: ParameterVerdict, fits: LawFits | None, law: Law) -> float:
    """Share of the prior's variance that the data remove, with the widened posterior."""
    assert p.evidence is not None
    sd = _widening(p, fits, law) * p.evidence.posterior_sd
    return replace(p.evidence, posterior_sd=sd).contraction


def _interval(
    p: ParameterVerdict, e: Evidence, fits: LawFits | None, law: Law, thresholds: Thresholds
) -> tuple[float, float, set[int]]:
    """The widened interval, and the sides on which an end of the range is not excluded."""
    scale, factor = p.scale, _widening(p, fits, law)
    median = float(scale.to_scale(np.array(e.median)))
    ends = scale.to_scale(np.array([e.low, e.high]))
    low, high = scale.from_scale(np.array(widened(float(ends[0]), median, float(ends[1]), factor)))
    bottom, top = scale.limits
    open_sides = {edge.side for edge in e.open_edges(thresholds)}
    if not scale.parameter.mirror:
        open_sides |= {side for side, at in ((0, low <= bottom), (1, high >= top)) if at}
    return max(float(low), bottom), min(float(high), top), open_sides


def _prior_reason(p: ParameterVerdict, e: Evidence, thresholds: Thresholds) -> str:
    bounds = [edge.value for edge in e.open_edges(thresholds) if edge.kind == "user"]
    if bounds:
        return f"limited by the prior bound {p.scale.parameter.number(bounds[0])}"
    return p.meaningless or PRIOR_DECIDES


def _end_reason(p: ParameterVerdict, open_sides: set[int]) -> str:
    side, parameter = min(open_sides, default=0), p.scale.parameter
    meaning = (parameter.at_low, parameter.at_high)[side]
    end = f"the {('lower', 'upper')[side]} end of its range"
    return f"the data are compatible with {meaning or end}"


# --- the rows as text ----------------------------------------------------------------------------

DASH = "–"
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
    verdict, reason, partners
        As in :class:`Reported`.
    """

    quantity: Quantity
    interval: str
    unit: str
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
            interval_text(r.low, r.high, quantities[r.name].parameter),
            r.unit,
            r.verdict,
            r.reason,
            r.partners,
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
        return DASH
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
    return aligned(cells)
