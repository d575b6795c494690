"""Verdicts on the parameters of a run, with their diagnostics.

The verdicts follow from the draws of a run and its priors; least-squares fits of other laws to its
record may take one away. What they mean and every threshold are in ``docs/identifiability.md``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import listed
from biaxbayes.fitting.law_fits import CANDIDATE_LAWS, LawFits, better_law_message, fit_laws
from biaxbayes.identifiability import power_scaling
from biaxbayes.identifiability.determined import thin_draws
from biaxbayes.identifiability.marginals import (
    LEVELS,
    ComparisonScale,
    count_modes,
    density,
    parameter_scales,
    range_ends,
)
from biaxbayes.identifiability.partners import find_partners
from biaxbayes.identifiability.reported import Reported, contradicted_stretches, reported
from biaxbayes.identifiability.verdict import (
    MEASURED,
    NOT_IDENTIFIED,
    Assessment,
    Diagnostics,
    ParameterVerdict,
    Thresholds,
    assess_parameters,
)
from biaxbayes.laws.law import Law
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.prior_checks import prior_conflicts
from biaxbayes.model.priors import DrawnPrior, Prior, Tie
from biaxbayes.parameters import STRETCH, mounting_names
from biaxbayes.prediction.draws import protocol_mounting, with_free_sides
from biaxbayes.prediction.percentiles import quantiles
from biaxbayes.prediction.predictive_checks import law_misses, predictive_checks

MAX_DIAGNOSTIC_DRAWS = 20_000
"""Draws, evenly chosen, that the diagnostics are computed from; medians and intervals are those of
all draws, as in ``summary.csv``."""


@dataclass(frozen=True)
class Identifiability:
    """Verdicts on all parameters of a run.

    Attributes
    ----------
    state : str
        State of the run that the draws are from.
    fits : LawFits or None
        Least-squares fits of other laws under the same mounting constraint, of converged draws.
    contradicted_priors : tuple of str
        Parameters of the law whose prior, set by the user, contradicts the data.
    places : mapping of str to (int, int)
        Index of the mounted state, and axis, of the mounting stretches.
    checks : DataFrame
        From :func:`.predictive_checks`, of all pieces of a run.
    """

    parameters: tuple[ParameterVerdict, ...]
    state: str
    draws: int
    thresholds: Thresholds
    law: Law
    fits: LawFits | None = None
    contradicted_priors: tuple[str, ...] = ()
    places: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    checks: pd.DataFrame = field(default_factory=pd.DataFrame, repr=False, compare=False)

    def __getitem__(self, name: str) -> ParameterVerdict:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @cached_property
    def reported(self) -> tuple[Reported, ...]:
        """Rows of the inferred parameters."""
        # "fung describes the record better"
        override = self.better_law.partition(" than ")[0] or self.law_misses
        if self.contradicted_priors:
            override = f"the prior of {listed(list(self.contradicted_priors))} contradicts the data"
        contradictions = {}
        if self.fits is not None:
            contradictions = contradicted_stretches(
                self.parameters, self.fits, self.law.name, self.places
            )
        if self.law_misses:
            contradictions |= {
                p.name: Assessment(NOT_IDENTIFIED, self.law_misses)
                for p in self.parameters
                if p.name in self.places and p.assessment.reason != MEASURED
            }
        return reported(self.parameters, override=override, contradictions=contradictions)

    @property
    def law_misses(self) -> str:
        """Phrase where the law with these parameters does not describe the record; else empty."""
        return law_misses(self.checks, self.law.key) if self.state == "converged" else ""

    @property
    def better_law(self) -> str:
        """Text on a law that fits the record distinctly better; empty if none does."""
        return "" if self.fits is None else better_law_message(self.fits, self.law.name)

    @property
    def all_thresholds(self) -> dict[str, float]:
        """Every threshold by name, with the widths of sharp intervals."""
        return dict(self.thresholds.items(p.scale.parameter for p in self.parameters))

    def to_frame(self) -> pd.DataFrame:
        """The diagnostics, one row per parameter: ``identifiability.csv``."""
        rows = []
        for p in self.parameters:
            row: dict[str, Any] = {"parameter": p.name, "unit": p.scale.unit}
            rows.append(row)
            e = p.diagnostics
            if e is None:
                continue
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
            for end in e.ends:
                stem = f"{('low', 'high')[end.side]}_edge"
                row |= {
                    stem: end.value,
                    f"{stem}_kind": end.kind,
                    f"{stem}_distance": end.distance,
                    f"{stem}_mass": end.mass,
                    f"{stem}_prior_mass": end.prior_mass,
                    f"{stem}_support": end.support,
                }
            row |= {
                "partners": " ".join(e.partners.names),
                "spread_given_all": e.partners.spread_given_all,
                "spread_given_partners": e.partners.spread_given_partners,
                "modes": e.modes,
                "prior_sensitivity": e.prior_sensitivity,
                "likelihood_sensitivity": e.likelihood_sensitivity,
            }
        return pd.DataFrame(rows)


def identify_run(posterior: Posterior, draws: pd.DataFrame, state: str) -> Identifiability:
    """Assess the parameters of a run by its draws, with the fits of other laws."""
    fits = run_law_fits(posterior) if state == "converged" else None
    result = identify_draws(posterior, draws, state, fits=fits)
    if state == "unusable":
        return result
    pieces = range(len(posterior.pieces))
    checks = [predictive_checks(posterior, draws, piece=i) for i in pieces]
    result = replace(result, checks=pd.concat(checks, ignore_index=True))
    if state != "converged":
        return result
    conflicts = [name for name in prior_conflicts(posterior) if name in posterior.law.names]
    return replace(result, contradicted_priors=tuple(conflicts))


def run_law_fits(posterior: Posterior, laws: Sequence[str] = CANDIDATE_LAWS) -> LawFits | None:
    """Least-squares fits of laws to the data of a posterior; its own law has the run's options."""
    settings = posterior.settings
    run = {"fixed": settings.fixed_material, "fibre_switch": settings.fibre_switch}
    return fit_laws(
        posterior.specimen,
        tuple(dict.fromkeys((settings.law, *laws))),
        mounting=settings.fit_mounting,
        mounting_stretch=settings.mounting_stretch,
        options_by_law={settings.law: run},
    )


def identify_draws(
    posterior: Posterior,
    draws: pd.DataFrame,
    state: str,
    *,
    thresholds: Thresholds | None = None,
    fits: LawFits | None = None,
    priors: Mapping[str, Prior | DrawnPrior | Tie | float] | None = None,
) -> Identifiability:
    """Assess the parameters of a posterior by its draws.

    Parameters
    ----------
    posterior : Posterior
        For the priors and the mounting readings.
    draws : DataFrame
        Natural values (kPa, degrees) by the names of ``summary.csv``, with ``log_likelihood``.
    state : {"converged", "tentative", "unusable"}
        Anything but ``converged`` gives no verdict; parameters of tentative draws have diagnostics
        all the same, those of unusable ones have none.
    fits : LawFits, optional
        From :func:`run_law_fits`, which may take verdicts away.
    priors : mapping, optional
        In place of the posterior's own, for draws under other priors of the same likelihood.
    """
    chosen = thresholds or Thresholds()
    thinned = thin_draws(draws, MAX_DIAGNOSTIC_DRAWS)
    scales = parameter_scales(priors or posterior.priors, posterior.quantities, thinned)
    free = tuple(s for s in scales if isinstance(s.prior, Prior | DrawnPrior))
    diagnostics: dict[str, Diagnostics] = {}
    law = posterior.law
    protocols = with_free_sides(thinned, posterior.specimen, law).protocols
    if state != "unusable":
        log_prior = power_scaling.log_prior(free, thinned)
        logs = (log_prior, thinned["log_likelihood"].to_numpy(dtype=float))
        largest = [p.stretch.max(axis=0) * protocol_mounting(thinned, p) for p in protocols]
        distances = law.bound_tolerances(law.material(thinned), largest)
        diagnostics = diagnostics_from_draws(free, thinned, draws, logs, distances, chosen)
        _add_deciding_priors(diagnostics, posterior, draws, free)
    measured = [s.name for s in free if posterior.specimen.metadata.get(s.name) is not None]
    parameters = assess_parameters(
        scales, diagnostics, law, state, thresholds=chosen, measured=measured
    )
    places = {
        name: (i, axis)
        for i, label in enumerate(posterior.mounts)
        for axis, name in enumerate(mounting_names("stretch", label))
    }
    known = fits if state == "converged" else None
    return Identifiability(parameters, state, len(draws), chosen, law, known, places=places)


def diagnostics_from_draws(
    free: Sequence[ComparisonScale],
    draws: pd.DataFrame,
    all_draws: pd.DataFrame,
    log_components: tuple[np.ndarray, np.ndarray | None],
    distances: Mapping[str, float],
    thresholds: Thresholds,
) -> dict[str, Diagnostics]:
    """Diagnostics by name from thinned draws; medians and intervals are of all draws.

    `log_components` are log prior and log likelihood of each draw, `distances` those from a
    physical end that count as near, by parameter.
    """
    scaled = np.column_stack([s.to_scale(draws[s.name].to_numpy(dtype=float)) for s in free])
    by_prior, by_data = (power_scaling.sensitivity(scaled, log) for log in log_components)
    partners = find_partners(scaled, tuple(s.name for s in free))
    out = {}
    for j, scale in enumerate(free):
        prior, values = scale.prior, draws[scale.name].to_numpy(dtype=float)
        assert isinstance(prior, Prior | DrawnPrior)
        x = scale.to_scale(values)
        low, high = (float(v) for v in scale.to_scale(np.maximum(scale.limits, 0.0)))
        limits = (low if scale.limits[0] > -np.inf else -np.inf, high)
        before, after = scale.to_scale(prior.ppf(LEVELS)), density(x, limits)
        # posterior over prior density: the density of the draws' cumulative prior probability
        likelihood = density(prior.cdf(values), (0.0, 1.0))
        q05, q50, q95 = quantiles(all_draws[scale.name])
        out[scale.name] = Diagnostics(
            parameter=scale.parameter,
            median=q50,
            low=q05,
            high=q95,
            prior_sd=float(before.std()),
            posterior_sd=float(x.std()),
            prior_excluded=1.0 - min(likelihood.width_above(thresholds.edge_support), 1.0),
            ends=range_ends(scale, values, likelihood, distances.get(scale.parameter.name)),
            partners=partners[scale.name],
            modes=count_modes(x, limits, after),
            prior_sensitivity=float(by_prior[j]),
            likelihood_sensitivity=float(by_data[j]),
            prior_density=density(before, limits),
            posterior_density=after,
        )
    return out


def _add_deciding_priors(
    diagnostics: dict[str, Diagnostics],
    posterior: Posterior,
    draws: pd.DataFrame,
    free: Sequence[ComparisonScale],
) -> None:
    """Add to mounting stretches which ends their prior decides."""
    for scale in free:
        if scale.parameter.kind != STRETCH or posterior.specimen.metadata.get(scale.name):
            continue  # of the material, or a measurement
        values = draws[scale.name].to_numpy(dtype=float)
        by_prior = power_scaling.ends_by_prior(values, power_scaling.log_prior((scale,), draws))
        diagnostics[scale.name] = replace(diagnostics[scale.name], by_prior=by_prior)
