"""Verdict on a parameter from its draws, with every threshold in one place.

- `identified`: both ends of the interval hold
- `bounded`: one end
- `only in combination`: a two-sided interval, wide because the parameter is strongly correlated
  with those named
- `measured`: a mounting stretch that the header gives; the interval is what the record made of it
- `not identified`: the prior, or a choice of the law, decides
- `no verdict`: the chains have not converged, so the run shows nothing about the tissue

A verdict never moves an interval, the 5 and 95 % quantiles of the draws.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

from biaxbayes.errors import listed
from biaxbayes.identifiability.marginals import ComparisonScale, Density, RangeEnd
from biaxbayes.identifiability.partners import Partners
from biaxbayes.laws.law import Law
from biaxbayes.model.priors import DrawnPrior, Prior
from biaxbayes.parameters import STRETCH, Parameter

IDENTIFIED = "identified"
BOUNDED = "bounded"
COMBINATION = "only in combination"
NOT_IDENTIFIED = "not identified"
MEASURED = "measured"
VERDICTS = (IDENTIFIED, MEASURED, BOUNDED, COMBINATION, NOT_IDENTIFIED)
"""Reported verdicts; further ones are :data:`NO_VERDICT` of chains that have not converged, and
:data:`FIXED`."""
NO_VERDICT = "no verdict"
FIXED = "fixed"
AXES: dict[int | None, str] = {0: "_x", 1: "_y"}


@dataclass(frozen=True)
class Thresholds:
    """Every number a verdict depends on; the widths of sharp intervals are `Parameter.sharp`."""

    # an end of the range is open where the averaged likelihood there is at least this fraction of
    # its maximum: exp(-1.92), the end of a 95 % likelihood interval
    edge_support: float = 0.147
    # a parameter is correlated with its partners where knowing them cuts its sd to this fraction
    combination_spread: float = 0.5
    # a correlated parameter is known on its own if its interval is at most this many times as wide
    # as a sharp one (1 if a partner may lie at an end of its range). Chosen on seeds 0 to 35 of the
    # study of reported intervals
    traded_width: float = 2.0
    # the fraction of the prior that the data have to exclude for a one-sided verdict
    one_sided_excluded: float = 0.25
    # prior-dominated where the variance shrinks by less than this; 0.75 is half the prior's sd: for
    # normal densities the data then count three times as much as the prior
    contraction: float = 0.75
    # with separate peaks, prior-dominated only if less of the prior is excluded as well
    prior_excluded: float = 0.5
    # a stiffness or exponent known only to a larger factor is not identified
    max_ratio: float = 10.0

    def items(self, parameters: Iterable[Parameter]) -> list[tuple[str, float]]:
        """Names and values, with the widths of sharp intervals, for the header of a file."""
        numbers = [(f.name, float(getattr(self, f.name))) for f in fields(self)]
        widths: dict[str, float] = {}
        for p in parameters:
            stem = "log" if p.logarithmic else p.label.removesuffix(AXES.get(p.axis, ""))
            widths.setdefault(f"sharp_{stem}", p.sharp)
        return [*numbers, *widths.items()]


@dataclass(frozen=True)
class Diagnostics:
    """Diagnostics of a sampled parameter; spreads are on its sampling scale."""

    parameter: Parameter
    median: float
    low: float  # 90 % interval, natural units
    high: float
    prior_sd: float
    posterior_sd: float
    prior_excluded: float  # fraction of the prior where the likelihood is below `edge_support`
    ends: tuple[RangeEnd, ...]
    partners: Partners
    modes: int
    prior_sensitivity: float  # by power-scaling, as the next
    likelihood_sensitivity: float
    by_prior: tuple[bool, bool] = (False, False)  # the prior decides the (low, high) end
    prior_density: Density | None = field(default=None, repr=False)
    posterior_density: Density | None = field(default=None, repr=False)

    @property
    def contraction(self) -> float:
        """1 - posterior variance / prior variance."""
        return 1.0 - (self.posterior_sd / self.prior_sd) ** 2

    def open_ends(self, thresholds: Thresholds) -> tuple[RangeEnd, ...]:
        """Ends of the range that the data do not exclude."""
        return tuple(e for e in self.ends if e.support >= thresholds.edge_support)


@dataclass(frozen=True)
class Assessment:
    """A verdict with its reason."""

    verdict: str
    reason: str
    bound: str = ""  # of a bounded parameter the end that holds: low or high


@dataclass(frozen=True)
class ParameterVerdict:
    """The verdict on one parameter, with its diagnostics (None if fixed, or of unusable draws)."""

    scale: ComparisonScale
    assessment: Assessment
    diagnostics: Diagnostics | None = None

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.scale.name

    @property
    def verdict(self) -> str:
        """One of :data:`VERDICTS`, :data:`NO_VERDICT` or :data:`FIXED`."""
        return self.assessment.verdict


PRIOR_DECIDES = "the prior, not the data, determines it"
DATA_DECIDE = "the data determine it"


def assess_material(
    e: Diagnostics, scale: ComparisonScale, thresholds: Thresholds, weak: set[str], undefined: str
) -> Assessment:
    """Verdict on a parameter of a law (or of a population); the first condition that applies.

    ``weak`` are weakly identified parameters: open at an end, or hardly narrower than their prior.
    ``undefined`` says why this one may have no meaning, and is empty where it has.
    """
    t, p = thresholds, scale.parameter
    correlated = e.partners.spread_given_partners <= t.combination_spread
    trades = f"trades with {listed(e.partners.names)}" if correlated else ""
    if undefined:  # at an end that is not excluded: no value is, however narrow
        return Assessment(COMBINATION if correlated else NOT_IDENTIFIED, undefined)
    # with a weakly identified partner a parameter may lie far from the truth
    widest = 1.0 if not weak.isdisjoint(e.partners.names) else t.traded_width
    if correlated and not p.is_sharp(e.low, e.high, widest):
        if e.contraction <= 0.0:
            return Assessment(NOT_IDENTIFIED, "its interval is as wide as the prior")
        return Assessment(COMBINATION, trades)
    ends = e.open_ends(t)
    bounds = [x.value for x in ends if x.kind == "user"]
    if bounds:
        return Assessment(NOT_IDENTIFIED, f"limited by the prior bound {p.number(bounds[0])}")
    if any(x.kind == "prior" for x in ends):
        return Assessment(NOT_IDENTIFIED, PRIOR_DECIDES)
    if len(ends) == 2:
        return Assessment(NOT_IDENTIFIED, "the data exclude no end of its range")
    # two narrow peaks have a large sd, but unlike a prior they exclude values: those count
    informed = e.contraction >= t.contraction or (
        e.modes > 1 and e.prior_excluded >= t.prior_excluded
    )
    if ends and (informed or e.prior_excluded >= t.one_sided_excluded):
        side = ends[0].side
        end = (p.at_low, p.at_high)[side] or f"the {('lower', 'upper')[side]} end of its range"
        bound = ("high", "low")[side]
        return Assessment(BOUNDED, f"the data are compatible with {end}", bound)
    if not informed:
        return Assessment(NOT_IDENTIFIED, PRIOR_DECIDES)
    if p.logarithmic and e.high > t.max_ratio * e.low:
        ratio = e.high / max(e.low, 1e-300)
        return Assessment(NOT_IDENTIFIED, f"known only to a factor of {ratio:.2g}")
    return Assessment(IDENTIFIED, "; ".join(filter(None, (DATA_DECIDE, trades))))


NARROWED, MOVED = 0.7, 2.0
"""A record narrows a measured stretch where it leaves less than this fraction of its sd, and moves
it where the median lies further from its mean than so many of its sds."""


def assess_stretch(
    e: Diagnostics, thresholds: Thresholds, measured: tuple[float, float] | None
) -> Assessment:
    """Verdict on a mounting stretch: its lower end may hold where the upper one does not.

    Tissue stiffens as it is stretched, so a toe region that is softer than that of the laws only
    moves the mounting stretch up. ``measured`` are mean and sd that the header gives.
    """
    if measured:
        mean, sd = measured
        moved = (e.median - mean) / sd
        words = f"{mean:g} \u00b1 {sd:g} in the header"
        if abs(moved) > MOVED:
            words += f"; the record moves it by {abs(moved):.1f} sd"
        elif e.posterior_sd < NARROWED * sd:
            words += "; the record narrows it"
        return Assessment(MEASURED, words)
    opened = {x.side for x in e.open_ends(thresholds)}
    opened |= {side for side, by_prior in enumerate(e.by_prior) if by_prior}
    if e.contraction < thresholds.contraction:
        opened.add(1)
    if 0 in opened:
        return Assessment(NOT_IDENTIFIED, PRIOR_DECIDES)
    if 1 in opened:
        return Assessment(BOUNDED, "the prior determines the upper end", "low")
    # unlike a parameter of the law it is a fact of the specimen, and laws differ on it
    return Assessment(IDENTIFIED, f"given the law, {DATA_DECIDE}")


def assess_parameters(
    scales: Sequence[ComparisonScale],
    diagnostics: Mapping[str, Diagnostics],
    law: Law,
    state: str,
    *,
    thresholds: Thresholds,
    measured: Mapping[str, tuple[float, float]] | None = None,
    given: Collection[str] = (),
) -> tuple[ParameterVerdict, ...]:
    """Verdicts on parameters; `diagnostics` lacks fixed parameters and those of unusable draws.

    ``measured`` are mean and sd of the mounting stretches that the headers give, ``given`` the
    parameters whose priors the user chose.
    """
    at_end = {  # parameters that may lie at an end of the law, with its sides
        name: sides
        for name, e in diagnostics.items()
        if (sides := {x.side for x in e.open_ends(thresholds) if x.kind == "physical"})
    }
    weak = set(at_end) | {
        name for name, e in diagnostics.items() if e.contraction < thresholds.contraction
    }
    undefined = {}  # parameters that are undefined at an end of another one
    for name, causes in law.undefined_at.items():
        possible = [words for other, side, words in causes if side in at_end.get(other, ())]
        if possible:
            verb = "are" if len(possible) > 1 else "is"
            undefined[name] = (
                f"{listed(possible)}, where no angle means anything, {verb} not excluded"
            )
    by_prior = [n for n in given if n in diagnostics and n in weak - set(at_end)]
    out = []
    for scale in scales:
        e = diagnostics.get(scale.name)
        if not isinstance(scale.prior, Prior | DrawnPrior):
            assessment = Assessment(FIXED, "")
        elif e is None or state != "converged":
            assessment = Assessment(NO_VERDICT, "chains have not converged")
        elif scale.parameter.kind == STRETCH:
            assessment = assess_stretch(e, thresholds, (measured or {}).get(scale.name))
        else:
            assessment = assess_material(e, scale, thresholds, weak, undefined.get(scale.name, ""))
            if by_prior and assessment.verdict == IDENTIFIED:
                words = f"given your prior of {listed(by_prior)}, {assessment.reason}"
                assessment = replace(assessment, reason=words)
        out.append(ParameterVerdict(scale, assessment, e))
    return tuple(out)
