"""Which parameters the data determine: a verdict on each, with its evidence.

The verdicts are judged on the draws of a run and its priors alone. What they mean and every
threshold are in ``docs/identifiability.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.identifiability import power_scaling
from biaxbayes.identifiability.held_edges import HeldEdge, held_edges
from biaxbayes.identifiability.marginals import (
    INTERVAL,
    LEVELS,
    Density,
    Edge,
    Scale,
    count_modes,
    density,
    edge_distances,
    find_edges,
    judged_scales,
)
from biaxbayes.identifiability.sloppiness import Partners, find_partners
from biaxbayes.identifiability.stated import (
    LawRange,
    Stated,
    distinctly_better,
    law_fits,
    stated_mounting,
)
from biaxbayes.identifiability.toe import mounting_refits
from biaxbayes.identifiability.verdict import (
    FIXED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    Evidence,
    Thresholds,
    decide,
    in_words,
)
from biaxbayes.laws.law import Law
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.parameters import MATERIAL, STRETCH

__all__ = [
    "Identifiability",
    "ParameterVerdict",
    "fits_of_laws",
    "identify",
    "identify_draws",
]

MOST_DRAWS = 20_000
"""Draws, evenly chosen, that the evidence is judged by; medians and intervals are those of all, the
numbers of ``summary.csv``."""


@dataclass(frozen=True)
class ParameterVerdict:
    """The verdict on one parameter.

    Attributes
    ----------
    scale : Scale
    verdict : str
        One of :data:`biaxbayes.identifiability.verdict.VERDICTS`.
    words : str
        The same as a sentence.
    evidence : Evidence or None
        None where the parameter was fixed or tied, or the draws are unusable.
    prior, posterior : Density or None
        On the sampling scale, for figures.
    stated : Stated or None
        Of a mounting stretch: what is stated of the tissue, whatever its law.
    """

    scale: Scale
    verdict: str
    words: str
    evidence: Evidence | None = None
    prior: Density | None = field(default=None, repr=False)
    posterior: Density | None = field(default=None, repr=False)
    stated: Stated | None = None

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.scale.name

    @property
    def partners(self) -> tuple[str, ...]:
        """Parameters that it trades with, whatever the verdict."""
        return self.evidence.partners.names if self.evidence else ()

    def record(self) -> dict[str, Any]:
        """One row of ``identifiability.csv``."""
        row: dict[str, Any] = {
            "parameter": self.name,
            "unit": self.scale.unit,
            "verdict": self.verdict,
            "in_words": self.words,
        }
        e = self.evidence
        if e is None:
            return row
        row |= {
            "median": e.median,
            "low_90": e.low,
            "high_90": e.high,
            "scale": self.scale.label,
            "prior_sd": e.prior_sd,
            "posterior_sd": e.posterior_sd,
            "contraction": e.contraction,
            "prior_excluded": e.prior_excluded,
        }
        for edge in e.edges:
            stem = f"{('low', 'high')[edge.side]}_edge"
            row |= {
                stem: edge.value,
                f"{stem}_kind": edge.kind,
                f"{stem}_distance": edge.distance,
                f"{stem}_mass": edge.mass,
                f"{stem}_prior_mass": edge.prior_mass,
                f"{stem}_support": edge.support,
            }
        return row | {
            "partners": " ".join(e.partners.names),
            "spread_given_all": e.partners.spread_given_all,
            "spread_given_partners": e.partners.spread_given_partners,
            "modes": e.modes,
            "prior_sensitivity": e.prior_sensitivity,
            "likelihood_sensitivity": e.likelihood_sensitivity,
            "refit_low": e.refits[0] if e.refits else np.nan,
            "refit_high": e.refits[1] if e.refits else np.nan,
            "stated_low": self.stated.low if self.stated else np.nan,
            "stated_high": self.stated.high if self.stated else np.nan,
            "stated_reason": self.stated.reason if self.stated else "",
        }


@dataclass(frozen=True)
class Identifiability:
    """Verdicts on all parameters of a run.

    Attributes
    ----------
    parameters : tuple of ParameterVerdict
    state : str
        State of the run that the draws are from.
    draws : int
    thresholds : Thresholds
    law : Law
    fits : LawRange or None
        Least squares of all laws under the same mounting constraint, of converged draws.
    held : tuple of HeldEdge
        The posterior with a parameter held at an end of its range that the data do not exclude.
    """

    parameters: tuple[ParameterVerdict, ...]
    state: str
    draws: int
    thresholds: Thresholds
    law: Law
    fits: LawRange | None = None
    held: tuple[HeldEdge, ...] = ()

    def __getitem__(self, name: str) -> ParameterVerdict:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    def to_frame(self) -> pd.DataFrame:
        """Verdicts and evidence, one row a parameter."""
        return pd.DataFrame([p.record() for p in self.parameters])

    @property
    def better_law(self) -> str:
        """Words on a law that describes the record distinctly better; empty where none does."""
        return "" if self.fits is None else distinctly_better(self.fits, self.law.name)

    def open_edges(self) -> dict[str, tuple[Edge, ...]]:
        """Physical ends that the data do not exclude, by the parameters of the law."""
        out = {}
        for p in self.parameters:
            if p.evidence is None or p.scale.parameter.kind != MATERIAL or p.verdict == NO_VERDICT:
                continue
            ends = p.evidence.open_edges(self.thresholds)
            out[p.name] = tuple(edge for edge in ends if edge.kind == "physical")
        return {name: ends for name, ends in out.items() if ends}

    def with_held(self, held: tuple[HeldEdge, ...]) -> Identifiability:
        """The same verdicts that also say what holds with a parameter at an end of its range."""

        def told(p: ParameterVerdict) -> ParameterVerdict:
            said = [h.in_words(p.name, p.scale.parameter) for h in held]
            return replace(p, words="; ".join([p.words, *(words for words in said if words)]))

        return replace(self, held=held, parameters=tuple(told(p) for p in self.parameters))

    def refits(self) -> dict[str, tuple[float, float]]:
        """Ranges of the mounting stretches that are not identified, by name."""
        lost = [p for p in self.parameters if p.verdict == NOT_IDENTIFIED]
        return {p.name: p.evidence.refits for p in lost if p.evidence and p.evidence.refits}

    def limits(self) -> list[tuple[str, float]]:
        """Every threshold by name, with the widths of sharp intervals."""
        return self.thresholds.items(p.scale.parameter for p in self.parameters)

    def in_words(self) -> list[str]:
        """One sentence a parameter."""
        return [p.words for p in self.parameters]

    def _repr_html_(self) -> str:
        """Verdicts in words with the interval, for notebooks."""
        kept = ["parameter", "unit", "verdict", "median", "low_90", "high_90", "contraction"]
        table = self.to_frame().reindex(columns=[*kept, "in_words"])
        return table.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="–")


def identify(run: Any, *, thresholds: Thresholds | None = None) -> Identifiability:
    """Judge the parameters of a run.

    Parameters
    ----------
    run : Run
        Or anything with ``posterior()``, ``draws`` and ``state``.
    thresholds : Thresholds, optional

    Returns
    -------
    Identifiability
    """
    posterior = run.posterior()
    fits = fits_of_laws(posterior) if run.state == "converged" else None
    found = identify_draws(posterior, run.draws, run.state, thresholds=thresholds, fits=fits)
    return found.with_held(held_edges(posterior, found.open_edges()))


def fits_of_laws(posterior: Posterior) -> LawRange | None:
    """Least squares of all laws to the record of a posterior.

    Parameters
    ----------
    posterior : Posterior
    """
    settings = posterior.settings
    return law_fits(
        posterior.specimen,
        reading="exact" if settings.infers_mounting else settings.mounting,
        mounting_stretch=settings.mounting_stretch,
    )


def identify_draws(
    posterior: Posterior,
    draws: pd.DataFrame,
    state: str,
    *,
    thresholds: Thresholds | None = None,
    fits: LawRange | None = None,
    stated: Mapping[str, Stated] | None = None,
) -> Identifiability:
    """Judge the parameters of a posterior by its draws.

    Parameters
    ----------
    posterior : Posterior
        For the priors and the mounting readings.
    draws : DataFrame
        Natural quantities by the names of ``summary.csv``, with ``log_likelihood``.
    state : {"converged", "tentative", "unusable"}
        Anything but ``converged`` gives no verdict; the evidence of tentative draws is there all
        the same, unusable ones give none.
    thresholds : Thresholds, optional
    fits : LawRange, optional
        From :func:`fits_of_laws`: without them, or without a verdict, nothing is stated of the
        tissue.
    stated : mapping of str to Stated, optional
        What is stated already of the mounting stretches of the tissue.
    """
    chosen = thresholds or Thresholds()
    every, draws = draws, draws.iloc[:: -(-len(draws) // MOST_DRAWS)]
    scales = judged_scales(posterior.priors, posterior.quantities, draws)
    free = tuple(s for s in scales if isinstance(s.prior, Prior))
    evidence = {} if state == "unusable" else _evidence(posterior, draws, every, free, chosen)
    fits = fits if state == "converged" else None
    if stated is None or state != "converged":
        stated = _stated(posterior, evidence, fits)
    nothing = _meaningless(posterior.law, {n: e for n, (e, _, _) in evidence.items()}, chosen)
    out = []
    for scale in scales:
        if scale.name not in evidence:
            verdict = NO_VERDICT if scale in free else FIXED
            words = in_words(scale, verdict, None, chosen, state)
            out.append(ParameterVerdict(scale, verdict, words))
            continue
        found, before, after = evidence[scale.name]
        of_tissue = stated.get(scale.name)
        if of_tissue is not None and of_tissue.is_value:
            # laws that describe the record agree: parts of it contradict nothing
            found = replace(found, refits=None)
        verdict = NO_VERDICT
        if state == "converged":
            verdict = decide(found, chosen, meaningless=scale.name in nothing)
        told = nothing.get(scale.name, "")
        words = in_words(scale, verdict, found, chosen, state, meaningless=told)
        if of_tissue is not None:
            words += f"; of the tissue {of_tissue.in_words(scale.parameter)} is stated"
            words += f": {of_tissue.reason}"
        out.append(ParameterVerdict(scale, verdict, words, found, before, after, of_tissue))
    return Identifiability(tuple(out), state, len(every), chosen, posterior.law, fits)


def _stated(
    posterior: Posterior,
    evidence: Mapping[str, tuple[Evidence, Density, Density]],
    fits: LawRange | None,
) -> dict[str, Stated]:
    """What is stated of the mounting stretches, by name."""
    intervals = {
        name: (e.low, e.high) for name, (e, _, _) in evidence.items() if e.parameter.kind == STRETCH
    }
    if fits is None or not intervals:
        return {}
    return stated_mounting(posterior, intervals, fits)


def _meaningless(law: Law, evidence: dict[str, Evidence], thresholds: Thresholds) -> dict[str, str]:
    """Parameters that may mean nothing, because an end of another one is open; words for it."""
    out = {}
    for name, causes in law.meaningless.items():
        found = [
            words
            for other, side, words in causes
            if other in evidence
            and any(
                edge.side == side and edge.kind == "physical"
                for edge in evidence[other].open_edges(thresholds)
            )
        ]
        if found:
            ends, verb = " and ".join(found), "are" if len(found) > 1 else "is"
            out[name] = f"{ends}, where no angle means anything, {verb} not excluded"
    return out


def _evidence(
    posterior: Posterior,
    draws: pd.DataFrame,
    every: pd.DataFrame,
    free: tuple[Scale, ...],
    thresholds: Thresholds,
) -> dict[str, tuple[Evidence, Density, Density]]:
    values = np.column_stack([s.of(draws[s.name].to_numpy(dtype=float)) for s in free])
    partners = find_partners(values, tuple(s.name for s in free))
    by_prior = power_scaling.sensitivity(values, power_scaling.log_prior(free, draws))
    by_data = power_scaling.sensitivity(values, power_scaling.log_likelihood(posterior, draws))
    distances = edge_distances(draws, posterior.specimen, posterior.law)
    found = {
        scale.name: _evidence_of(
            scale,
            draws[scale.name].to_numpy(dtype=float),
            np.quantile(every[scale.name], [INTERVAL[0], 0.5, INTERVAL[1]]),
            partners[scale.name],
            (float(by_prior[j]), float(by_data[j])),
            distances.get(scale.kind),
            thresholds,
        )
        for j, scale in enumerate(free)
    }
    return _with_refits(found, posterior, free, thresholds)


def _with_refits(
    found: dict[str, tuple[Evidence, Density, Density]],
    posterior: Posterior,
    free: tuple[Scale, ...],
    thresholds: Thresholds,
) -> dict[str, tuple[Evidence, Density, Density]]:
    """Ranges of the mounting stretches in fits to parts of a record that the model misses."""
    mounting = [s for s in free if s.parameter.kind == STRETCH]
    refits = mounting_refits(posterior) if mounting else None
    if refits is None:
        return found
    out = dict(found)
    for scale in mounting:
        assert isinstance(scale.prior, Prior)
        e, before, after = found[scale.name]
        span = refits.range(scale.name, (e.low, e.high), thresholds.refit_errors, scale.prior)
        out[scale.name] = (replace(e, refits=span), before, after)
    return out


def _evidence_of(
    scale: Scale,
    natural: np.ndarray,
    quantiles: np.ndarray,
    partners: Partners,
    sensitivity: tuple[float, float],
    distance: float | None,
    thresholds: Thresholds,
) -> tuple[Evidence, Density, Density]:
    prior = scale.prior
    assert isinstance(prior, Prior)
    x = scale.of(natural)
    low_wall, high_wall = (float(v) for v in scale.of(np.maximum(scale.walls, 0.0)))
    walls = (low_wall if scale.walls[0] > -np.inf else -np.inf, high_wall)
    before = scale.of(prior.ppf(LEVELS))
    likelihood = density(prior.cdf(natural), (0.0, 1.0))
    low, median, high = quantiles
    evidence = Evidence(
        parameter=scale.parameter,
        median=float(median),
        low=float(low),
        high=float(high),
        prior_sd=float(before.std()),
        posterior_sd=float(x.std()),
        prior_excluded=1.0 - min(likelihood.width_above(thresholds.edge_support), 1.0),
        edges=find_edges(scale, natural, likelihood, distance),
        partners=partners,
        modes=count_modes(x, walls),
        prior_sensitivity=sensitivity[0],
        likelihood_sensitivity=sensitivity[1],
    )
    return evidence, density(before, walls), density(x, walls)
