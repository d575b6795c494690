"""Whether intervals hold the truth as often as they say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

__all__ = ["LEVELS", "Coverage", "coverage"]

LEVELS = (0.50, 0.80, 0.90, 0.95)


@dataclass(frozen=True)
class Coverage:
    """Observed coverage of central intervals of one probability.

    Attributes
    ----------
    level : float
        Expected coverage.
    observed, low, high : float
        Share of replications, and its 95 % binomial (Clopper-Pearson) interval.
    """

    level: float
    observed: float
    low: float
    high: float


def coverage(below: np.ndarray, level: float) -> Coverage:
    """Coverage of the central interval.

    Parameters
    ----------
    below : ndarray, shape (replications,)
        Share of each posterior below the true value.
    level : float
        Probability of the interval.
    """
    n = below.size
    hits = int(np.count_nonzero(np.abs(below - 0.5) <= 0.5 * level))
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0
    return Coverage(level, hits / n, low, high)
