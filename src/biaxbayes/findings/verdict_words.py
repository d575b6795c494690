"""Verdicts as sentences."""

from __future__ import annotations

from biaxbayes.findings.edges import Edge
from biaxbayes.findings.sampling_scale import Scale
from biaxbayes.findings.verdict import (
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    ONE_SIDED,
    PRIOR,
    Evidence,
    Thresholds,
)
from biaxbayes.inference.priors import Tie

__all__ = ["in_words", "interval_words", "number"]

SENSITIVE = 0.05


def number(value: float, kind: str) -> str:
    """A value with the digits its parameter deserves."""
    if kind == "alpha":
        return f"{value:.1f}"
    if kind == "kappa":
        return f"{value:.3f}"
    if kind.startswith("mounting"):
        return f"{value:.4f}"
    return f"{value:.3g}"


def interval_words(scale: Scale, evidence: Evidence) -> str:
    """The 90 % interval with its unit."""
    unit = {"deg": " degrees", "kPa": " kPa"}.get(scale.unit, "")
    low, high = (number(v, scale.kind) for v in (evidence.low, evidence.high))
    return f"{low} to {high}{unit} (90 %)"


def in_words(
    scale: Scale,
    verdict: str,
    evidence: Evidence | None,
    thresholds: Thresholds,
    state: str,
    *,
    isotropy_open: bool = False,
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
    isotropy_open : bool
        Whether the data leave kappa = 1/3 possible.
    """
    name = scale.name
    if verdict == NO_VERDICT:
        return f"{name}: no verdict, the chains are not reliable ({state})"
    if verdict == FIXED or evidence is None:
        held = scale.prior
        if isinstance(held, Tie):
            return f"{name}: tied, {held.factor:g} times {held.other}"
        return f"{name}: fixed at {held:g}" if isinstance(held, float | int) else f"{name}: fixed"
    tell = {
        IDENTIFIED: _identified,
        ONE_SIDED: _one_sided,
        COMBINATION: _combination,
        PRIOR: _prior_dominated,
        NOT_IDENTIFIED: _not_identified,
    }[verdict]
    text = tell(scale, evidence, thresholds)
    if isotropy_open and scale.kind == "alpha":
        text += "; kappa = 1/3, where no angle means anything, is not excluded"
    if evidence.modes > 1:
        text += f"; {evidence.modes} separate peaks"
    if evidence.prior_sensitivity >= SENSITIVE and verdict != PRIOR:
        text += "; sensitive to the prior"
    return f"{name}: {text}"


def _identified(scale: Scale, e: Evidence, t: Thresholds) -> str:
    loose = "" if t.sharp(e.kind, e.low, e.high) else ", but loosely"
    return f"identified{loose}, {interval_words(scale, e)}"


def _one_sided(scale: Scale, e: Evidence, t: Thresholds) -> str:
    edge = e.open_edges(t)[0]
    unit = {"deg": " degrees", "kPa": " kPa"}.get(scale.unit, "")
    limit = (
        f"below {number(e.high, e.kind)}" if edge.side == 0 else f"above {number(e.low, e.kind)}"
    )
    return f"one-sided, {limit}{unit} (95 %); the data do not exclude {_end(scale, edge)}"


def _combination(scale: Scale, e: Evidence, t: Thresholds) -> str:
    share = 100.0 * e.partners.spread_given_partners
    text = (
        f"only in combination with {_listed(e.partners.names)}; alone {interval_words(scale, e)}, "
        f"with {'it' if len(e.partners.names) == 1 else 'them'} known {share:.0f} % of that spread"
    )
    ends = [_end(scale, edge) for edge in e.open_edges(t) if edge.kind == "physical"]
    return text + (f"; {' and '.join(ends)} not excluded" if ends else "")


def _prior_dominated(scale: Scale, e: Evidence, t: Thresholds) -> str:
    bounds = [edge for edge in e.open_edges(t) if edge.kind == "user"]
    if bounds:
        where = " and ".join(number(edge.value, e.kind) for edge in bounds)
        return (
            f"prior-dominated, {interval_words(scale, e)}; held by the bound {where} of its prior"
        )
    return (
        f"prior-dominated, {interval_words(scale, e)}; the data take "
        f"{100.0 * max(e.contraction, 0.0):.0f} % off the prior's variance"
    )


def _not_identified(scale: Scale, e: Evidence, t: Thresholds) -> str:
    assert e.refits is not None
    low, high = (number(v, e.kind) for v in e.refits)
    return (
        f"not identified, between {low} and {high} by fits to parts of the record; "
        f"{interval_words(scale, e)} rests on the model's toe, which these data contradict"
    )


def _end(scale: Scale, edge: Edge) -> str:
    value = "1/3" if scale.kind == "kappa" and edge.side == 1 else f"{edge.value:g}"
    meaning = edge.meaning(scale.kind)
    return f"{value} ({meaning})" if meaning else value


def _listed(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
