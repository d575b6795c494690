"""What can be stated of the mounting stretch of the tissue, whatever law it follows.

A posterior holds within its law. The way from the unloaded to the mounted state was not measured:
each law extrapolates it in its own way, and laws that describe the record alike may put the
mounting stretch elsewhere. The tissue follows one more law than those that are fitted. So the other
laws are fitted under the same mounting constraint, each mounting stretch errs by its own error and
by a share of its strain that a further law may add, and

- where the laws that describe the record about as well agree, a value is stated: both ends;
- else the low end alone, that of two laws at least: one that describes the record alone tells
  nothing of how far laws differ. Tissue stiffens as it is stretched: a toe that is softer than
  those of the laws only moves the mounting stretch up;
- where nothing describes the record, or the mounted state carries no load to speak of, nothing is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.fitting.constrained import LawFit
from biaxbayes.identifiability.mounting_stretch.law_range import FEWEST, LawRange
from biaxbayes.parameters import Parameter, mounting_names

if TYPE_CHECKING:
    from biaxbayes.model.posterior import Posterior

__all__ = [
    "MEASURED",
    "Stated",
    "cure",
    "ends_by_prior_words",
    "stated_by_laws",
    "stated_by_predictions",
    "stated_mounting",
]

MEASURED = "measured before and after mounting"
"""The reason of a mounting stretch that the specimen's header states."""
FURTHER_LAW = 0.09
"""Share of the strain at mounting that a law beyond those that are fitted may add or take."""
LOW_ERRORS, FARTHEST_BELOW = 0.5, 0.2
"""Of its own errors a low end lies so many below a law's mounting stretch; where that is so far
below the best law's own, nothing is stated."""
VALUE_ERRORS, VALUE_WIDTH = 1.645, 0.035
"""Own errors on either side of a law's mounting stretch in a value, and how wide one may be."""
# The numbers above were tuned on 606 virtual specimens of seven kinds, mounted at 1.02 to 1.6, the
# law of the truth withheld, and 86 mounted at 1.005 to 1.05 with their law among the others (seeds
# 0 to 13 and 200 to 229 of the study of toes); the page on the laws has what came of it on others.
NEAR_DENSITY = 3.0
"""Laws that foretell what was left out with a density of so many nats less than the best one, a
twentieth of it, foretell it about as well; not tuned."""


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
        "to know it, measure it: photograph two marks an axis before and after mounting; the ratio "
        f"of their distances, with its sd, goes into the header of the specimen: {lines}"
    )


def ends_by_prior_words(by_prior: tuple[bool, bool]) -> str:
    """Which ends of an interval the prior decides."""
    if all(by_prior):
        return "both ends by the prior"
    return f"{'low' if by_prior[0] else 'high'} end by the prior"


def stated_mounting(
    posterior: Posterior,
    intervals: Mapping[str, tuple[float, float]],
    found: LawRange | None,
    by_prior: Mapping[str, tuple[bool, bool]] | None = None,
) -> dict[str, Stated]:
    """State the mounting stretches of the tissue, by name.

    Parameters
    ----------
    posterior : Posterior
        With the mounting stretch as an unknown.
    intervals : mapping of str to (float, float)
        90 % intervals within the law, by the names of the mounting stretches.
    found : LawRange or None
        From :func:`~biaxbayes.identifiability.mounting_stretch.law_range.law_fits`.
    by_prior : mapping of str to (bool, bool), optional
        Whether the prior decides the low and the high end of an interval.
    """
    out = {}
    for i, state in enumerate(posterior.mounts):
        for axis, name in enumerate(mounting_names("stretch", state)):
            if name not in intervals:
                continue
            if posterior.specimen.metadata.get(name) is not None:
                low, high = intervals[name]
                out[name] = Stated(low, high, MEASURED)
            else:
                decided = (by_prior or {}).get(name, (False, False))
                law, interval = posterior.law.name, intervals[name]
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
        Of a run, whose ``interval`` counts where the law is among those that describe the record.
    interval : (float, float), optional
        90 % interval within that law.
    by_prior : (bool, bool)
        Whether the prior decides the low and the high end of that interval: where they are those
        that are stated, the reason says so.
    """
    open_ = float("nan")
    if found is None:
        return Stated(open_, open_, "no law could be fitted to the record")
    first, alike = found.fits[0], found.alike
    own = [interval] if interval is not None and law in [f.law for f in alike] else []

    def ends(fits: Sequence[LawFit], errors: float) -> tuple[float, float]:
        """Lowest and highest of some laws, with so many own errors and what a further law adds."""
        at = np.array([f.mounting_stretch[index, axis] for f in fits])
        margin = errors * np.array([f.sd[index, axis] for f in fits])
        margin = margin + FURTHER_LAW * np.abs(at - 1.0)
        return (
            float(min([*(at - margin), *(a for a, _ in own)])),
            float(max([*(at + margin), *(b for _, b in own)])),
        )

    def by_prior_words(*stated: float) -> str:
        """Which of the stated ends are those of the interval, and by the prior."""
        low, high = (
            bool(own) and own[0][side] == end and by_prior[side] for side, end in enumerate(stated)
        )
        return f"; {ends_by_prior_words((low, high))}" if low or high else ""

    least, _ = ends(found.lowest_of, LOW_ERRORS)
    return _judged(
        ends(alike, VALUE_ERRORS),
        (least, first.mounting_stretch[index, axis]),
        ([f.law for f in alike], [f.law for f in found.lowest_of]),
        "describe",
        # by the signs of the residuals: a worse load cell never makes for a better statement
        smooth=first.smooth,
        softens=found.softens(index, axis),
        by_prior_words=by_prior_words,
    )


def stated_by_predictions(
    intervals: Mapping[str, tuple[float, float, float]],
    density: Mapping[str, float],
    *,
    smooth: bool,
    softens: bool = False,
) -> Stated:
    """State one mounting stretch by the posteriors of laws that foretell the record alike.

    Stacking weights speak of stretches that were tested, never of the toe. So it is the union of
    the intervals of the laws that foretell what was left out about as well as the best, each wider
    by what a further law may add.

    Parameters
    ----------
    intervals : mapping of str to (float, float, float)
        5, 50 and 95 % of each law's posterior.
    density : mapping of str to float
        Of what was left out, nats.
    smooth : bool
        Whether the law that fits best misses the record smoothly.
    softens : bool
        As of :meth:`~biaxbayes.identifiability.mounting_stretch.law_range.LawRange.softens`.
    """
    ordered = sorted(intervals, key=lambda law: -density[law])
    near = [law for law in ordered if density[ordered[0]] - density[law] <= NEAR_DENSITY]
    lowest = ordered[: max(FEWEST, len(near))]
    margin = {law: FURTHER_LAW * abs(q50 - 1.0) for law, (_, q50, _) in intervals.items()}
    return _judged(
        (
            min(intervals[law][0] - margin[law] for law in near),
            max(intervals[law][2] + margin[law] for law in near),
        ),
        (min(intervals[law][0] - margin[law] for law in lowest), intervals[ordered[0]][1]),
        (near, lowest),
        "foretell",
        smooth=smooth,
        softens=softens,
    )


def _judged(
    value: tuple[float, float],
    low: tuple[float, float],
    laws: tuple[Sequence[str], Sequence[str]],
    do: str,
    *,
    smooth: bool,
    softens: bool,
    by_prior_words: Callable[..., str] = lambda *ends: "",
) -> Stated:
    """A value, a low end or nothing, with the reason.

    ``value`` are its ends, ``low`` a low end and the best law's own stretch, ``laws`` those behind
    either.
    """
    open_ = float("nan")
    names, does = ", ".join(laws[0]), f"{do}s"
    if not smooth and not softens and value[1] - value[0] <= VALUE_WIDTH:
        agree = (
            f"laws that {do} the record agree" if len(laws[0]) > 1 else "of the only law so good"
        )
        return Stated(*value, f"{agree}: {names}" + by_prior_words(*value))
    least, best = low
    if not np.isfinite(least) or best - least > FARTHEST_BELOW:
        said = ", ".join(laws[1])
        return Stated(open_, open_, f"laws that {do} the record alike leave it open: {said}")
    if smooth:
        why = "every law misses the record smoothly, and softer toes lie higher"
    elif softens:
        why = f"tissue would soften beyond the mounted state by {names}, and softer toes lie higher"
    elif len(laws[0]) == 1:
        why = f"only {names} {does} the record, and leaves its high end wide"
    else:
        why = f"laws that {do} the record alike differ above it: {names}"
    return Stated(least, open_, why + by_prior_words(least, open_))
