"""What to report of every parameter: one interval or bound, one verdict, one short reason.

`identified` is a two-sided interval that no other law, no misfit and no prior takes away; `bounded`
one end; `only in combination` an interval that shrinks once the named partners are known; `not
identified` neither. Intervals are 90 %, bounds 95 %.

A posterior holds within its law. Where the law misses the record smoothly, its intervals are too
narrow: each is widened about its median by the ratio of two errors of the least squares, with the
smooth misfit and without (:mod:`biaxbayes.fitting.law_fit`). Where another law describes the record
distinctly better, a parameter of this law is no property of the tissue. Mounting stretches are
those on which all laws that fit agree (:mod:`.mounting_stretch.stated`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.identifiability.marginals import Scale
from biaxbayes.identifiability.mounting_stretch.law_range import LawRange, distinctly_better
from biaxbayes.identifiability.mounting_stretch.stated import widened
from biaxbayes.identifiability.verdict import Evidence, Thresholds, decide, listed
from biaxbayes.identifiability.verdict_names import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
)
from biaxbayes.laws.law import Law
from biaxbayes.parameters import MATERIAL

if TYPE_CHECKING:
    from biaxbayes.identifiability.identify import ParameterVerdict

OPEN = float("nan")
PRIOR_DECIDES = "the prior, not the data, determines it"
WIDEST = 10.0
"""Ratio of the ends of an interval of a stiffness or an exponent beyond which it is no value."""
NAMED_WIDENING = 1.2
"""A reason names the widening of an interval from here on."""


@dataclass(frozen=True)
class Reported:
    """What to report of one parameter.

    Attributes
    ----------
    name, unit : str
        As in ``summary.csv``; the unit is empty for pure numbers.
    low, high : float
        The 90 % interval, or one end of it (95 %); NaN where an end is open.
    verdict : {"identified", "bounded", "only in combination", "not identified"}
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
    fits: LawRange | None,
    law: Law,
    state: str,
    thresholds: Thresholds,
) -> tuple[Reported, ...]:
    """What to report of the inferred parameters, in their order; not of fixed and tied ones.

    Parameters
    ----------
    parameters : sequence of ParameterVerdict
    fits : LawRange or None
        Fits of all laws to the record.
    law : Law
        Of the run.
    state : {"converged", "tentative", "unusable"}
        Of the run.
    thresholds : Thresholds
    """
    out = []
    for p in parameters:
        if p.verdict == FIXED:
            continue
        if p.verdict == NO_VERDICT or p.evidence is None:
            reason = f"the chains have not converged ({state})"
            out.append(Reported(p.name, p.scale.unit, OPEN, OPEN, NOT_IDENTIFIED, reason))
        elif p.scale.parameter.kind == MATERIAL:
            out.append(_material(p, p.evidence, fits, law, thresholds))
        else:
            out.append(_mounting_stretch(p))
    return tuple(out)


def _mounting_stretch(p: ParameterVerdict) -> Reported:
    unit = p.scale.unit
    if p.stated is None:
        return Reported(p.name, unit, OPEN, OPEN, NOT_IDENTIFIED, "no other law was fitted")
    low, high, reason = p.stated.low, p.stated.high, p.stated.reason
    verdict = {0: NOT_IDENTIFIED, 1: BOUNDED, 2: IDENTIFIED}[int(np.isfinite([low, high]).sum())]
    return Reported(p.name, unit, low, high, verdict, reason)


def _material(
    p: ParameterVerdict, e: Evidence, fits: LawRange | None, law: Law, thresholds: Thresholds
) -> Reported:
    scale = p.scale
    name, unit = p.name, scale.unit

    def nothing(reason: str) -> Reported:
        return Reported(name, unit, OPEN, OPEN, NOT_IDENTIFIED, reason)

    own = None if fits is None else fits[law.name]
    if fits is not None and (better := distinctly_better(fits, law.name)):
        return nothing(better)
    if p.verdict == NOT_IDENTIFIED:
        bounds = [edge for edge in e.open_edges(thresholds) if edge.kind == "user"]
        if bounds:
            bound = scale.parameter.number(bounds[0].value)
            return nothing(f"limited by the bound {bound} of its prior")
        return nothing(p.meaningless or PRIOR_DECIDES)
    factor = 1.0 if own is None else own.widening.get(scale.kind, 1.0)
    low, high, open_low, open_high = _interval(scale, e, factor)
    misfit = ""
    if own is not None and factor >= NAMED_WIDENING:
        misfit = (
            f"widened {factor:.2g} times for the smooth misfit of {law.called} "
            f"({100.0 * own.misfit:.2g} % of the load)"
        )
    wide = replace(e, low=low, high=high, posterior_sd=factor * e.posterior_sd)
    verdict = decide(wide, thresholds, meaningless=bool(p.meaningless))
    partners = e.partners.names if thresholds.traded(e) else ()
    trades = f"trades with {listed(partners)}" if partners else ""
    if verdict == COMBINATION:
        if wide.contraction <= 0.0:  # wider than the prior
            return nothing(misfit or PRIOR_DECIDES)
        return Reported(name, unit, low, high, COMBINATION, trades, partners)
    # one-sided where the data do not exclude an end of the range, or the misfit carries it there
    sides = [edge.side for edge in e.open_edges(thresholds)]
    sides += [side for side, at in ((0, open_low), (1, open_high)) if at]
    if len(set(sides)) == 2:
        return nothing(misfit or "the data exclude neither end of its range")
    if sides:
        ends = (OPEN, high) if sides[0] == 0 else (low, OPEN)
        return Reported(name, unit, *ends, BOUNDED, misfit or _end_words(p, sides[0]))
    if verdict == NOT_IDENTIFIED:
        return nothing(misfit or PRIOR_DECIDES)
    if scale.logarithmic and high > WIDEST * low:
        factor_words = f"known only to a factor of {high / low:.2g}"
        return nothing("; ".join(filter(None, (factor_words, misfit))))
    reason = "; ".join(filter(None, (misfit or "the data determine it", trades)))
    return Reported(name, unit, low, high, IDENTIFIED, reason)


def _interval(scale: Scale, e: Evidence, factor: float) -> tuple[float, float, bool, bool]:
    """The widened interval in natural units, and whether it reaches an end of the range."""
    median = float(scale.of(np.array(e.median)))
    ends = scale.of(np.array([e.low, e.high]))
    low, high = scale.natural(np.array(widened(float(ends[0]), median, float(ends[1]), factor)))
    bottom, top = scale.walls
    mirror = scale.parameter.mirror
    out = max(float(low), bottom), min(float(high), top)
    return *out, low <= bottom and not mirror, high >= top and not mirror


def _end_words(p: ParameterVerdict, side: int) -> str:
    parameter = p.scale.parameter
    meaning = (parameter.at_low, parameter.at_high)[side]
    end = f"the {('lower', 'upper')[side]} end of its range"
    return f"the data do not exclude {meaning or end}"
