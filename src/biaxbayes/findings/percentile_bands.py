"""Percentile bands over posterior draws: of the model, and of a new measurement."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from biaxbayes.errors import InputError

__all__ = ["BANDS", "band_columns", "credible_columns", "known_percentiles", "mixture_percentiles"]

BANDS = ("median", "credible_low", "credible_high", "predictive_low", "predictive_high")
"""Endings of the columns of a predicted quantity."""

MIXTURE_DRAWS = 4000  # draws that carry a predictive percentile
MIXTURE_STEPS = 45


def tails(probability: float) -> tuple[float, float]:
    """Lower and upper percentile of a central band.

    Raises
    ------
    InputError
        If the probability is not between 0 and 1.
    """
    if not 0.0 < probability < 1.0:
        raise InputError(f"a probability of {probability:g} is not between 0 and 1")
    return 0.5 * (1.0 - probability), 0.5 * (1.0 + probability)


def credible_columns(name: str, model: np.ndarray, probability: float) -> dict[str, np.ndarray]:
    """Median and credible band of a quantity of shape (draws, m), as named columns."""
    values = np.quantile(model, [0.5, *tails(probability)], axis=0)
    return {f"{name}_{band}": v for band, v in zip(BANDS[:3], values, strict=True)}


def band_columns(
    name: str, model: np.ndarray, noise: np.ndarray, probability: float
) -> dict[str, np.ndarray]:
    """The five columns of a quantity.

    Parameters
    ----------
    name : str
        Stem of the columns, with the unit.
    model : ndarray, shape (draws, m)
    noise : ndarray, shape (draws, m) or (draws, 1)
        Standard deviation of a new measurement about the model.
    probability : float
        Content of each band.
    """
    predictive = mixture_percentiles(model, noise, tails(probability))
    return credible_columns(name, model, probability) | {
        f"{name}_{band}": v for band, v in zip(BANDS[3:], predictive, strict=True)
    }


def mixture_percentiles(
    model: np.ndarray, noise: np.ndarray, levels: tuple[float, ...]
) -> list[np.ndarray]:
    """Percentiles of the equal mixture of N(model, noise) over the draws, by bisection.

    No random numbers are drawn, so the band has no Monte Carlo error of its own.

    Parameters
    ----------
    model, noise
        As in :func:`band_columns`.
    levels : tuple of float

    Returns
    -------
    list of ndarray, shape (m,)
    """
    step = -(-len(model) // MIXTURE_DRAWS)
    mean = model[::step]
    sd = np.maximum(np.broadcast_to(noise, model.shape)[::step], 1e-300)
    out = []
    for level in levels:
        low, high = (mean - 9.0 * sd).min(axis=0), (mean + 9.0 * sd).max(axis=0)
        for _ in range(MIXTURE_STEPS):
            middle = 0.5 * (low + high)
            # F(q) = mean over draws of Phi((q - m) / sd)
            below = ndtr((middle - mean) / sd).mean(axis=0) < level
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        out.append(0.5 * (low + high))
    return out


def known_percentiles(values: np.ndarray, levels: tuple[float, ...]) -> np.ndarray:
    """Percentiles over the draws that have a value, shape (levels, m); NaN where none has."""
    out = np.full((len(levels), values.shape[1]), np.nan)
    for j, column in enumerate(values.T):
        known = column[np.isfinite(column)]
        if known.size:
            out[:, j] = np.quantile(known, levels)
    return out
