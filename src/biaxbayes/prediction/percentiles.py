"""Percentiles over posterior draws, of the tissue and of a new measurement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from biaxbayes.errors import InputError

BANDS = ("median", "credible_low", "credible_high", "predictive_low", "predictive_high")
"""Endings of the columns of a predicted quantity."""

MIXTURE_DRAWS = 4000  # most components of a mixture whose percentiles are computed
MAX_ITERATIONS = 60


QUANTILES = {"q05": 0.05, "q50": 0.5, "q95": 0.95}
"""Quantiles of every table, by the endings of its columns: the median and the 90 % interval."""


def quantiles(values: Any) -> list[float]:
    """5, 50 and 95 % quantile of values."""
    return [float(v) for v in np.quantile(values, list(QUANTILES.values()))]


def quantile_columns(name: str, values: Any) -> dict[str, float]:
    """The same as columns of a table, ``name_q05`` and so on."""
    return {f"{name}_{q}": v for q, v in zip(QUANTILES, quantiles(values), strict=True)}


def tails(probability: float) -> tuple[float, float]:
    """Probabilities below the ends of a central band; InputError if not between 0 and 1."""
    if not 0.0 < probability < 1.0:
        raise InputError(f"a probability of {probability:g} is not between 0 and 1")
    return 0.5 * (1.0 - probability), 0.5 * (1.0 + probability)


def percentiles(mean: np.ndarray, sd: np.ndarray, levels: Sequence[float]) -> np.ndarray:
    """Percentiles (levels, m) over draws (draws, m), each normal with its own sd, or exact (0)."""
    if not np.any(sd):
        return np.quantile(mean, list(levels), axis=0)
    return np.array(mixture_percentiles(mean, sd, tuple(levels)))


def band_columns(
    name: str, mean: np.ndarray, sd: np.ndarray, reading_sd: np.ndarray, probability: float
) -> dict[str, np.ndarray]:
    """The five columns of a quantity (draws, m) of the tissue, and of a new measurement."""
    low, high = tails(probability)
    credible = percentiles(mean, sd, (0.5, low, high))
    predictive = percentiles(mean, reading_sd, (low, high))
    values = (*credible, *predictive)
    return {f"{name}_{band}": v for band, v in zip(BANDS, values, strict=True)}


def mixture_percentiles(
    model: np.ndarray, noise: np.ndarray, levels: tuple[float, ...]
) -> list[np.ndarray]:
    """Percentiles (m,) of the equal mixture of N(model, noise) over draws; no random numbers."""
    step = -(-len(model) // MIXTURE_DRAWS)
    mean = np.ascontiguousarray(model[::step].T)
    sd = np.maximum(np.broadcast_to(noise, model.shape)[::step].T, 1e-300)
    out = []
    for level in levels:
        ends = mean + ndtri(level) * sd  # of the single draws: the root lies between
        low, high = ends.min(axis=1), ends.max(axis=1)
        accuracy = 1e-9 * (high - low)
        # Start: the normal distribution of the same mean and variance.
        spread = np.sqrt(mean.var(axis=1) + (sd**2).mean(axis=1))
        q = np.clip(mean.mean(axis=1) + ndtri(level) * spread, low, high)
        for _ in range(MAX_ITERATIONS):
            # F(q) = mean over draws of Phi((q - m) / sd), by Newton's method within [low, high]
            z = (q[:, None] - mean) / sd
            excess = ndtr(z).mean(axis=1) - level
            low, high = np.where(excess < 0.0, q, low), np.where(excess < 0.0, high, q)
            before = q
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                density = (np.exp(-0.5 * z**2) / sd).mean(axis=1) / np.sqrt(2.0 * np.pi)
                q = q - excess / density
            q = np.where((q >= low) & (q <= high), q, 0.5 * (low + high))
            if (abs(q - before) <= accuracy).all():
                break
        out.append(q)
    return out


def known_percentiles(values: np.ndarray, levels: tuple[float, ...]) -> np.ndarray:
    """Percentiles over the draws that have a value, shape (levels, m); NaN where none has."""
    out = np.full((len(levels), values.shape[1]), np.nan)
    for j, column in enumerate(values.T):
        finite = column[np.isfinite(column)]
        if finite.size:
            out[:, j] = np.quantile(finite, levels)
    return out
