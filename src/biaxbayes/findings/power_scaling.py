"""Sensitivity of a posterior to its prior and to its likelihood, by power-scaling.

Kallioinen, Paananen, Buerkner and Vehtari, Statistics and Computing 34 (2024) 57: raise the
prior (or the likelihood) to a power near one by reweighting the draws, and measure how far a
marginal moves by the cumulative Jensen-Shannon distance (Nguyen and Vreeken, ECML 2015), per
doubling of the power. A flat prior has no power to scale: its sensitivity is zero even where it
decides everything, which is why this is evidence and not the verdict.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from biaxbayes.findings.sampling_scale import Scale
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior

__all__ = ["cumulative_distance", "log_likelihood", "log_prior", "sensitivity"]

POWERS = (0.99, 1.01)


def sensitivity(values: np.ndarray, log_component: np.ndarray) -> np.ndarray:
    """Sensitivity of each marginal to power-scaling one component of the posterior.

    Parameters
    ----------
    values : ndarray, shape (n, d)
        Draws on the sampling scales.
    log_component : ndarray, shape (n,)
        Log prior or log likelihood of each draw.

    Returns
    -------
    ndarray, shape (d,)
        Distance per doubling of the power; above 0.05 counts as sensitive.
    """
    centred = log_component - log_component.mean()
    # w proportional to component^(a - 1); within 1 % of one, so no smoothing is needed
    weights = [np.exp((power - 1.0) * centred) for power in POWERS]
    out = np.empty(values.shape[1])
    for j, column in enumerate(values.T):
        order = np.argsort(column)
        distances = [cumulative_distance(column[order], w[order]) for w in weights]
        out[j] = sum(distances) / (2.0 * np.log2(POWERS[1]))
    return out


def cumulative_distance(ordered: np.ndarray, weight: np.ndarray) -> float:
    """Cumulative Jensen-Shannon distance between a sample and its reweighting, 0 to 1.

    Parameters
    ----------
    ordered : ndarray, shape (n,)
        Ascending.
    weight : ndarray, shape (n,)
    """
    widths = np.diff(ordered)
    P = np.arange(1, ordered.size) / ordered.size
    Q = np.cumsum(weight)[:-1] / weight.sum()
    upper = _squared_distance(P, Q, widths)
    lower = _squared_distance(1.0 - P, np.clip(1.0 - Q, 0.0, 1.0), widths)
    return float(np.sqrt(max(upper, lower, 0.0)))


def _squared_distance(P: np.ndarray, Q: np.ndarray, widths: np.ndarray) -> float:
    """(CJS(P || Q) + CJS(Q || P)) over its upper bound, the integral of P + Q."""
    # CJS(P || Q) = int P log2(P / M) + (int Q - int P) / (2 ln 2),  M = (P + Q) / 2;
    # the second terms cancel in the sum
    M = 0.5 * (P + Q)
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(P > 0.0, P * np.log2(P / M), 0.0) + np.where(
            Q > 0.0, Q * np.log2(Q / M), 0.0
        )
    bound = float(((P + Q) * widths).sum())
    return float((terms * widths).sum()) / bound if bound > 0.0 else 0.0


def log_prior(scales: tuple[Scale, ...], draws: pd.DataFrame) -> np.ndarray:
    """Log prior density of the material and the mounting stretches, up to a constant."""
    total = np.zeros(len(draws))
    for scale in scales:
        prior = scale.prior
        if not isinstance(prior, Prior) or prior.family in ("uniform", "loguniform"):
            continue
        x = draws[scale.name].to_numpy(dtype=float)
        logs = prior.family == "lognormal"
        z = ((np.log(x) - np.log(prior.location)) if logs else x - prior.location) / prior.scale
        total -= 0.5 * z * z
    return total


def log_likelihood(posterior: Posterior, draws: pd.DataFrame) -> np.ndarray:
    """Log likelihood of the curves (tempered) and of the mounting readings, up to a constant."""
    total = draws["log_likelihood"].to_numpy(dtype=float).copy()
    if posterior.settings.mounting not in ("noisy", "free"):
        return total
    reading, sd = posterior.specimen.mounting_readings(
        shared=posterior.settings.mounting_stretch == "shared"
    )
    columns: Mapping[str, pd.Series] = {str(c): draws[c] for c in draws.columns}
    for m, label in enumerate(posterior.mounts):
        tail = f"[{label}]" if label else ""
        for k, axis in enumerate("xy"):
            force = columns[f"mounting_force_{axis}{tail}"].to_numpy(dtype=float)
            offset = columns.get(f"load_offset_{axis}")
            shift = 0.0 if offset is None else offset.to_numpy(dtype=float)
            total -= 0.5 * ((reading[m, k] - force - shift) / sd[m, k]) ** 2
    return total
