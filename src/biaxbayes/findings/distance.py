"""How far two posteriors of one quantity lie apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Distance", "distance"]


@dataclass(frozen=True)
class Distance:
    """Difference of a quantity between two posteriors whose draws are independent.

    Attributes
    ----------
    low, median, high : float
        90 % interval and median of b - a.
    standardised : float
        (mean b - mean a) / sqrt(var a + var b).
    probability_greater : float
        Probability that b is larger than a.
    kolmogorov : float
        Largest difference of the two cumulative distributions: 0 where they are the same, 1
        where they do not overlap. It does not depend on the scale of the quantity.
    """

    low: float
    median: float
    high: float
    standardised: float
    probability_greater: float
    kolmogorov: float


def distance(a: np.ndarray, b: np.ndarray, *, seed: int = 0) -> Distance:
    """Compare draws of one quantity.

    Parameters
    ----------
    a, b : ndarray, shape (n,), (m,)
        Finite draws of two runs.
    seed : int
        For the random pairing behind the interval of the difference.

    Returns
    -------
    Distance
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    rng = np.random.default_rng(seed)
    n = max(a.size, b.size)
    difference = np.resize(rng.permutation(b), n) - np.resize(rng.permutation(a), n)
    low, median, high = np.quantile(difference, [0.05, 0.5, 0.95])
    spread = float(np.sqrt(a.var() + b.var()))
    apart = float(b.mean() - a.mean())
    if spread > 0.0:
        standardised = apart / spread
    else:
        standardised = float(np.copysign(np.inf, apart)) if apart else 0.0
    ordered_a, ordered_b = np.sort(a), np.sort(b)
    # P(b > a) + P(b = a) / 2 over all pairs
    below = np.searchsorted(ordered_a, b, "left") + np.searchsorted(ordered_a, b, "right")
    pooled = np.concatenate([ordered_a, ordered_b])
    cumulative = [np.searchsorted(s, pooled, "right") / s.size for s in (ordered_a, ordered_b)]
    return Distance(
        float(low),
        float(median),
        float(high),
        standardised,
        float(0.5 * below.mean() / a.size),
        float(np.abs(cumulative[0] - cumulative[1]).max()),
    )
