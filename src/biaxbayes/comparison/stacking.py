"""Weights of models by what they predict of records that were left out.

Stacking (Yao, Vehtari, Simpson, Gelman, Bayesian Anal. 13 (2018) 917) chooses the mixture of
predictive densities that foretells left-out readings best. With p_ki the density that model k gives
to reading i, b_i what the reading is worth, and a Dirichlet prior (a, ..., a) towards equal
weights,

    maximise  sum_i b_i ln sum_k w_k p_ki + (a - 1) sum_k ln w_k     over the simplex of w.

Evidences are not used: those of likelihoods with different powers cannot be compared.
"""

from __future__ import annotations

import numpy as np

__all__ = ["PRIOR_READINGS", "stacking_weights", "weighted_density"]

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
