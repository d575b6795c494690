"""Predictive densities of several models pooled into one, by what they foretold.

Stacking (Yao, Vehtari, Simpson, Gelman, Bayesian Anal. 13 (2018) 917) chooses the mixture of
predictive densities that foretells left-out readings best. With p_ki the density that model k gives
to reading i, b_i what the reading is worth, and a Dirichlet prior (a, ..., a) towards equal
weights,

    maximise  sum_i b_i ln sum_k w_k p_ki + (a - 1) sum_k ln w_k     over the simplex of w.

Evidences are not used: those of likelihoods with different powers cannot be compared.

A mixture of models that are each right about their own error spreads wider than the readings do
(Gneiting and Ranjan, Electron. J. Stat. 7 (2013) 1747). Its bands are therefore read at levels that
hold of readings it has not seen: with F the distribution of the mixture, F(y_i) of left-out
readings is taken for Beta(c, c),

    maximise  sum_i b_i ln beta(F(y_i); c, c) - (ln c)^2 / (2 s^2)     over c,

and the level q of a band is the level B_c^-1(q) of the mixture. At c = 1 nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import betaincinv, betaln, ndtr

from biaxbayes.prediction.bands import evenly_chosen, mixture_percentiles

__all__ = [
    "PRIOR_READINGS",
    "calibrated_levels",
    "mixed_percentiles",
    "mixed_probabilities",
    "sharpness",
    "stacking_weights",
    "weighted_density",
]

PRIOR_READINGS = 1.0
"""Readings that the Dirichlet prior is worth in all, a = 1 + 1 / models: further models do not make
it stronger."""
_STEPS, _TOLERANCE = 20_000, 1e-10


def stacking_weights(log_density: np.ndarray, worth: np.ndarray) -> np.ndarray:
    """Weights of the mixture that foretells left-out readings best.

    Parameters
    ----------
    log_density : ndarray, shape (models, readings)
        Log predictive density of each left-out reading; -inf where a model excludes it.
    worth : ndarray, shape (readings,)
        Independent readings that each is worth.

    Returns
    -------
    ndarray, shape (models,)
        Positive, of sum one.
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
    """Log density of a mixture.

    Parameters
    ----------
    log_density : ndarray, shape (models, readings)
    weight : ndarray, shape (models,)

    Returns
    -------
    ndarray, shape (readings,)
    """
    with np.errstate(divide="ignore"):
        mixed: np.ndarray = np.logaddexp.reduce(log_density + np.log(weight)[:, None], axis=0)
    return mixed


def mixed_percentiles(
    model: Sequence[np.ndarray],
    sd: Sequence[np.ndarray],
    weight: np.ndarray,
    levels: tuple[float, ...],
) -> list[np.ndarray]:
    """Percentiles of a mixture: each law gives draws in proportion to its weight.

    Parameters
    ----------
    model, sd : sequence of ndarray, shape (draws, readings)
        Of each law: its curves, and the sds of readings about them.
    weight : ndarray, shape (laws,)
    levels : tuple of float
    """
    size = min(len(m) for m in model)
    counts = np.round(weight * size).astype(int)
    counts[np.argmax(weight)] += size - counts.sum()
    chosen = [evenly_chosen(len(m), max(int(n), 1)) for m, n in zip(model, counts, strict=True)]
    kept = [k for k, n in enumerate(counts) if n > 0]
    return mixture_percentiles(
        np.vstack([model[k][chosen[k]] for k in kept]),
        np.vstack([sd[k][chosen[k]] for k in kept]),
        levels,
    )


# --- bands that hold what they say ---------------------------------------------------------------

SHARPNESS_LOG_SD = 0.5
"""Of the prior of c about 1. On the aorta and the valve half and twice of it change the share of
left-out readings in the band by at most 0.05."""
_LEAST_PROBABILITY = 1e-9
_WIDEST = 3.0  # of ln c


def mixed_probabilities(
    measured: np.ndarray,
    model: Sequence[np.ndarray],
    sd: Sequence[np.ndarray],
    weight: np.ndarray,
) -> np.ndarray:
    """Probability of the mixture below each reading.

    Parameters
    ----------
    measured : ndarray, shape (readings,)
    model, sd : sequence of ndarray, shape (draws, readings)
        Of each law, as for :func:`mixed_percentiles`.
    weight : ndarray, shape (laws,)

    Returns
    -------
    ndarray, shape (readings,)
    """
    # F(y_i) = sum_k w_k mean_s Phi((y_i - m_ksi) / sd_ksi)
    each = [ndtr((measured - m) / s).mean(axis=0) for m, s in zip(model, sd, strict=True)]
    probability: np.ndarray = weight @ np.array(each)
    return probability


def sharpness(probability: np.ndarray, worth: np.ndarray) -> float:
    """The c of Beta(c, c) for the probabilities of left-out readings.

    Parameters
    ----------
    probability : ndarray, shape (readings,)
        Of :func:`mixed_probabilities`.
    worth : ndarray, shape (readings,)
        Independent readings that each is worth.

    Returns
    -------
    float
        Above 1 where readings lie nearer to the middle of the mixture than it says.
    """
    u = np.clip(probability, _LEAST_PROBABILITY, 1.0 - _LEAST_PROBABILITY)
    logs, total = float(worth @ (np.log(u) + np.log1p(-u))), float(worth.sum())

    def minus_log_density(log_c: float) -> float:
        c = np.exp(log_c)
        # sum b ln beta(u; c, c) = (c - 1) sum b ln(u (1 - u)) - ln B(c, c) sum b
        prior = 0.5 * (log_c / SHARPNESS_LOG_SD) ** 2
        return float(prior - (c - 1.0) * logs + total * betaln(c, c))

    found = minimize_scalar(minus_log_density, bounds=(-_WIDEST, _WIDEST), method="bounded")
    return float(np.exp(found.x))


def calibrated_levels(levels: tuple[float, ...], c: float) -> tuple[float, ...]:
    """Levels of the mixture at which bands of these levels are read.

    Parameters
    ----------
    levels : tuple of float
    c : float
        Of :func:`sharpness`.
    """
    return tuple(float(betaincinv(c, c, level)) for level in levels)
