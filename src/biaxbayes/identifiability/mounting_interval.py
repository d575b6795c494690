"""Reported interval of a mounting stretch, whatever law the tissue follows.

A posterior holds within its law. The way from the unloaded to the mounted state was not measured:
each law extrapolates it in its own way, and laws that fit equally well may put the mounting stretch
elsewhere. The true law is none of those that are fitted. So each law's estimate gets its standard
error (noise of all readings, model error of the law) and an allowance for a further law. Over all
laws that fit, but at least two, take the smallest 5 % and the largest 95 % limit:

- if they lie close together, both are reported: a value;
- else the lower one alone. Tissue stiffens as it is stretched: a toe region that is softer than
  those of the laws only moves the mounting stretch up;
- if that lies far below the estimate of the best law, nothing is reported.

Where the law of the run is among those that fit, its posterior interval, widened for model
error, is included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import listed
from biaxbayes.fitting.law_fits import MIN_COMPARED_LAWS, LawFits
from biaxbayes.identifiability.marginals import Z90

MEASURED_REASON = "measured before and after mounting"
"""The reason of a mounting stretch that the specimen's header gives."""
FURTHER_LAW = 0.09
"""Allowance for a further law, as a fraction of the strain at mounting."""
VALUE_WIDTH, FARTHEST_BELOW = 0.035, 0.3
"""Largest width of a value, and largest distance of a lower end below the best law."""
# FURTHER_LAW and VALUE_WIDTH were tuned on 606 virtual specimens of seven kinds mounted at 1.02 to
# 1.6, the law of the truth withheld, and 86 mounted at 1.005 to 1.05 with their law among the
# others (seeds 0 to 13 and 200 to 229 of the study of toes); FARTHEST_BELOW on seeds 0 to 35 of
# that of what is reported.
MAX_LOG_DENSITY_GAP = 3.0
"""Laws whose density of what was left out is within 3 nats (a factor of 20) of the best one predict
it about as well; not tuned."""
MAX_NAMED_LAWS = 4
"""Largest number of laws that a reason names."""
NO_BOUND = float("nan")
"""Stands for a bound that is not reported."""


@dataclass(frozen=True)
class MountingInterval:
    """The reported interval of one mounting stretch of the tissue."""

    low: float  # NaN where an end is open
    high: float
    reason: str

    @property
    def is_value(self) -> bool:
        """True if both ends are known."""
        return bool(np.isfinite(self.low) and np.isfinite(self.high))


def measurement_advice(names: Sequence[str]) -> str:
    """Advice on measuring mounting stretches that are not identified, with header lines."""
    lines = " and ".join(f"# {name}: VALUE +- SD" for name in names)
    return (
        "photograph two marks per axis before and after mounting, and write the ratio of their "
        f"distances into the header of the specimen: {lines}"
    )


def prior_ends_message(by_prior: tuple[bool, bool]) -> str:
    """Text on the ends of an interval that the prior determines."""
    if all(by_prior):
        return "the prior determines both ends"
    return f"the prior determines the {'lower' if by_prior[0] else 'upper'} end"


def widen_interval(low: float, median: float, high: float, factor: float) -> tuple[float, float]:
    """An interval scaled by a factor about its median."""
    # [m - f (m - q05), m + f (q95 - m)]
    return median - factor * (median - low), median + factor * (high - median)


def interval_from_laws(
    fits: LawFits,
    index: int,
    axis: int,
    law: str = "",
    interval: tuple[float, float] | None = None,
    *,
    by_prior: tuple[bool, bool] = (False, False),
) -> MountingInterval:
    """Interval of one mounting stretch from the fits of all laws; `axis` is 0 for x, 1 for y."""
    compared = fits.compared
    at = np.array([f.mounting_stretch[index, axis] for f in compared])
    own_error = Z90 * np.array([f.sd[index, axis] for f in compared])
    margin = own_error + FURTHER_LAW * np.abs(at - 1.0)
    low, high = float((at - margin).min()), float((at + margin).max())
    # The interval of the run's law counts if that law fits; an end that the prior decides is open.
    at_prior = (False, False)
    if interval is not None and law in [f.law for f in fits.fitting]:
        at_prior = by_prior[0] and interval[0] <= low, by_prior[1] and interval[1] >= high
        low, high = min(low, interval[0]), max(high, interval[1])
    return _reported((low, high), float(at[0]), [f.law for f in compared], "fit", at_prior)


def interval_from_predictions(
    intervals: Mapping[str, tuple[float, float, float]],
    density: Mapping[str, float],
    *,
    smooth: bool,
) -> MountingInterval:
    """Interval of one mounting stretch from laws that predict the record about equally well.

    Stacking weights measure predictions within the tested range, not in the toe region: the
    interval is the union of those of the laws, each with the allowance for a further law.
    ``intervals`` are 5, 50 and 95 % of each posterior, ``density`` is the log density of what was
    left out, nats. If the best law misses the record smoothly, which its posterior does not know,
    no value is reported.
    """
    ordered = sorted(intervals, key=lambda law: -density[law])
    near = [law for law in ordered if density[ordered[0]] - density[law] <= MAX_LOG_DENSITY_GAP]
    compared = ordered[: max(MIN_COMPARED_LAWS, len(near))]
    margin = {law: FURTHER_LAW * abs(q50 - 1.0) for law, (_, q50, _) in intervals.items()}
    low = min(intervals[law][0] - margin[law] for law in compared)
    high = max(intervals[law][2] + margin[law] for law in compared)
    best = intervals[ordered[0]][1]
    return _reported((low, high), best, compared, "predict", smooth=smooth)


def _reported(
    ends: tuple[float, float],
    best: float,
    laws: Sequence[str],
    verb: str,
    at_prior: tuple[bool, bool] = (False, False),
    *,
    smooth: bool = False,
) -> MountingInterval:
    """A value, a lower end or nothing; `at_prior` are the ends that rest on the prior."""
    low, high = ends
    those = f"the laws that {verb} best" if len(laws) > 1 else "the only law"
    more = [f"{len(laws) - MAX_NAMED_LAWS} more"] if len(laws) > MAX_NAMED_LAWS else []
    names = listed([*laws[:MAX_NAMED_LAWS], *more])
    if not any(at_prior) and not smooth and high - low <= VALUE_WIDTH:
        verb = "agree" if len(laws) > 1 else "determines it"
        return MountingInterval(low, high, f"{those} {verb} ({names})")
    # how far the laws with their errors lie apart, and how far they may
    span = f"{those} with {'their' if len(laws) > 1 else 'its'} errors"
    if at_prior[0]:
        return MountingInterval(NO_BOUND, NO_BOUND, prior_ends_message(at_prior))
    if not np.isfinite(low) or best - low > FARTHEST_BELOW:
        why = f"{span} reach more than {FARTHEST_BELOW:g} below the best estimate ({names})"
        return MountingInterval(NO_BOUND, NO_BOUND, why)
    if smooth:
        why = "no law describes the record to its noise, so only a lower bound is safe"
    elif at_prior[1]:
        why = prior_ends_message(at_prior)
    else:
        width = f"span {high - low:.2g}" if np.isfinite(high) else "have no upper end"
        why = f"{span} {width}; a value needs at most {VALUE_WIDTH:g} ({names})"
    return MountingInterval(low, NO_BOUND, why)
