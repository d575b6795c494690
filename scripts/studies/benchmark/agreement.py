"""Whether several samplers tell the same posterior.

Differences are judged as probabilities: the share of our draws below another sampler's quantile
of level p should be p, within the Monte Carlo error of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.sampling.convergence import effective_sample_size
from studies.benchmark.outcome import LEVELS, Outcome, weighted_quantiles


@dataclass(frozen=True)
class Agreement:
    """Quantiles of all parameters against those of another sampler."""

    largest: float  # difference in standard errors of both
    where: str  # its parameter and level
    rms: float  # over parameters and levels; about one where the errors are honest
    count: int


def agreement(ours: Outcome, other: Outcome) -> Agreement:
    """Compare quantiles of 5, 50 and 95 %."""
    found = []
    weight = other.draws.get("weight")
    for name, mine in ours.draws.items():
        theirs = other.draws[name]
        if weight is None:
            quantiles = np.quantile(theirs, LEVELS)
        else:
            quantiles = weighted_quantiles(theirs, weight)
        for level, quantile in zip(LEVELS, quantiles, strict=True):
            below = (mine <= quantile).astype(float)
            variance = level * (1.0 - level)
            error = variance / max(effective_sample_size(below), 1.0)
            if weight is None:
                count = effective_sample_size((theirs <= quantile).astype(float))
            else:
                count = other.ess
            error += variance / max(count, 1.0)
            found.append(((below.mean() - level) / np.sqrt(error), f"{name} {100 * level:.0f} %"))
    z = np.array([value for value, _ in found])
    worst = int(np.argmax(np.abs(z)))
    return Agreement(float(z[worst]), found[worst][1], float(np.sqrt((z**2).mean())), len(z))
