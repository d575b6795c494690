"""Verdicts on the parameters of a run, with their evidence.

The verdicts follow from the draws of a run, its priors and the fits of all laws to its record. What
they mean and every threshold are in ``docs/identifiability.md``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.identifiability.determined import some_draws
from biaxbayes.identifiability.evidence import Refits, evidence_of_run
from biaxbayes.identifiability.marginals import LEVELS, parameter_scales
from biaxbayes.identifiability.mounting_stretch.interval import mounting_intervals
from biaxbayes.identifiability.mounting_stretch.law_fits import (
    LawFits,
    better_law_message,
    fit_laws,
)
from biaxbayes.identifiability.mounting_stretch.refits import mounting_refits
from biaxbayes.identifiability.reported import Reported, reported
from biaxbayes.identifiability.verdict import (
    NO_VERDICT,
    ParameterVerdict,
    Thresholds,
    assess_parameters,
)
from biaxbayes.laws import LAWS
from biaxbayes.laws.law import Law
from biaxbayes.model.conflicts import prior_conflicts
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import DrawnPrior, Prior, Tie
from biaxbayes.parameters import STRETCH

MOST_DRAWS = 20_000
"""Draws, evenly chosen, that the evidence is computed from; medians and intervals are those of
all draws, as in ``summary.csv``."""


@dataclass(frozen=True)
class Identifiability:
    """Verdicts on all parameters of a run.

    Attributes
    ----------
    state : str
        State of the run that the draws are from.
    fits : LawFits or None
        Least squares of all laws under the same mounting constraint, of converged draws.
    contradicted_priors : tuple of str
        Parameters of the law whose prior, set by the user, contradicts the data.
    """

    parameters: tuple[ParameterVerdict, ...]
    state: str
    draws: int
    thresholds: Thresholds
    law: Law
    fits: LawFits | None = None
    contradicted_priors: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> ParameterVerdict:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def reported(self) -> tuple[Reported, ...]:
        """Rows of the inferred parameters: one interval or bound, verdict and reason each."""
        return reported(
            self.parameters, self.fits, self.law, self.thresholds, self.contradicted_priors
        )

    @property
    def better_law(self) -> str:
        """Text on a law that fits the record distinctly better; empty if none does."""
        return "" if self.fits is None else better_law_message(self.fits, self.law.name)

    @property
    def all_thresholds(self) -> dict[str, float]:
        """Every threshold by name, with the widths of sharp intervals."""
        return dict(self.thresholds.items(p.scale.parameter for p in self.parameters))

    def to_frame(self) -> pd.DataFrame:
        """The evidence, one row per parameter: ``identifiability.csv``."""
        return pd.DataFrame([_evidence_row(p) for p in self.parameters])

    def mounting_ranges(self) -> dict[str, tuple[float, float]]:
        """Ranges over which stresses of the tissue let a mounting stretch vary, by name.

        The range of the refits where they contradict the interval of the posterior.
        """
        return {
            p.name: e.refits
            for p in self.parameters
            if p.posterior_verdict != NO_VERDICT
            and (e := p.evidence) is not None
            and e.refits is not None
            and e.is_contradicted(self.thresholds)
        }

    def mounting_values(self) -> dict[str, tuple[float, float]]:
        """Both ends of the mounting stretches that all laws agree on, by name."""
        intervals = ((p.name, p.mounting) for p in self.parameters if p.mounting is not None)
        return {name: (m.low, m.high) for name, m in intervals if m.is_value}


def _evidence_row(p: ParameterVerdict) -> dict[str, Any]:
    row: dict[str, Any] = {"parameter": p.name, "unit": p.scale.unit}
    e = p.evidence
    if e is None:
        return row
    row |= {
        "posterior_median": e.median,
        "posterior_q05": e.low,
        "posterior_q95": e.high,
        "scale": p.scale.label,
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


def identify_run(posterior: Posterior, draws: pd.DataFrame, state: str) -> Identifiability:
    """Assess the parameters of a run by its draws, with the fits of all laws."""
    fits = run_law_fits(posterior) if state == "converged" else None
    result = identify_draws(posterior, draws, state, fits=fits)
    if state != "converged":
        return result
    conflicts = [name for name in prior_conflicts(posterior) if name in posterior.law.names]
    return replace(result, contradicted_priors=tuple(conflicts))


def run_law_fits(posterior: Posterior, laws: Sequence[str] = tuple(LAWS)) -> LawFits | None:
    """Least squares of laws to the record of a posterior, its own with the options of the run."""
    settings = posterior.settings
    run = {
        "fixed": settings.fixed_material,
        "fibre_switch": settings.fibre_switch,
        "weighted": settings.noise == "effective",
        "prior_sd": _prior_sds(posterior),
    }
    return fit_laws(
        posterior.specimen,
        laws,
        mounting=settings.fit_mounting,
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
    fits: LawFits | None = None,
    refits: Refits = mounting_refits,
    priors: Mapping[str, Prior | DrawnPrior | Tie | float] | None = None,
) -> Identifiability:
    """Assess the parameters of a posterior by its draws.

    Parameters
    ----------
    posterior : Posterior
        For the priors and the mounting readings.
    draws : DataFrame
        Natural quantities by the names of ``summary.csv``, with ``log_likelihood``.
    state : {"converged", "tentative", "unusable"}
        Anything but ``converged`` gives no verdict; the evidence of tentative draws is there all
        the same, unusable ones give none.
    fits : LawFits, optional
        From :func:`run_law_fits`: without them mounting stretches have no interval to report.
    refits : callable
        Fits to parts of the record, of the posterior; for who made them beforehand.
    priors : mapping, optional
        In place of the posterior's own, for draws under other priors of the same likelihood.
    """
    chosen = thresholds or Thresholds()
    few = some_draws(draws, MOST_DRAWS)
    scales = parameter_scales(priors or posterior.priors, posterior.quantities, few)
    free = tuple(s for s in scales if isinstance(s.prior, Prior | DrawnPrior))
    evidence = {}
    if state != "unusable":
        evidence = evidence_of_run(posterior, few, draws, free, chosen, refits=refits)
    mounting = {}
    if state == "converged" and fits is not None:
        stretches = {n: e for n, e in evidence.items() if e.parameter.kind == STRETCH}
        mounting = mounting_intervals(posterior, fits, stretches)
    else:
        fits = None
    parameters = assess_parameters(
        scales, evidence, posterior.law, state, thresholds=chosen, mounting=mounting
    )
    return Identifiability(parameters, state, len(draws), chosen, posterior.law, fits)
