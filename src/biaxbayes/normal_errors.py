"""Normal errors in tables and bands, and the kernel of smooth ones.

The likelihoods that are sampled are in :mod:`biaxbayes.model.readings` and
:mod:`biaxbayes.model.misfit`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


def log_likelihood(mean: Any, sd: Any, measured: Any) -> Any:
    """Log likelihood of each reading, broadcast."""
    # ln N(y | m, sd) = -(1/2) (y - m)^2 / sd^2 - ln sd - ln sqrt(2 pi)
    return -0.5 * (measured - mean) ** 2 / sd**2 - np.log(sd) - HALF_LOG_2PI


def simulate(mean: Any, sd: Any, rng: np.random.Generator) -> Any:
    """New readings, of the shape of their mean."""
    return mean + sd * rng.standard_normal(np.shape(mean))


def squared_exponential(distance: np.ndarray) -> np.ndarray:
    """Correlation of a smooth error at two points, by their distance in correlation lengths."""
    return np.asarray(np.exp(-0.5 * distance**2))
