"""What can be stated of the mounting stretch of the tissue, whatever law it follows.

A posterior holds within its law. The way from the unloaded to the mounted state was not measured:
each law extrapolates it in its own way, and laws that describe the record alike may put the
mounting stretch elsewhere. The tissue follows one more law than those that are fitted. So the other
laws are fitted under the same mounting constraint. Each mounting stretch errs by its own error (the
noise of all readings, the smooth misfit of the law) and by a share of its strain that a further law
may add; both ends stand at 5 and 95 % of that, over all laws that fit and two at least, and

- where they lie close enough, a value is stated: both ends;
- else the low end alone. Tissue stiffens as it is stretched: a toe that
  is softer than those of the laws only moves the mounting stretch up;
- where that lies far below the best law, nothing is.

Where the law of a run is among those that fit, the interval of its posterior counts as one of them,
as much wider as the smooth misfit makes its error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.identifiability.mounting_stretch.law_range import FEWEST, LawRange
from biaxbayes.parameters import Parameter, mounting_names

if TYPE_CHECKING:
    from biaxbayes.model.posterior import Posterior

MEASURED = "measured before and after mounting"
"""The reason of a mounting stretch that the specimen's header states."""
FURTHER_LAW = 0.09
"""Share of the strain at mounting that a law beyond those that are fitted may add or take."""
ERRORS = 1.645
"""Own errors on either side of a law's mounting stretch: 5 and 95 %."""
VALUE_WIDTH, FARTHEST_BELOW = 0.035, 0.3
"""How wide a value may be, and how far below the best law a low end."""
# FURTHER_LAW and VALUE_WIDTH were tuned on 606 virtual specimens of seven kinds mounted at 1.02 to
# 1.6, the law of the truth withheld, and 86 mounted at 1.005 to 1.05 with their law among the
# others (seeds 0 to 13 and 200 to 229 of the study of toes); FARTHEST_BELOW on seeds 0 to 35 of
# that of what is reported.
NEAR_DENSITY = 3.0
"""Laws that predict what was left out with a density of so many nats less than the best one, a
twentieth of it, predict it about as well; not tuned."""
OPEN = float("nan")


@dataclass(frozen=True)
class Stated:
    """What is stated of one mounting stretch of the tissue.

    Attributes
    ----------
    low, high : float
        NaN where an end is open, or nothing is stated.
    reason : str
        Why these ends, in words.
    """

    low: float
    high: float
    reason: str

    @property
    def is_value(self) -> bool:
        """Whether both ends are stated."""
        return bool(np.isfinite(self.low) and np.isfinite(self.high))

    def in_words(self, parameter: Parameter) -> str:
        """What is stated, without the reason."""
        if self.is_value:
            return f"{parameter.number(self.low)} to {parameter.number(self.high)}"
        if np.isfinite(self.low):
            return f"above {parameter.number(self.low)}"
        return "nothing"


def cure(names: Sequence[str]) -> str:
    """What to measure where mounting stretches cannot be stated as values, with lines to paste.

    Parameters
    ----------
    names : sequence of str
        Of the mounting stretches.
    """
    lines = "; ".join(f"# {name}: VALUE +- SD" for name in names)
    return (
        "to know it, measure it: photograph two marks per axis before and after mounting; the "
        "ratio of their distances, with its sd, goes into the header of the specimen: " + lines
    )


def ends_by_prior_words(by_prior: tuple[bool, bool]) -> str:
    """Which ends of an interval the prior decides."""
    if all(by_prior):
        return "both ends by the prior"
    return f"{'low' if by_prior[0] else 'high'} end by the prior"


def widened(low: float, median: float, high: float, factor: float) -> tuple[float, float]:
    """Ends of an interval, so many times as far from its median."""
    return median - factor * (median - low), median + factor * (high - median)


def stated_mounting(
    posterior: Posterior,
    intervals: Mapping[str, tuple[float, float, float]],
    found: LawRange | None,
    by_prior: Mapping[str, tuple[bool, bool]] | None = None,
) -> dict[str, Stated]:
    """State the mounting stretches of the tissue, by name.

    Parameters
    ----------
    posterior : Posterior
        With the mounting stretch as an unknown.
    intervals : mapping of str to (float, float, float)
        5, 50 and 95 % within the law, by the names of the mounting stretches.
    found : LawRange or None
        From :func:`~biaxbayes.identifiability.mounting_stretch.law_range.law_fits`.
    by_prior : mapping of str to (bool, bool), optional
        Whether the prior decides the low and the high end of an interval.
    """
    law = posterior.law.name
    own = found[law] if found is not None else None
    out = {}
    for i, state in enumerate(posterior.mounts):
        for axis, name in enumerate(mounting_names("stretch", state)):
            if name not in intervals:
                continue
            low, median, high = intervals[name]
            if posterior.specimen.metadata.get(name) is not None:
                out[name] = Stated(low, high, MEASURED)
                continue
            factors = None if own is None else own.mounting_widening
            factor = 1.0 if factors is None else float(factors[i, axis])
            interval = widened(low, median, high, factor)
            decided = (by_prior or {}).get(name, (False, False))
            out[name] = stated_by_laws(found, i, axis, law, interval, by_prior=decided)
    return out


def stated_by_laws(
    found: LawRange | None,
    index: int,
    axis: int,
    law: str = "",
    interval: tuple[float, float] | None = None,
    *,
    by_prior: tuple[bool, bool] = (False, False),
) -> Stated:
    """State one mounting stretch.

    Parameters
    ----------
    found : LawRange or None
        From :func:`~biaxbayes.identifiability.mounting_stretch.law_range.law_fits`.
    index, axis : int
        Of the mounted state, and 0 for x, 1 for y.
    law : str
        Of a run, whose ``interval`` counts where the law is among those that fit the record.
    interval : (float, float), optional
        Interval within that law, its error that of the fit.
    by_prior : (bool, bool)
        Whether the prior decides the low and the high end of that interval: an end that rests
        on it is open.
    """
    if found is None:
        return Stated(OPEN, OPEN, "no law could be fitted to the record")
    fits = found.compared
    at = np.array([f.mounting_stretch[index, axis] for f in fits])
    margin = ERRORS * np.array([f.sd[index, axis] for f in fits]) + FURTHER_LAW * np.abs(at - 1.0)
    low, high = float((at - margin).min()), float((at + margin).max())
    at_prior = (False, False)
    if interval is not None and law in [f.law for f in found.alike]:
        at_prior = by_prior[0] and interval[0] <= low, by_prior[1] and interval[1] >= high
        low, high = min(low, interval[0]), max(high, interval[1])
    return _judged((low, high), float(at[0]), [f.law for f in fits], "fit", at_prior)


def stated_by_predictions(
    intervals: Mapping[str, tuple[float, float, float]],
    density: Mapping[str, float],
    *,
    smooth: bool,
) -> Stated:
    """State one mounting stretch by the posteriors of laws that predict the record alike.

    Stacking weights speak of stretches that were tested, never of the toe. So it is the union of
    the intervals of the laws that predict what was left out about as well as the best, each wider
    by what a further law may add.

    Parameters
    ----------
    intervals : mapping of str to (float, float, float)
        5, 50 and 95 % of each law's posterior.
    density : mapping of str to float
        Of what was left out, nats.
    smooth : bool
        Whether the law that predicts best misses the record smoothly: its posterior does not know
        of that, so no value is stated.
    """
    ordered = sorted(intervals, key=lambda law: -density[law])
    near = [law for law in ordered if density[ordered[0]] - density[law] <= NEAR_DENSITY]
    compared = ordered[: max(FEWEST, len(near))]
    margin = {law: FURTHER_LAW * abs(q50 - 1.0) for law, (_, q50, _) in intervals.items()}
    low = min(intervals[law][0] - margin[law] for law in compared)
    high = max(intervals[law][2] + margin[law] for law in compared)
    best = intervals[ordered[0]][1]
    return _judged((low, high), best, compared, "predict", smooth=smooth)


def _judged(
    ends: tuple[float, float],
    best: float,
    laws: Sequence[str],
    verb: str,
    at_prior: tuple[bool, bool] = (False, False),
    *,
    smooth: bool = False,
) -> Stated:
    """A value, a low end or nothing, with the reason.

    ``best`` is the best law's own stretch, ``laws`` are those compared, ``at_prior`` says which
    ends rest on the prior.
    """
    low, high = ends
    those = f"the laws that {verb} best" if len(laws) > 1 else "the only law"
    names = ", ".join(laws)
    if not any(at_prior) and not smooth and high - low <= VALUE_WIDTH:
        return Stated(low, high, f"{those} agree: {names}")
    if at_prior[0]:
        return Stated(OPEN, OPEN, ends_by_prior_words(at_prior))
    if not np.isfinite(low) or best - low > FARTHEST_BELOW:
        return Stated(OPEN, OPEN, f"{those} leave both ends open: {names}")
    if smooth:
        why = "every law misses the record smoothly, so only a lower bound is safe"
    elif at_prior[1]:
        why = ends_by_prior_words(at_prior)
    else:
        why = f"{those} leave the high end open: {names}"
    return Stated(low, OPEN, why)
