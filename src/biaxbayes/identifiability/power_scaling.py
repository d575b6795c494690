"""Sensitivity of a posterior to its prior and to its likelihood, by power-scaling.

Kallioinen, Paananen, Buerkner and Vehtari, Statistics and Computing 34 (2024) 57. A flat prior has
no power to scale: its sensitivity is zero even where it decides everything, which is why this is a
diagnostic and not the verdict.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.special import rel_entr

from biaxbayes.identifiability.marginals import INTERVAL, LEVELS, ComparisonScale, density
from biaxbayes.model.priors import DrawnPrior, Prior

POWERS = (0.99, 1.01)
END_POWERS = (0.8, 1.25)
DECIDING_SHIFT = 0.25
"""A prior decides an end that moves by this fraction of its distance from the median for a prior of
twice the sd. Alone a normal prior moves it by 0.7 of that, with as much from the data by 0.35."""


def sensitivity(values: np.ndarray, log_component: np.ndarray | None) -> np.ndarray:
    """Distance (d,) that the marginals of draws (n, d) move per doubling of a component's power.

    The draws are reweighted by prior or likelihood to a power near one. Above 0.05 counts as
    sensitive; NaN where the component is not known.
    """
    if log_component is None:
        return np.full(values.shape[1], np.nan)
    out = np.zeros(values.shape[1])
    if not np.ptp(log_component) > 0.0:
        return out
    centred = log_component - log_component.mean()
    for j, column in enumerate(values.T):
        if np.ptp(column) > 0.0:
            order = np.argsort(column)
            x, log_w = column[order], centred[order]
            # w proportional to component^(a - 1); within 1 % of one, so no smoothing is needed
            moved = [_distance(x, np.exp((power - 1.0) * log_w)) for power in POWERS]
            out[j] = np.mean(np.array(moved) / np.abs(np.log2(POWERS)))
    return out


def _distance(x: np.ndarray, weights: np.ndarray) -> float:
    """Cumulative Jensen-Shannon distance of sorted draws to the same weighted: of x or of -x.

    Nguyen and Vreeken, ECML 2015.
    """
    p = np.arange(1, len(x)) / len(x)
    q = np.cumsum(weights)[:-1] / weights.sum()
    width = np.diff(x)
    return max(_divergence(p, q, width), _divergence(1.0 - p, 1.0 - q, width), 0.0) ** 0.5


def _divergence(p: np.ndarray, q: np.ndarray, width: np.ndarray) -> float:
    """Integral of P log2(P / M) + Q log2(Q / M), M = (P + Q) / 2, over its bound, that of P + Q."""
    middle = 0.5 * (p + q)
    bits = (rel_entr(p, middle) + rel_entr(q, middle)) / np.log(2.0)
    return float(width @ bits) / float(width @ (p + q))


def ends_by_prior(values: np.ndarray, log_prior: np.ndarray) -> tuple[bool, bool]:
    """Whether the prior, given by its log at each draw, decides the (low, high) end."""
    order = np.argsort(values, kind="stable")
    values, centred = values[order], (log_prior - log_prior.mean())[order]
    ends = []
    for power in END_POWERS:
        weights = np.exp((power - 1.0) * centred)
        at = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
        ends.append(np.interp(INTERVAL, at, values))
    low, high = ends
    # the prior to the power a has the sd over sqrt(a): twice the sd is a quarter
    moved = np.abs((high - low) / np.log(END_POWERS[1] / END_POWERS[0]) * np.log(0.25))
    distance = np.abs(np.quantile(values, INTERVAL) - np.median(values))
    decided = (moved > 0.0) & (moved >= DECIDING_SHIFT * distance)
    return bool(decided[0]), bool(decided[1])


def log_prior(scales: tuple[ComparisonScale, ...], draws: pd.DataFrame) -> np.ndarray:
    """Log prior density of the material and the mounting stretches, up to a constant."""
    total = np.zeros(len(draws))
    for scale in scales:
        prior, values = scale.prior, draws[scale.name].to_numpy(dtype=float)
        if isinstance(prior, DrawnPrior):
            marginal = density(scale.to_scale(prior.ppf(LEVELS)))
            at = np.interp(scale.to_scale(values), marginal.x, marginal.height)
            total += np.log(np.maximum(at, 1e-12 * marginal.peak))
        elif isinstance(prior, Prior):
            total += prior.log_density(values)
    return total
