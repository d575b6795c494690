"""Predictive densities of several models pooled into one, by their left-out predictions.

Stacking (Yao, Vehtari, Simpson, Gelman, Bayesian Anal. 13 (2018) 917) chooses the mixture of
predictive densities that predicts left-out readings best. With p_ki the density that model k gives
to reading i, b_i its effective number of readings, and a Dirichlet prior (a, ..., a) towards equal
weights,

    maximise  sum_i b_i ln sum_k w_k p_ki + (a - 1) sum_k ln w_k     over the simplex of w.

Evidences are not used: those of likelihoods with different powers cannot be compared.

A mixture of models that are each right about their own error spreads wider than the readings do
(Gneiting and Ranjan, Electron. J. Stat. 7 (2013) 1747, who fit a beta distribution of two shapes
together with the weights). The levels of its bands are learned from left-out readings: with F the
distribution of the stacked mixture, F(y_i) is taken for Beta(c, c),

    maximise  sum_i b_i ln beta(F(y_i); c, c) - (ln c)^2 / (2 s^2)     over c,

and a band to the level q is read at the level B_c^-1(q) of the mixture. At c = 1 nothing changes. A
mixture that is biased stays so.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import betaincinv, betaln

from biaxbayes.error_model import standard_cdf
from biaxbayes.prediction.bands import evenly_chosen, mixture_percentiles

PRIOR_READINGS = 1.0
"""Readings in all that the Dirichlet prior is equivalent to, a = 1 + 1 / models."""
_STEPS, _TOLERANCE = 20_000, 1e-10


def stacking_weights(log_density: np.ndarray, worth: np.ndarray) -> np.ndarray:
    """Weights (models,) of the mixture that predicts left-out readings best.

    ``log_density`` (models, readings) is -inf where a model excludes a reading; ``worth``
    (readings,) are the independent readings that each counts for.
    """
    models = len(log_density)
    top = log_density.max(axis=0)
    known = np.isfinite(top)  # a reading that all models exclude says nothing of their weights
    density = np.exp(log_density[:, known] - top[known])
    worth = worth[known]
    weight = np.full(models, 1.0 / models)
    prior = PRIOR_READINGS / models  # a - 1
    total = worth.sum() + PRIOR_READINGS
    for _ in range(_STEPS):
        # expectation maximisation: the share of every reading that each model explains
        share = weight[:, None] * density
        mixture = share.sum(axis=0)
        explained = (share / mixture) @ worth + prior
        new = explained / total
        if np.abs(new - weight).max() < _TOLERANCE:
            return new
        weight = new
    return weight


def weighted_density(log_density: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Log density (readings,) of a mixture, from log densities (models, readings)."""
    with np.errstate(divide="ignore"):
        mixed: np.ndarray = np.logaddexp.reduce(log_density + np.log(weight)[:, None], axis=0)
    return mixed


def mixed_percentiles(
    model: Sequence[np.ndarray],
    sd: Sequence[np.ndarray],
    weight: np.ndarray,
    levels: tuple[float, ...],
) -> list[np.ndarray]:
    """Percentiles (readings,) of a mixture by level: laws give draws in proportion to their weight.

    ``model`` and ``sd`` of each law: curves and sds of readings about them, (draws, readings).
    """
    size = min(len(m) for m in model)
    counts = np.round(weight * size).astype(int)
    counts[np.argmax(weight)] += size - counts.sum()
    chosen = [evenly_chosen(len(m), max(int(n), 1)) for m, n in zip(model, counts, strict=True)]
    used = [k for k, n in enumerate(counts) if n > 0]
    return mixture_percentiles(
        np.vstack([model[k][chosen[k]] for k in used]),
        np.vstack([sd[k][chosen[k]] for k in used]),
        levels,
    )


# --- calibrated bands ----------------------------------------------------------------------------

SHARPNESS_LOG_SD = 0.25
"""Sd of the prior of ln c, set with the aorta and the valve of the documentation in sight: parts
are few, and their readings miss together. Half and twice of it change the share of left-out
readings in their bands by at most 0.08."""
LEAST_SHARPNESS, LARGEST_SHARPNESS = 0.3, 20.0
_LEAST_PROBABILITY = 1e-9


def mixed_probabilities(
    measured: np.ndarray, model: Sequence[np.ndarray], sd: Sequence[np.ndarray], weight: np.ndarray
) -> np.ndarray:
    """Probability (readings,) of the mixture below each reading; NaN where all draws overflow.

    Arguments as of :func:`mixed_percentiles`. A law all of whose draws overflow at a reading has
    no part in the mixture there.
    """
    # F(y_i) = sum_k w_k mean_s Phi((y_i - m_ksi) / sd_ksi)
    each, share = [], []
    with np.errstate(invalid="ignore", divide="ignore"):
        for m, s, w in zip(model, sd, weight, strict=True):
            below = standard_cdf((measured - m) / s)
            known = np.isfinite(below)
            each.append(np.where(known, below, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
            share.append(w * known.any(axis=0))
        probability: np.ndarray = np.sum(np.multiply(share, each), axis=0) / np.sum(share, axis=0)
    return probability


def sharpness(probability: np.ndarray, worth: np.ndarray) -> float:
    """The c of Beta(c, c) for the probabilities (readings,) of left-out readings; NaN is left out.

    Above 1 where readings lie nearer to the middle of the mixture than it predicts.
    """
    known = np.isfinite(probability)
    u, worth = probability[known], worth[known]
    u = np.clip(u, _LEAST_PROBABILITY, 1.0 - _LEAST_PROBABILITY)
    logs, total = float(worth @ (np.log(u) + np.log1p(-u))), float(worth.sum())

    def minus_log_density(log_c: float) -> float:
        c = np.exp(log_c)
        # sum b ln beta(u; c, c) = (c - 1) sum b ln(u (1 - u)) - ln B(c, c) sum b
        prior = 0.5 * (log_c / SHARPNESS_LOG_SD) ** 2
        return float(prior - (c - 1.0) * logs + total * betaln(c, c))

    bounds = (np.log(LEAST_SHARPNESS), np.log(LARGEST_SHARPNESS))
    optimum = minimize_scalar(minus_log_density, bounds=bounds, method="bounded")
    return float(np.exp(optimum.x))


def calibrated_levels(levels: tuple[float, ...], sharpness: float) -> tuple[float, ...]:
    """Levels of the mixture at which bands to these levels are read; sharpness 1 changes none."""
    return tuple(float(betaincinv(sharpness, sharpness, level)) for level in levels)
