"""The reported table: one interval or bound, one verdict and one short reason per parameter.

- `identified`: a two-sided interval, robust to the choice of law, to model error and to the prior
- `bounded`: one limit
- `only in combination`: a two-sided interval, wide because the parameter is
  strongly correlated with those named
- `not identified`: no usable limit
- `no verdict`: the chains have not converged, so the run shows nothing about the tissue

Intervals are 90 %, bounds 95 %. A posterior is conditional on its law. Where the law leaves a
smooth misfit, its intervals are too narrow: each is widened about its median m by a factor f,

    [m - f (m - q05), m + f (q95 - m)],     f = sd_fit / sd_posterior >= 1,

with the standard error sd_fit of the least-squares fit, smooth misfit included, and the standard
error sd_posterior by the curvature of the posterior (:mod:`biaxbayes.fitting.law_fits`). Intervals
of stiffnesses and exponents are widened on their log scale. Where another law fits distinctly
better, or a prior of the user contradicts the data, the parameters of this law are not identified.
Mounting stretches are those on which all laws that fit agree (:mod:`.mounting_interval`).

The rows as text are the same words and digits wherever they are printed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from biaxbayes.errors import listed, printable
from biaxbayes.fitting.law_fits import LawFits, better_law_message
from biaxbayes.identifiability.mounting_interval import NO_BOUND, MountingInterval, widen_interval
from biaxbayes.identifiability.verdict import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    Diagnostics,
    ParameterVerdict,
    Thresholds,
    decide,
)
from biaxbayes.laws.law import Law
from biaxbayes.parameters import MATERIAL, Parameter, Quantities, Quantity
from biaxbayes.text_files import aligned

UNCONVERGED = "chains have not converged"
PRIOR_DECIDES = "the prior, not the data, determines it"
MAX_RATIO = 10.0
"""Largest ratio of the ends of an interval of a stiffness or exponent that counts as identified."""
MIN_QUOTED_WIDENING = 1.2
"""The reason gives the widening of an interval from this factor on."""


@dataclass(frozen=True)
class Reported:
    """Reported interval of one parameter.

    Attributes
    ----------
    name, unit : str
        Name as in ``summary.csv``; the unit is empty for pure numbers.
    low, high : float
        The 90 % interval, or one end of it (95 %); NaN where an end is open.
    verdict : {"identified", "bounded", "only in combination", "not identified", "no verdict"}
    reason : str
        One short phrase.
    partners : tuple of str
        Correlated parameters in combination with which it is known; empty for other verdicts.
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
    contradicted_priors: Sequence[str] = (),
) -> tuple[Reported, ...]:
    """Rows of the inferred parameters, in their order, without fixed and tied ones."""
    intervals = {
        p.name: _widen(p, p.diagnostics, fits, law, thresholds)
        for p in parameters
        if p.diagnostics is not None and p.scale.parameter.kind == MATERIAL
    }
    weakly_constrained = {
        name
        for name, wide in intervals.items()
        if wide.unexcluded_sides or wide.diagnostics.contraction < thresholds.contraction
    }
    blocking_reason = "" if fits is None else better_law_message(fits, law.name)
    if contradicted_priors:
        blocking_reason = f"the prior of {listed(list(contradicted_priors))} contradicts the data"
    out = []
    for p in parameters:
        if p.posterior_verdict == FIXED:
            continue
        if p.posterior_verdict == NO_VERDICT or p.diagnostics is None:
            out.append(Reported(p.name, p.scale.unit, NO_BOUND, NO_BOUND, NO_VERDICT, UNCONVERGED))
        elif p.scale.parameter.kind != MATERIAL:
            out.append(mounting_row(p.name, p.mounting))
        elif blocking_reason:
            out.append(
                Reported(p.name, p.scale.unit, NO_BOUND, NO_BOUND, NOT_IDENTIFIED, blocking_reason)
            )
        else:
            out.append(_material_row(p, intervals[p.name], weakly_constrained, law, thresholds))
    return tuple(out)


def mounting_row(name: str, interval: MountingInterval | None) -> Reported:
    """Row of a mounting stretch, from the interval that the laws agree on."""
    if interval is None:
        return Reported(name, "", NO_BOUND, NO_BOUND, NOT_IDENTIFIED, "no other law was fitted")
    bounded = BOUNDED if np.isfinite(interval.low) else NOT_IDENTIFIED
    verdict = IDENTIFIED if interval.is_value else bounded
    return Reported(name, "", interval.low, interval.high, verdict, interval.reason)


@dataclass(frozen=True)
class _WidenedParameter:
    """Diagnostics on a parameter with its interval widened for the model error of the law."""

    diagnostics: Diagnostics  # interval and posterior sd are the widened ones
    unexcluded_sides: frozenset[int]  # 0 low, 1 high: ends of the range not excluded
    factor: float  # by which the interval is widened about its median


def _widen(
    p: ParameterVerdict, e: Diagnostics, fits: LawFits | None, law: Law, thresholds: Thresholds
) -> _WidenedParameter:
    scale, law_fit = p.scale, None if fits is None else fits[law.name]
    factor = 1.0 if law_fit is None else law_fit.widening.get(scale.parameter.name, 1.0)
    low, median, high = (float(v) for v in scale.to_scale(np.array([e.low, e.median, e.high])))
    ends = scale.from_scale(np.array(widen_interval(low, median, high, factor)))
    low, high = float(ends[0]), float(ends[1])
    lowest, highest = scale.limits
    sides = {edge.side for edge in e.open_edges(thresholds)}
    if not scale.parameter.mirror:
        sides |= {side for side, at_end in ((0, low <= lowest), (1, high >= highest)) if at_end}
    sd = factor * e.posterior_sd
    wide = replace(e, low=max(low, lowest), high=min(high, highest), posterior_sd=sd)
    return _WidenedParameter(wide, frozenset(sides), factor)


def _material_row(
    p: ParameterVerdict,
    wide: _WidenedParameter,
    weakly_constrained: set[str],
    law: Law,
    thresholds: Thresholds,
) -> Reported:
    """The row of a parameter of the law; a partner may be among the `weakly_constrained`."""
    e, unexcluded, scale = wide.diagnostics, wide.unexcluded_sides, p.scale
    parameter = scale.parameter
    undefined = bool(p.undefined)
    verdict_of_widened = decide(e, thresholds, undefined=undefined)
    if verdict_of_widened != NOT_IDENTIFIED and not weakly_constrained.isdisjoint(e.partners.names):
        verdict_of_widened = decide(e, thresholds, undefined=undefined, partner_is_weak=True)
    widening = ""
    if wide.factor >= MIN_QUOTED_WIDENING:
        widening = f"widened {wide.factor:.2g} times for the model error of {law.short_name}"
    interval = f"its interval, {widening}," if widening else "its interval"
    partners = e.partners.names if e.is_correlated(thresholds) else ()
    trades = f"trades with {listed(partners)}" if partners else ""
    ratio = e.high / max(e.low, 1e-300) if scale.logarithmic else 1.0
    weak_reason = f"{interval} is hardly narrower than the prior" if widening else PRIOR_DECIDES
    bounds = [edge.value for edge in e.open_edges(thresholds) if edge.kind == "user"]
    by_prior = p.undefined or PRIOR_DECIDES
    if bounds:
        by_prior = f"limited by the prior bound {parameter.number(bounds[0])}"
    side = min(unexcluded, default=0)
    end = (parameter.at_low, parameter.at_high)[side]
    end = end or f"the {('lower', 'upper')[side]} end of its range"
    rules: list[tuple[bool, str, Sequence[str]]] = [  # condition, verdict, parts of the reason
        (p.posterior_verdict == NOT_IDENTIFIED, NOT_IDENTIFIED, [by_prior]),
        (
            verdict_of_widened == COMBINATION and e.contraction <= 0.0,
            NOT_IDENTIFIED,
            [f"{interval} is as wide as the prior"],
        ),
        (verdict_of_widened == COMBINATION, COMBINATION, [trades, widening]),
        (len(unexcluded) == 2, NOT_IDENTIFIED, [f"{interval} reaches both ends of the range"]),
        (len(unexcluded) == 1, BOUNDED, [f"the data are compatible with {end}", widening]),
        (verdict_of_widened == NOT_IDENTIFIED, NOT_IDENTIFIED, [weak_reason]),
        (ratio > MAX_RATIO, NOT_IDENTIFIED, [f"known only to a factor of {ratio:.2g}", widening]),
        (True, IDENTIFIED, [widening or "the data determine it", trades]),
    ]
    verdict, reason = next(
        (v, "; ".join(filter(None, parts))) for applies, v, parts in rules if applies
    )
    low, high = e.low, e.high
    if verdict == NOT_IDENTIFIED:
        low = high = NO_BOUND
    elif verdict == BOUNDED:
        low, high = (NO_BOUND, high) if 0 in unexcluded else (low, NO_BOUND)
    partners = partners if verdict == COMBINATION else ()
    return Reported(p.name, scale.unit, low, high, verdict, reason, partners)


# --- the rows as text ----------------------------------------------------------------------------

DASH = "–"
"""Stands in place of an interval where nothing is reported."""
COARSE_RATIO = 8.0
"""Ratio of the ends of an interval from which each has two significant digits."""


@dataclass(frozen=True)
class ReportRow:
    """One row of the reported table, as text."""

    quantity: Quantity
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
    """An interval with two digits of its width, or a bound with the digits of its parameter."""
    if math.isnan(low) and math.isnan(high):
        return DASH
    if math.isnan(high):
        return f"above {parameter.number(low)}"
    if math.isnan(low):
        return f"below {parameter.number(high)}"
    width = high - low
    if parameter.logarithmic and low > 0.0 and high > COARSE_RATIO * low:
        return f"{float(f'{low:.2g}'):g} to {float(f'{high:.2g}'):g}"
    if not (width > 0.0 and math.isfinite(width)):
        return f"{parameter.number(low)} to {parameter.number(high)}"
    digits = min(1 - math.floor(math.log10(width)), 8)
    first, last = (f"{round(v, digits) + 0.0:.{max(digits, 0)}f}" for v in (low, high))
    return f"{first} to {last}"


def row_lines(rows: Sequence[ReportRow], max_lines: int | None = None) -> list[str]:
    """Aligned lines for a terminal; the last says how many rows beyond `max_lines` are left out."""
    cells = [(printable(r.name), r.interval, r.unit, r.verdict, printable(r.reason)) for r in rows]
    if max_lines is not None and len(cells) > max_lines:
        more = len(cells) - max_lines + 1
        cells = [*cells[: max_lines - 1], (f"... {more} more in report.csv", "", "", "", "")]
    return aligned(cells)
