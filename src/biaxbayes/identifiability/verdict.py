"""From evidence to a verdict, and verdicts as sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

from biaxbayes.identifiability.marginals import Edge, Scale, end_in_words
from biaxbayes.identifiability.mounting_stretch.stated import ends_by_prior_words
from biaxbayes.identifiability.sloppiness import Partners
from biaxbayes.identifiability.verdict_names import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
)
from biaxbayes.model.priors import Tie
from biaxbayes.parameters import Parameter

__all__ = ["Evidence", "Thresholds", "decide", "in_words", "interval_words"]


# --- verdicts as sentences -----------------------------------------------------------------------


SENSITIVE = 0.05


def interval_words(scale: Scale, evidence: Evidence) -> str:
    """The 90 % interval with its unit."""
    p = scale.parameter
    return f"{p.number(evidence.low)} to {p.number(evidence.high)}{p.unit_words()} (90 %)"


def in_words(
    scale: Scale,
    verdict: str,
    evidence: Evidence | None,
    thresholds: Thresholds,
    state: str,
    *,
    meaningless: str = "",
) -> str:
    """One sentence on one parameter.

    Parameters
    ----------
    scale : Scale
    verdict : str
    evidence : Evidence, optional
        None for a fixed or tied parameter.
    thresholds : Thresholds
    state : str
        Of the run.
    meaningless : str
        Where the data leave an end of another parameter possible at which this one means
        nothing: words that say so.
    """
    name = scale.name
    if verdict == NO_VERDICT:
        return f"{name}: no verdict, the chains have not converged ({state})"
    if verdict == FIXED or evidence is None:
        held = scale.prior
        if isinstance(held, Tie):
            return f"{name}: tied, {held.factor:g} times {held.other}"
        return f"{name}: fixed at {held:g}" if isinstance(held, float | int) else f"{name}: fixed"
    tell = {
        IDENTIFIED: _identified,
        BOUNDED: _one_sided,
        COMBINATION: _combination,
        NOT_IDENTIFIED: _not_identified if evidence.refits else _by_prior,
    }[verdict]
    text = tell(scale, evidence, thresholds)
    if meaningless:
        text += f"; {meaningless}"
    if evidence.modes > 1:
        text += f"; {evidence.modes} separate peaks"
    if evidence.prior_sensitivity >= SENSITIVE and verdict != NOT_IDENTIFIED:
        text += "; sensitive to the prior"
    if any(evidence.by_prior):
        text += f"; {ends_by_prior_words(evidence.by_prior)}"
    return f"{name}: {text}"


def _identified(scale: Scale, e: Evidence, t: Thresholds) -> str:
    loose = "" if e.parameter.is_sharp(e.low, e.high) else ", but loosely"
    return f"identified{loose}, {interval_words(scale, e)}"


def _one_sided(scale: Scale, e: Evidence, t: Thresholds) -> str:
    edge = e.open_edges(t)[0]
    p = scale.parameter
    limit = f"below {p.number(e.high)}" if edge.side == 0 else f"above {p.number(e.low)}"
    return f"bounded, {limit}{p.unit_words()} (95 %); the data do not exclude {_end(scale, edge)}"


def _combination(scale: Scale, e: Evidence, t: Thresholds) -> str:
    share = 100.0 * e.partners.spread_given_partners
    text = (
        f"only in combination with {listed(e.partners.names)}; alone {interval_words(scale, e)}; "
        f"if {'it was' if len(e.partners.names) == 1 else 'they were'} known, the interval would "
        f"shrink to {share:.0f} % of that width"
    )
    ends = [_end(scale, edge) for edge in e.open_edges(t) if edge.kind == "physical"]
    return text + (f"; {' and '.join(ends)} not excluded" if ends else "")


def _by_prior(scale: Scale, e: Evidence, t: Thresholds) -> str:
    bounds = [edge for edge in e.open_edges(t) if edge.kind == "user"]
    if bounds:
        where = " and ".join(scale.parameter.number(edge.value) for edge in bounds)
        return f"not identified, {interval_words(scale, e)}; held by the bound {where} of its prior"
    return (
        f"not identified, {interval_words(scale, e)}; the data take "
        f"{100.0 * max(e.contraction, 0.0):.0f} % off the prior's variance"
    )


def _not_identified(scale: Scale, e: Evidence, t: Thresholds) -> str:
    assert e.refits is not None
    low, high = (scale.parameter.number(v) for v in e.refits)
    return (
        f"not identified, between {low} and {high} by fits to parts of the record; "
        f"{interval_words(scale, e)} rests on the model's toe, which these data contradict"
    )


def _end(scale: Scale, edge: Edge) -> str:
    return end_in_words(edge.value, edge.meaning(scale.parameter))


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: ``k2, alpha and kappa``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


# --- from evidence to a verdict, with every threshold in one place -------------------------------


@dataclass(frozen=True)
class Thresholds:
    """Every number that a verdict depends on, but for the widths of sharp intervals.

    Those are of the parameters (:attr:`~biaxbayes.parameters.Parameter.sharp`).

    Attributes
    ----------
    edge_support : float
        An end of the range is open where the averaged likelihood there is at least this
        share of its maximum: exp(-1.92), the edge of a 95 % likelihood interval.
    combination_spread : float
        A parameter is traded where knowing its partners cuts its standard deviation to this
        share, or less.
    traded_width : float
        A traded parameter is known on its own where its interval is at most so many times as wide
        as a sharp one.
    one_sided_excluded : float
        One-sided needs data that exclude at least this share of the prior.
    contraction, prior_excluded : float
        Prior-dominated where the variance shrinks by less than the first; with separate peaks
        only if the data exclude less than the second of the prior as well. A contraction of 0.75
        is a spread of half the prior's; for normal densities the data then tell three times as
        much as the prior.
    refit_errors : float
        Where the model misses smoothly, so many times the change of the mounting stretch that
        balances the largest miss near the mounted state are added to the range of the refits.
    refit_share : float
        A mounting stretch is not identified where its interval is less than this share of that
        range.
    """

    edge_support: float = 0.147
    combination_spread: float = 0.5
    traded_width: float = 2.0
    one_sided_excluded: float = 0.25
    contraction: float = 0.75
    prior_excluded: float = 0.5
    refit_errors: float = 1.645
    refit_share: float = 0.5

    def traded(self, evidence: Evidence) -> bool:
        """Whether a parameter is traded with its partners."""
        return evidence.partners.spread_given_partners <= self.combination_spread

    def items(self, parameters: Iterable[Parameter]) -> list[tuple[str, float]]:
        """Names and values, with the widths of sharp intervals, for the header of a file."""
        own = [(f.name, float(getattr(self, f.name))) for f in fields(self)]
        widths: dict[str, float] = {}
        for p in parameters:
            stem = "log" if p.logarithmic else p.label.removesuffix(AXES.get(p.axis, ""))
            widths.setdefault(f"sharp_{stem}", p.sharp)
        refits = next(i for i, (name, _) in enumerate(own) if name.startswith("refit"))
        return [*own[:refits], *widths.items(), *own[refits:]]


AXES: dict[int | None, str] = {0: "_x", 1: "_y"}


@dataclass(frozen=True)
class Evidence:
    """What is known of a sampled parameter; spreads are on its sampling scale.

    Attributes
    ----------
    parameter : Parameter
    median, low, high : float
        Median and 90 % interval, natural units.
    prior_sd, posterior_sd : float
    prior_excluded : float
        Share of the prior where the averaged likelihood is below ``edge_support`` of its maximum.
    edges : tuple of Edge
    partners : Partners
    modes : int
    prior_sensitivity, likelihood_sensitivity : float
        By power-scaling.
    refits : (float, float), optional
        Range of a mounting stretch in fits to parts of a record that the model misses.
    by_prior : (bool, bool)
        Whether its own prior decides the low and the high end of the interval of a mounting
        stretch.
    """

    parameter: Parameter
    median: float
    low: float
    high: float
    prior_sd: float
    posterior_sd: float
    prior_excluded: float
    edges: tuple[Edge, ...]
    partners: Partners
    modes: int
    prior_sensitivity: float
    likelihood_sensitivity: float
    refits: tuple[float, float] | None = None
    by_prior: tuple[bool, bool] = (False, False)

    @property
    def contraction(self) -> float:
        """1 - posterior variance / prior variance."""
        return 1.0 - (self.posterior_sd / self.prior_sd) ** 2

    def open_edges(self, thresholds: Thresholds) -> tuple[Edge, ...]:
        """Ends of the range that the data do not exclude."""
        return tuple(e for e in self.edges if e.support >= thresholds.edge_support)


def contradicted(e: Evidence, t: Thresholds) -> bool:
    """Whether fits to parts of the record contradict the interval of a mounting stretch."""
    return e.refits is not None and e.high - e.low < t.refit_share * (e.refits[1] - e.refits[0])


def decide(evidence: Evidence, thresholds: Thresholds, *, meaningless: bool = False) -> str:
    """The verdict on a sampled parameter of converged draws.

    A mounting stretch that the data contradict is not identified, whatever else. Else traded with
    others comes first, unless the interval is narrow enough to use the parameter on its own.

    Parameters
    ----------
    evidence : Evidence
    thresholds : Thresholds
    meaningless : bool
        The data do not exclude that the parameter means nothing (an angle where the fibres are
        isotropic): no value of it is excluded then, however narrow its posterior.
    """
    e, t = evidence, thresholds
    if contradicted(e, t):
        return NOT_IDENTIFIED
    traded = t.traded(e)
    if meaningless:
        return COMBINATION if traded else NOT_IDENTIFIED
    if traded and not e.parameter.is_sharp(e.low, e.high, t.traded_width):
        return COMBINATION
    ends = e.open_edges(t)
    if any(edge.kind != "physical" for edge in ends) or len(ends) == 2:
        return NOT_IDENTIFIED
    if ends and e.prior_excluded >= t.one_sided_excluded:
        return BOUNDED
    # Two narrow peaks have a wide spread and are no prior: what they exclude tells.
    if e.contraction < t.contraction and (e.modes < 2 or e.prior_excluded < t.prior_excluded):
        return NOT_IDENTIFIED
    return BOUNDED if ends else IDENTIFIED
