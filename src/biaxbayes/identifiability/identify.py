"""Verdicts on the parameters of a run and their diagnostics (``docs/identifiability.md``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.derived.determined import thin_draws
from biaxbayes.fitting.law_fits import CANDIDATE_LAWS, LawFits, better_law, fit_laws
from biaxbayes.identifiability import power_scaling
from biaxbayes.identifiability.marginals import (
    LEVELS,
    ComparisonScale,
    count_modes,
    density,
    parameter_scales,
    range_ends,
)
from biaxbayes.identifiability.partners import find_partners
from biaxbayes.identifiability.reported import Reported, reported
from biaxbayes.identifiability.verdict import (
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
from biaxbayes.prediction.predictive_checks import predictive_checks

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
        Least-squares fits of other laws under the same mounting constraint, of converged draws:
        information, on which no verdict depends.
    better_law : str
        Text on a law that describes and predicts the record distinctly better, or empty.
    contradicted_priors : tuple of str
        Parameters of the law whose prior, set by the user, contradicts the data.
    checks : DataFrame
        From :func:`.predictive_checks`, of all pieces of a run.
    """

    parameters: tuple[ParameterVerdict, ...]
    state: str
    draws: int
    thresholds: Thresholds
    law: Law
    fits: LawFits | None = None
    better_law: str = ""
    contradicted_priors: tuple[str, ...] = ()
    checks: pd.DataFrame = field(default_factory=pd.DataFrame, repr=False, compare=False)

    def __getitem__(self, name: str) -> ParameterVerdict:
        return {p.name: p for p in self.parameters}[name]

    @cached_property
    def reported(self) -> tuple[Reported, ...]:
        """Rows of the inferred parameters."""
        return reported(self.parameters, contradicted_priors=self.contradicted_priors)

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
                row[stem] = end.value
                for what in ("kind", "distance", "mass", "prior_mass", "support"):
                    row[f"{stem}_{what}"] = getattr(end, what)
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
    result = identify_draws(posterior, draws, state)
    if state == "unusable":
        return result
    pieces = range(len(posterior.pieces))
    checks = [predictive_checks(posterior, draws, piece=i) for i in pieces]
    result = replace(result, checks=pd.concat(checks, ignore_index=True))
    if state != "converged":
        return result
    settings = posterior.settings
    own = {"fixed": settings.fixed_material, "fibre_switch": settings.fibre_switch}
    how: dict[str, Any] = {
        "mounting": settings.fit_mounting,
        "mounting_stretch": settings.mounting_stretch,
        "options_by_law": {settings.law: own},
    }
    laws = tuple(dict.fromkeys((settings.law, *CANDIDATE_LAWS)))
    # the fit of several pieces is that of all, with one material
    known = {} if posterior.specimen.further else {settings.law: posterior.fit}
    fits = fit_laws(posterior.specimen, laws, **how, known=known)
    better = better_law(posterior.specimen, fits, posterior.law.name, **how) if fits else ""
    conflicts = [name for name in prior_conflicts(posterior) if name in posterior.law.names]
    return replace(result, fits=fits, better_law=better, contradicted_priors=tuple(conflicts))


def identify_draws(
    posterior: Posterior,
    draws: pd.DataFrame,
    state: str,
    *,
    thresholds: Thresholds | None = None,
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
    measured = {}  # mean and sd of the mounting stretches that the headers of all pieces give
    for piece in posterior.pieces:
        for label in piece.labels.states:
            pairs = piece.specimen.measured_mounting.T
            for name, (mean, sd) in zip(mounting_names("stretch", label), pairs, strict=True):
                if np.isfinite(mean):
                    measured[name] = (float(mean), float(sd))
    for scale in free if diagnostics else ():
        if scale.parameter.kind != STRETCH or scale.name in measured:
            continue  # of the material, or a measurement
        values, log_prior = draws[scale.name], power_scaling.log_prior((scale,), draws)
        by_prior = power_scaling.ends_by_prior(values.to_numpy(dtype=float), log_prior)
        diagnostics[scale.name] = replace(diagnostics[scale.name], by_prior=by_prior)
    parameters = assess_parameters(
        scales,
        diagnostics,
        law,
        state,
        thresholds=chosen,
        measured=measured,
        given=[name for name in posterior.settings.priors if name in law.names],
    )
    return Identifiability(parameters, state, len(draws), chosen, law)


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
            posterior_sd=float(np.quantile(x, LEVELS).std()),
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
