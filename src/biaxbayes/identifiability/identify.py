"""Verdicts on the parameters of a run, with their diagnostics.

The verdicts follow from the draws of a run, its priors and the fits of all laws to its record. What
they mean and every threshold are in ``docs/identifiability.md``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.fitting.law_fits import LawFits, better_law_message, fit_laws
from biaxbayes.identifiability import power_scaling
from biaxbayes.identifiability.determined import thin_draws
from biaxbayes.identifiability.marginals import (
    INTERVAL,
    LEVELS,
    ComparisonScale,
    count_modes,
    density,
    find_edges,
    parameter_scales,
)
from biaxbayes.identifiability.mounting_interval import (
    MEASURED_REASON,
    MountingInterval,
    interval_from_laws,
    widen_interval,
)
from biaxbayes.identifiability.mounting_refits import mounting_refits
from biaxbayes.identifiability.partners import find_partners
from biaxbayes.identifiability.reported import Reported, reported
from biaxbayes.identifiability.verdict import (
    NO_VERDICT,
    Diagnostics,
    ParameterVerdict,
    Thresholds,
    assess_parameters,
)
from biaxbayes.laws import LAWS
from biaxbayes.laws.law import Law
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.prior_checks import prior_conflicts
from biaxbayes.model.priors import DrawnPrior, Prior, Tie
from biaxbayes.parameters import STRETCH, mounting_names
from biaxbayes.prediction.draws import protocol_mounting

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
        Least-squares fits of all laws under the same mounting constraint, of converged draws.
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
            row |= {
                "partners": " ".join(e.partners.names),
                "spread_given_all": e.partners.spread_given_all,
                "spread_given_partners": e.partners.spread_given_partners,
                "modes": e.modes,
                "prior_sensitivity": e.prior_sensitivity,
                "likelihood_sensitivity": e.likelihood_sensitivity,
                "refit_low": e.refits[0] if e.refits else np.nan,
                "refit_high": e.refits[1] if e.refits else np.nan,
            }
        return pd.DataFrame(rows)

    def mounting_ranges(self) -> dict[str, tuple[float, float]]:
        """Ranges over which stresses of the tissue let a mounting stretch vary, by name.

        The range of the refits where they contradict the interval of the posterior.
        """
        return {
            p.name: e.refits
            for p in self.parameters
            if p.posterior_verdict != NO_VERDICT
            and (e := p.diagnostics) is not None
            and e.refits is not None
            and e.is_contradicted(self.thresholds)
        }

    def mounting_values(self) -> dict[str, tuple[float, float]]:
        """Both ends of the mounting stretches that all laws agree on, by name."""
        intervals = ((p.name, p.mounting) for p in self.parameters if p.mounting is not None)
        return {name: (m.low, m.high) for name, m in intervals if m.is_value}


def identify_run(posterior: Posterior, draws: pd.DataFrame, state: str) -> Identifiability:
    """Assess the parameters of a run by its draws, with the fits of all laws."""
    fits = run_law_fits(posterior) if state == "converged" else None
    result = identify_draws(posterior, draws, state, fits=fits)
    if state != "converged":
        return result
    conflicts = [name for name in prior_conflicts(posterior) if name in posterior.law.names]
    return replace(result, contradicted_priors=tuple(conflicts))


def run_law_fits(posterior: Posterior, laws: Sequence[str] = tuple(LAWS)) -> LawFits | None:
    """Least-squares fits of laws to the data of a posterior; its own law has the run's options."""
    settings = posterior.settings
    prior_sd = {}  # of the log, of the cos^2 of an angle, or untransformed
    for p in posterior.law.parameters:
        prior = posterior.priors[p.name]
        if isinstance(prior, Prior | DrawnPrior):
            values = prior.ppf(LEVELS)
            if p.logarithmic:
                values = np.log(values)
            elif p.mirror:
                values = np.cos(np.deg2rad(values)) ** 2
            prior_sd[p.name] = float(values.std())
    run = {
        "fixed": settings.fixed_material,
        "fibre_switch": settings.fibre_switch,
        "weighted": settings.noise == "effective",
        "prior_sd": prior_sd,
    }
    return fit_laws(
        posterior.specimen,
        laws,
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
        From :func:`run_law_fits`: without them mounting stretches have no interval to report.
    priors : mapping, optional
        In place of the posterior's own, for draws under other priors of the same likelihood.
    """
    chosen = thresholds or Thresholds()
    thinned = thin_draws(draws, MAX_DIAGNOSTIC_DRAWS)
    scales = parameter_scales(priors or posterior.priors, posterior.quantities, thinned)
    free = tuple(s for s in scales if isinstance(s.prior, Prior | DrawnPrior))
    diagnostics: dict[str, Diagnostics] = {}
    law, protocols = posterior.law, posterior.specimen.protocols
    if state != "unusable":
        log_prior = power_scaling.log_prior(free, thinned)
        logs = (log_prior, power_scaling.log_likelihood(posterior, thinned))
        largest = [p.stretch.max(axis=0) * protocol_mounting(thinned, p) for p in protocols]
        distances = law.bound_tolerances(law.material(thinned), largest)
        diagnostics = diagnostics_from_draws(free, thinned, draws, logs, distances, chosen)
        _add_mounting_diagnostics(diagnostics, posterior, draws, free, chosen)
    if state != "converged":
        fits = None
    mounting = {} if fits is None else mounting_intervals(posterior, fits, diagnostics)
    parameters = assess_parameters(
        scales, diagnostics, law, state, thresholds=chosen, mounting=mounting
    )
    return Identifiability(parameters, state, len(draws), chosen, law, fits)


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
    physical edge that count as near, by parameter.
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
        q05, q50, q95 = np.quantile(all_draws[scale.name], [INTERVAL[0], 0.5, INTERVAL[1]])
        out[scale.name] = Diagnostics(
            parameter=scale.parameter,
            median=float(q50),
            low=float(q05),
            high=float(q95),
            prior_sd=float(before.std()),
            posterior_sd=float(x.std()),
            prior_excluded=1.0 - min(likelihood.width_above(thresholds.edge_support), 1.0),
            edges=find_edges(scale, values, likelihood, distances.get(scale.parameter.name)),
            partners=partners[scale.name],
            modes=count_modes(x, limits, after),
            prior_sensitivity=float(by_prior[j]),
            likelihood_sensitivity=float(by_data[j]),
            prior_density=density(before, limits),
            posterior_density=after,
        )
    return out


def _add_mounting_diagnostics(
    diagnostics: dict[str, Diagnostics],
    posterior: Posterior,
    draws: pd.DataFrame,
    free: Sequence[ComparisonScale],
    thresholds: Thresholds,
) -> None:
    """Add to mounting stretches which ends the prior decides, and the range of the refits."""
    mounting = [s for s in free if s.parameter.kind == STRETCH]
    parts = mounting_refits(posterior) if mounting else None
    for scale in mounting:
        e = diagnostics[scale.name]
        if not posterior.specimen.metadata.get(scale.name):  # a prior that is no measurement
            values = draws[scale.name].to_numpy(dtype=float)
            log_prior = power_scaling.log_prior((scale,), draws)
            e = replace(e, by_prior=power_scaling.ends_by_prior(values, log_prior))
        if parts is not None:
            assert isinstance(scale.prior, Prior | DrawnPrior)
            span = parts.range(scale.name, (e.low, e.high), thresholds.refit_errors, scale.prior)
            e = replace(e, refits=span)
        diagnostics[scale.name] = e


def mounting_intervals(
    posterior: Posterior, fits: LawFits, diagnostics: Mapping[str, Diagnostics]
) -> dict[str, MountingInterval]:
    """Reported intervals of the mounting stretches by name, from `diagnostics` within the law."""
    law = posterior.law.name
    fit, out = fits[law], {}
    for i, state in enumerate(posterior.mounts):
        for axis, name in enumerate(mounting_names("stretch", state)):
            if name not in diagnostics:
                continue
            e = diagnostics[name]
            if posterior.specimen.metadata.get(name) is not None:
                out[name] = MountingInterval(e.low, e.high, MEASURED_REASON)
                continue
            factors = None if fit is None else fit.mounting_widening
            factor = 1.0 if factors is None else float(factors[i, axis])
            interval = widen_interval(e.low, e.median, e.high, factor)
            out[name] = interval_from_laws(fits, i, axis, law, interval, by_prior=e.by_prior)
    return out
