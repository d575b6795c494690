"""Verdict on a parameter from its diagnostics, with every threshold in one place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

from biaxbayes.errors import listed
from biaxbayes.identifiability.marginals import Z90, ComparisonScale, Density, Edge
from biaxbayes.identifiability.mounting_interval import MountingInterval
from biaxbayes.identifiability.partners import Partners
from biaxbayes.laws.law import Law
from biaxbayes.model.priors import DrawnPrior, Prior, Tie
from biaxbayes.parameters import Parameter

IDENTIFIED = "identified"
BOUNDED = "bounded"
COMBINATION = "only in combination"
NOT_IDENTIFIED = "not identified"
VERDICTS = (IDENTIFIED, BOUNDED, COMBINATION, NOT_IDENTIFIED)
"""Reported verdicts; further ones are :data:`NO_VERDICT` of chains that have not converged, and
:data:`FIXED`."""
NO_VERDICT = "no verdict"
FIXED = "fixed"
AXES: dict[int | None, str] = {0: "_x", 1: "_y"}


@dataclass(frozen=True)
class Thresholds:
    """Every number a verdict depends on; the widths of sharp intervals are `Parameter.sharp`."""

    # an end of the range is open where the averaged likelihood there is at least this fraction of
    # its maximum: exp(-1.92), the edge of a 95 % likelihood interval
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
    # errors added to the range of the refits: changes of the mounting stretch that balance the
    # largest residual near the mounted state
    refit_errors: float = Z90
    # contradicted where the interval is less than this fraction of the range of the refits
    refit_share: float = 0.5

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
    edges: tuple[Edge, ...]
    partners: Partners
    modes: int
    prior_sensitivity: float  # by power-scaling, as the next
    likelihood_sensitivity: float
    # of a mounting stretch: range of fits to parts of the record
    refits: tuple[float, float] | None = None
    by_prior: tuple[bool, bool] = (False, False)  # the prior decides the (low, high) end
    prior_density: Density | None = field(default=None, repr=False)
    posterior_density: Density | None = field(default=None, repr=False)

    @property
    def contraction(self) -> float:
        """1 - posterior variance / prior variance."""
        return 1.0 - (self.posterior_sd / self.prior_sd) ** 2

    def is_correlated(self, thresholds: Thresholds) -> bool:
        """True if knowing its partners would narrow the parameter much."""
        return self.partners.spread_given_partners <= thresholds.combination_spread

    def is_contradicted(self, thresholds: Thresholds) -> bool:
        """True if fits to parts of the record contradict the interval of a mounting stretch."""
        if self.refits is None:
            return False
        return self.high - self.low < thresholds.refit_share * (self.refits[1] - self.refits[0])

    def open_edges(self, thresholds: Thresholds) -> tuple[Edge, ...]:
        """Ends of the range that the data do not exclude."""
        return tuple(e for e in self.edges if e.support >= thresholds.edge_support)


@dataclass(frozen=True)
class ParameterVerdict:
    """The verdict on one parameter within the law; :class:`Reported` is what follows from it."""

    scale: ComparisonScale
    posterior_verdict: str  # from posterior and prior alone: one of VERDICTS, NO_VERDICT or FIXED
    text: str  # the same as a sentence
    diagnostics: Diagnostics | None = None  # None if fixed or tied, or if draws are unusable
    # of a mounting stretch: the interval all laws agree on
    mounting: MountingInterval | None = None
    undefined: str = ""  # text, if another parameter may lie where this one is undefined

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.scale.name

    @property
    def partners(self) -> tuple[str, ...]:
        """Parameters that it is correlated with, whatever the verdict."""
        return self.diagnostics.partners.names if self.diagnostics else ()


def decide(
    diagnostics: Diagnostics,
    thresholds: Thresholds,
    *,
    undefined: bool = False,
    partner_is_weak: bool = False,
) -> str:
    """The verdict on a sampled parameter of converged draws; the first condition that applies."""
    e, t = diagnostics, thresholds
    if e.is_contradicted(t):
        return NOT_IDENTIFIED
    correlated = e.is_correlated(t)
    if undefined:  # undefined at an end that is not excluded: no value is, however narrow
        return COMBINATION if correlated else NOT_IDENTIFIED
    # With a partner at an end (aligned fibres) or hardly constrained, a parameter may lie far from
    # the truth.
    widest = 1.0 if partner_is_weak else t.traded_width
    if correlated and not e.parameter.is_sharp(e.low, e.high, widest):
        return COMBINATION
    ends = e.open_edges(t)
    if any(edge.kind != "physical" for edge in ends) or len(ends) == 2:
        return NOT_IDENTIFIED
    if ends and e.prior_excluded >= t.one_sided_excluded:
        return BOUNDED
    # Two narrow peaks have a large sd, but unlike a prior they exclude values: those count.
    if e.contraction < t.contraction and (e.modes < 2 or e.prior_excluded < t.prior_excluded):
        return NOT_IDENTIFIED
    return BOUNDED if ends else IDENTIFIED


def assess_parameters(
    scales: Sequence[ComparisonScale],
    diagnostics: Mapping[str, Diagnostics],
    law: Law,
    state: str,
    *,
    thresholds: Thresholds,
    mounting: Mapping[str, MountingInterval] | None = None,
) -> tuple[ParameterVerdict, ...]:
    """Verdicts on parameters; `diagnostics` lacks fixed parameters and those of unusable draws."""
    at_end = {  # parameters that may lie at an end of the law, with its sides
        name: sides
        for name, e in diagnostics.items()
        if (sides := {x.side for x in e.open_edges(thresholds) if x.kind == "physical"})
    }
    undefined = {}  # parameters that are undefined at an end of another one
    for name, causes in law.undefined_at.items():
        possible = [words for other, side, words in causes if side in at_end.get(other, ())]
        if possible:
            verb = "are" if len(possible) > 1 else "is"
            undefined[name] = (
                f"{listed(possible)}, where no angle means anything, {verb} not excluded"
            )
    out = []
    for scale in scales:
        e, interval = diagnostics.get(scale.name), (mounting or {}).get(scale.name)
        why = undefined.get(scale.name, "")
        free = isinstance(scale.prior, Prior | DrawnPrior)
        verdict = NO_VERDICT if free else FIXED
        if e is not None:
            if interval is not None and interval.is_value:
                e = replace(e, refits=None)  # laws that fit agree: no part contradicts them
            partner = not at_end.keys().isdisjoint(e.partners.names)
            verdict = NO_VERDICT
            if state == "converged":
                verdict = decide(e, thresholds, undefined=bool(why), partner_is_weak=partner)
        text = verdict_sentence(scale, verdict, e, thresholds, state, undefined=why)
        out.append(ParameterVerdict(scale, verdict, text, e, interval, why))
    return tuple(out)


# --- verdicts as sentences -----------------------------------------------------------------------

SENSITIVE = 0.05


def verdict_sentence(
    scale: ComparisonScale,
    verdict: str,
    diagnostics: Diagnostics | None,
    thresholds: Thresholds,
    state: str,
    *,
    undefined: str = "",
) -> str:
    """One sentence on one parameter; no diagnostics for a fixed or tied one."""
    name, p, e = scale.name, scale.parameter, diagnostics
    if verdict == NO_VERDICT:
        return f"{name}: no verdict, the chains have not converged ({state})"
    if verdict == FIXED or e is None:
        value = scale.prior
        if isinstance(value, Tie):
            return f"{name}: tied, {value.factor:g} times {value.other}"
        return f"{name}: fixed at {value:g}" if isinstance(value, float | int) else f"{name}: fixed"
    interval = f"{p.number(e.low)} to {p.number(e.high)}{p.unit_words()} (90 %)"
    ends = e.open_edges(thresholds)
    text = f"{verdict}, {interval}"
    if verdict == IDENTIFIED and not p.is_sharp(e.low, e.high):
        text = f"identified, but loosely, {interval}"
    elif verdict == BOUNDED:
        limit = f"below {p.number(e.high)}" if ends[0].side == 0 else f"above {p.number(e.low)}"
        text = f"bounded, {limit}{p.unit_words()} (95 %); the data do not exclude "
        text += ends[0].text(p)
    elif verdict == COMBINATION:
        partners = e.partners.names
        text = (
            f"only in combination with {listed(partners)}; alone {interval}; if "
            f"{'it was' if len(partners) == 1 else 'they were'} known, the interval would shrink "
            f"to {100.0 * e.partners.spread_given_partners:.0f} % of that width"
        )
        physical = [x.text(p) for x in ends if x.kind == "physical"]
        text += f"; {listed(physical)} not excluded" if physical else ""
    elif verdict == NOT_IDENTIFIED:
        bounds = [p.number(edge.value) for edge in ends if edge.kind == "user"]
        if bounds:
            text += f"; limited by the prior bound {listed(bounds)}"
        else:
            share = 100.0 * max(e.contraction, 0.0)
            text += f"; the data reduce the prior variance by {share:.0f} %"
    if undefined:
        text += f"; {undefined}"
    if e.modes > 1:
        text += f"; {e.modes} separate peaks"
    if e.prior_sensitivity >= SENSITIVE and verdict != NOT_IDENTIFIED:
        text += "; sensitive to the prior"
    return f"{name}: {text}"
