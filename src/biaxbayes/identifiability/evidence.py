"""Diagnostics of parameters, from draws and priors, that verdicts rest on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from biaxbayes.identifiability import power_scaling
from biaxbayes.identifiability.marginals import (
    INTERVAL,
    LEVELS,
    Scale,
    count_modes,
    density,
    edge_distances,
    find_edges,
)
from biaxbayes.identifiability.mounting_stretch.refits import MountingRefits, mounting_refits
from biaxbayes.identifiability.sloppiness import Partners, find_partners
from biaxbayes.identifiability.verdict import Evidence, Thresholds
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import DrawnPrior, Prior
from biaxbayes.parameters import STRETCH

Refits = Callable[[Posterior], MountingRefits | None]
"""Fits to parts of the record of a posterior."""


def evidence_of_run(
    posterior: Posterior,
    draws: pd.DataFrame,
    all_draws: pd.DataFrame,
    free: tuple[Scale, ...],
    thresholds: Thresholds,
    *,
    refits: Refits = mounting_refits,
) -> dict[str, Evidence]:
    """Evidence by name from some of the draws; medians and intervals are of all draws."""
    evidence = evidence_of_draws(
        free,
        draws,
        all_draws,
        (power_scaling.log_prior(free, draws), power_scaling.log_likelihood(posterior, draws)),
        edge_distances(draws, posterior.specimen, posterior.law),
        thresholds,
    )
    mounting = [s for s in free if s.parameter.kind == STRETCH]
    parts = refits(posterior) if mounting else None
    for scale in mounting:
        e = evidence[scale.name]
        if not posterior.specimen.metadata.get(scale.name):  # a prior that is no measurement
            values = all_draws[scale.name].to_numpy(dtype=float)
            log_prior = power_scaling.log_prior((scale,), all_draws)
            e = replace(e, by_prior=power_scaling.ends_by_prior(values, log_prior))
        if parts is not None:
            assert isinstance(scale.prior, Prior | DrawnPrior)
            span = parts.range(scale.name, (e.low, e.high), thresholds.refit_errors, scale.prior)
            e = replace(e, refits=span)
        evidence[scale.name] = e
    return evidence


def evidence_of_draws(
    free: Sequence[Scale],
    draws: pd.DataFrame,
    all_draws: pd.DataFrame,
    log_components: tuple[np.ndarray, np.ndarray | None],
    distances: Mapping[str, float],
    thresholds: Thresholds,
) -> dict[str, Evidence]:
    """Evidence by name; `log_components` are log prior and log likelihood of each draw."""
    values = np.column_stack([s.to_scale(draws[s.name].to_numpy(dtype=float)) for s in free])
    by_prior, by_data = (power_scaling.sensitivity(values, log) for log in log_components)
    partners = find_partners(values, tuple(s.name for s in free))
    return {
        scale.name: _evidence(
            scale,
            draws[scale.name].to_numpy(dtype=float),
            np.quantile(all_draws[scale.name], [INTERVAL[0], 0.5, INTERVAL[1]]),
            partners[scale.name],
            (float(by_prior[j]), float(by_data[j])),
            distances.get(scale.kind),
            thresholds,
        )
        for j, scale in enumerate(free)
    }


def _evidence(
    scale: Scale,
    natural: np.ndarray,
    quantiles: np.ndarray,
    partners: Partners,
    sensitivity: tuple[float, float],
    distance: float | None,
    thresholds: Thresholds,
) -> Evidence:
    prior = scale.prior
    assert isinstance(prior, Prior | DrawnPrior)
    x = scale.to_scale(natural)
    low, high = (float(v) for v in scale.to_scale(np.maximum(scale.limits, 0.0)))
    limits = (low if scale.limits[0] > -np.inf else -np.inf, high)
    before = scale.to_scale(prior.ppf(LEVELS))
    after = density(x, limits)
    # posterior over prior density: the density of the draws' cumulative prior probability
    likelihood = density(prior.cdf(natural), (0.0, 1.0))
    q05, q50, q95 = (float(q) for q in quantiles)
    return Evidence(
        parameter=scale.parameter,
        median=q50,
        low=q05,
        high=q95,
        prior_sd=float(before.std()),
        posterior_sd=float(x.std()),
        prior_excluded=1.0 - min(likelihood.width_above(thresholds.edge_support), 1.0),
        edges=find_edges(scale, natural, likelihood, distance),
        partners=partners,
        modes=count_modes(x, limits, after),
        prior_sensitivity=sensitivity[0],
        likelihood_sensitivity=sensitivity[1],
        prior_density=density(before, limits),
        posterior_density=after,
    )
