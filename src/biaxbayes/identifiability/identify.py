"""Which parameters the data determine: a verdict on each, with its evidence.

The verdicts are judged on the draws of a run and its priors alone. What they mean and every
threshold are in ``docs/identifiability.md``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.identifiability.evidence import Found, Refits, evidence_of_run
from biaxbayes.identifiability.held_edges import HeldEdge, held_edges
from biaxbayes.identifiability.marginals import (
    LEVELS,
    Density,
    Edge,
    Scale,
    judged_scales,
)
from biaxbayes.identifiability.mounting_stretch.law_range import (
    LawRange,
    distinctly_better,
    law_fits,
)
from biaxbayes.identifiability.mounting_stretch.stated import Stated, stated_mounting
from biaxbayes.identifiability.mounting_stretch.toe import mounting_refits
from biaxbayes.identifiability.reported import Reported, reported
from biaxbayes.identifiability.verdict import Evidence, Thresholds, contradicted, decide, in_words
from biaxbayes.identifiability.verdict_names import FIXED, NO_VERDICT
from biaxbayes.laws import LAWS
from biaxbayes.laws.law import Law
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import DrawnPrior, Prior, Tie
from biaxbayes.parameters import MATERIAL, STRETCH

__all__ = [
    "Identifiability",
    "ParameterVerdict",
    "fits_of_laws",
    "identify",
    "identify_draws",
    "judged",
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
    meaningless : str
        Where the data leave an end of another parameter possible at which this one means nothing:
        words that say so.
    """

    scale: Scale
    verdict: str
    words: str
    evidence: Evidence | None = None
    prior: Density | None = field(default=None, repr=False)
    posterior: Density | None = field(default=None, repr=False)
    stated: Stated | None = None
    meaningless: str = ""

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
        row: dict[str, Any] = {"parameter": self.name, "unit": self.scale.unit}
        e = self.evidence
        if e is None:
            return row
        row |= {
            "posterior_median": e.median,
            "posterior_q05": e.low,
            "posterior_q95": e.high,
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
    def verdicts(self) -> dict[str, str]:
        """Verdicts by parameter."""
        return {p.name: p.verdict for p in self.parameters}

    @property
    def reported(self) -> tuple[Reported, ...]:
        """What to report of every inferred parameter: one interval or bound, verdict and reason."""
        return reported(self.parameters, self.fits, self.law, self.state, self.thresholds)

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

    def refits(self) -> dict[str, tuple[float, float]]:
        """Ranges of the mounting stretches whose intervals refits contradict, by name."""
        found = ((p.name, p.evidence) for p in self.parameters if p.verdict != NO_VERDICT)
        return {
            name: e.refits
            for name, e in found
            if e is not None and e.refits and contradicted(e, self.thresholds)
        }

    def values(self) -> dict[str, tuple[float, float]]:
        """Both ends of the mounting stretches that are stated of the tissue as values, by name."""
        stated = [(p.name, p.stated) for p in self.parameters if p.stated is not None]
        return {name: (s.low, s.high) for name, s in stated if s.is_value}

    def limits(self) -> list[tuple[str, float]]:
        """Every threshold by name, with the widths of sharp intervals."""
        return self.thresholds.items(p.scale.parameter for p in self.parameters)


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
    return replace(found, held=held_edges(posterior, found.open_edges()))


def fits_of_laws(posterior: Posterior, laws: Sequence[str] = tuple(LAWS)) -> LawRange | None:
    """Least squares of laws to the record of a posterior, its own with the options of the run.

    Parameters
    ----------
    posterior : Posterior
    laws : sequence of str
    """
    settings = posterior.settings
    run = {
        "fixed": {k: v for k, v in settings.fixed.items() if k in posterior.law.names},
        "fibre_switch": settings.fibre_switch,
        "weighted": settings.noise == "effective",
        "prior_sd": _prior_sds(posterior),
    }
    return law_fits(
        posterior.specimen,
        laws,
        mounting="noisy" if settings.mounting == "free" else settings.mounting,
        mounting_stretch=settings.mounting_stretch,
        own={settings.law: run},
    )


def _prior_sds(posterior: Posterior) -> dict[str, float]:
    """Prior sd of the material parameters: of the log, or the cos^2 of an angle, or as it is."""
    out = {}
    for p in posterior.law.parameters:
        prior = posterior.priors[p.name]
        if not isinstance(prior, Prior | DrawnPrior):
            continue
        values = prior.ppf(LEVELS)
        if p.logarithmic:
            values = np.log(values)
        elif p.mirror:
            values = np.cos(np.deg2rad(values)) ** 2
        out[p.name] = float(values.std())
    return out


def identify_draws(
    posterior: Posterior,
    draws: pd.DataFrame,
    state: str,
    *,
    thresholds: Thresholds | None = None,
    fits: LawRange | None = None,
    refits: Refits = mounting_refits,
    stated: Mapping[str, Stated] | None = None,
    priors: Mapping[str, Prior | DrawnPrior | Tie | float] | None = None,
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
    refits : callable
        Fits to parts of the record, of the posterior; for who made them beforehand.
    stated : mapping of str to Stated, optional
        What is stated already of the mounting stretches of the tissue.
    priors : mapping, optional
        In place of the posterior's own, for draws under other priors of the same likelihood.
    """
    chosen = thresholds or Thresholds()
    every, draws = draws, draws.iloc[:: -(-len(draws) // MOST_DRAWS)]
    scales = judged_scales(priors or posterior.priors, posterior.quantities, draws)
    free = tuple(s for s in scales if isinstance(s.prior, Prior | DrawnPrior))
    evidence = (
        {}
        if state == "unusable"
        else evidence_of_run(posterior, draws, every, free, chosen, refits=refits)
    )
    fits = fits if state == "converged" else None
    if stated is None or state != "converged":
        stated = _stated(posterior, evidence, fits)
    out = judged(scales, evidence, posterior.law, state, thresholds=chosen, stated=stated)
    return Identifiability(out, state, len(every), chosen, posterior.law, fits)


def judged(
    scales: Sequence[Scale],
    evidence: Mapping[str, Found],
    law: Law,
    state: str,
    *,
    thresholds: Thresholds,
    stated: Mapping[str, Stated] | None = None,
) -> tuple[ParameterVerdict, ...]:
    """Verdicts on parameters from the evidence: one rule, wherever the draws are from.

    Parameters
    ----------
    scales : sequence of Scale
        What is judged.
    evidence : mapping of str to (Evidence, Density, Density)
        By name, as of
        :func:`~biaxbayes.identifiability.evidence.evidence_of_draws`; none of what was fixed,
        and none of unusable draws.
    law : Law
        For ends of its parameters at which another one means nothing.
    state : {"converged", "tentative", "unusable"}
    thresholds : Thresholds
    stated : mapping of str to Stated, optional
        What is stated of the mounting stretches of the tissue.
    """
    nothing = _meaningless(law, {n: e for n, (e, _, _) in evidence.items()}, thresholds)
    out = []
    for scale in scales:
        if scale.name not in evidence:
            free = isinstance(scale.prior, Prior | DrawnPrior)
            verdict = NO_VERDICT if free else FIXED
            words = in_words(scale, verdict, None, thresholds, state)
            out.append(ParameterVerdict(scale, verdict, words))
            continue
        found, before, after = evidence[scale.name]
        of_tissue = (stated or {}).get(scale.name)
        if of_tissue is not None and of_tissue.is_value:
            # laws that describe the record agree: parts of it contradict nothing
            found = replace(found, refits=None)
        verdict = NO_VERDICT
        if state == "converged":
            verdict = decide(found, thresholds, meaningless=scale.name in nothing)
        told = nothing.get(scale.name, "")
        words = in_words(scale, verdict, found, thresholds, state, meaningless=told)
        if of_tissue is not None:
            words += f"; of the tissue {of_tissue.in_words(scale.parameter)} is stated"
            words += f": {of_tissue.reason}"
        out.append(ParameterVerdict(scale, verdict, words, found, before, after, of_tissue, told))
    return tuple(out)


def _stated(
    posterior: Posterior,
    evidence: Mapping[str, Found],
    fits: LawRange | None,
) -> dict[str, Stated]:
    """What is stated of the mounting stretches, by name."""
    of_stretches = {n: e for n, (e, _, _) in evidence.items() if e.parameter.kind == STRETCH}
    if fits is None or not of_stretches:
        return {}
    return stated_mounting(
        posterior,
        {name: (e.low, e.median, e.high) for name, e in of_stretches.items()},
        fits,
        {name: e.by_prior for name, e in of_stretches.items()},
    )


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
