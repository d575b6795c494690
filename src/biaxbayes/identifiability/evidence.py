"""From draws and priors to the evidence that verdicts rest on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from biaxbayes.identifiability import power_scaling
from biaxbayes.identifiability.marginals import (
    INTERVAL,
    LEVELS,
    Density,
    Scale,
    count_modes,
    density,
    edge_distances,
    find_edges,
)
from biaxbayes.identifiability.mounting_stretch.toe import MountingRefits, mounting_refits
from biaxbayes.identifiability.sloppiness import Partners, find_partners
from biaxbayes.identifiability.verdict import Evidence, Thresholds
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import DrawnPrior, Prior
from biaxbayes.parameters import STRETCH

__all__ = ["Found", "Refits", "evidence_of_draws", "evidence_of_run"]

Found = tuple[Evidence, Density, Density]
"""Evidence on a parameter, with the densities of its prior and its posterior."""
Refits = Callable[[Posterior], MountingRefits | None]
"""Fits to parts of the record of a posterior."""


def evidence_of_run(
    posterior: Posterior,
    draws: pd.DataFrame,
    every: pd.DataFrame,
    free: tuple[Scale, ...],
    thresholds: Thresholds,
    *,
    refits: Refits = mounting_refits,
) -> dict[str, Found]:
    """What the draws of a posterior tell of its parameters, by name.

    Parameters
    ----------
    posterior : Posterior
        For the mounting readings, and for fits to parts of a record that the model misses.
    draws : DataFrame
        Natural quantities, with ``log_likelihood``.
    every : DataFrame
        All draws, where ``draws`` are some of them.
    free : tuple of Scale
        With a prior each.
    thresholds : Thresholds
    refits : callable
        Fits to parts of the record, of the posterior.
    """
    found = evidence_of_draws(
        free,
        draws,
        every,
        (power_scaling.log_prior(free, draws), power_scaling.log_likelihood(posterior, draws)),
        edge_distances(draws, posterior.specimen, posterior.law),
        thresholds,
    )
    mounting = [s for s in free if s.parameter.kind == STRETCH]
    found = _with_prior_ends(found, posterior, mounting, every)
    parts = refits(posterior) if mounting else None
    return found if parts is None else _with_refits(found, parts, mounting, thresholds)


def evidence_of_draws(
    free: Sequence[Scale],
    draws: pd.DataFrame,
    every: pd.DataFrame,
    log_components: tuple[np.ndarray, np.ndarray | None],
    distances: Mapping[str, float],
    thresholds: Thresholds,
) -> dict[str, Found]:
    """What draws and priors tell of parameters, by name.

    Parameters
    ----------
    free : sequence of Scale
        With a prior each.
    draws : DataFrame
        A column a parameter, natural values.
    every : DataFrame
        All draws, where ``draws`` are some of them: medians and intervals are theirs.
    log_components : (ndarray, ndarray or None)
        Log prior and log likelihood of each draw, for power-scaling; without the latter its
        sensitivity is not known.
    distances : mapping of str to float
        How near to a physical edge counts as near, by kind of parameter.
    thresholds : Thresholds
    """
    values = np.column_stack([s.of(draws[s.name].to_numpy(dtype=float)) for s in free])
    by_prior, by_data = (power_scaling.sensitivity(values, log) for log in log_components)
    partners = find_partners(values, tuple(s.name for s in free))
    return {
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


def _with_prior_ends(
    found: dict[str, Found], posterior: Posterior, mounting: Sequence[Scale], every: pd.DataFrame
) -> dict[str, Found]:
    """Ends of mounting stretches that their prior decides, where it is no measurement."""
    out = dict(found)
    for scale in mounting:
        if posterior.specimen.metadata.get(scale.name):
            continue
        e, before, after = found[scale.name]
        values = every[scale.name].to_numpy(dtype=float)
        by_prior = power_scaling.ends_by_prior(values, power_scaling.log_prior((scale,), every))
        out[scale.name] = (replace(e, by_prior=by_prior), before, after)
    return out


def _with_refits(
    found: dict[str, Found],
    refits: MountingRefits,
    mounting: Sequence[Scale],
    thresholds: Thresholds,
) -> dict[str, Found]:
    """Ranges of the mounting stretches in fits to parts of a record that the model misses."""
    out = dict(found)
    for scale in mounting:
        assert isinstance(scale.prior, Prior | DrawnPrior)
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
) -> Found:
    prior = scale.prior
    assert isinstance(prior, Prior | DrawnPrior)
    x = scale.of(natural)
    low_wall, high_wall = (float(v) for v in scale.of(np.maximum(scale.walls, 0.0)))
    walls = (low_wall if scale.walls[0] > -np.inf else -np.inf, high_wall)
    before = scale.of(prior.ppf(LEVELS))
    after = density(x, walls)
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
        modes=count_modes(x, walls, after),
        prior_sensitivity=sensitivity[0],
        likelihood_sensitivity=sensitivity[1],
    )
    return evidence, density(before, walls), after
