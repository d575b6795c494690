"""Materials drawn from the priors of a run, and how much less its posterior spreads.

A quantity that follows from the parameters has no prior of its own; its prior is what the
parameters' priors make of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from biaxbayes.findings.derived import Derived
from biaxbayes.findings.sampling_scale import judged_scales, prior_values
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior, Tie
from biaxbayes.mechanics.goh import PARAMETERS

__all__ = ["contractions", "prior_material", "spread"]

PRIOR_DRAWS = 4096


def prior_material(posterior: Posterior, draws: pd.DataFrame) -> pd.DataFrame:
    """Materials drawn from the priors of a run.

    Parameters
    ----------
    posterior : Posterior
    draws : DataFrame
        Its draws, for the names.
    """
    rng = np.random.default_rng(0)
    level = (np.arange(PRIOR_DRAWS) + 0.5) / PRIOR_DRAWS
    columns: dict[str, np.ndarray] = {}
    scales = judged_scales(posterior.priors, draws)
    for scale in scales:
        if scale.kind in PARAMETERS and isinstance(scale.prior, Prior):
            columns[scale.name] = prior_values(scale.prior, rng.permutation(level))
        elif scale.kind in PARAMETERS and isinstance(scale.prior, int | float):
            columns[scale.name] = np.full(PRIOR_DRAWS, float(scale.prior))
    for scale in scales:
        if isinstance(scale.prior, Tie) and scale.kind in PARAMETERS:
            columns[scale.name] = scale.prior.factor * columns[scale.prior.other]
    return pd.DataFrame(columns)


def spread(quantity: Derived) -> float:
    """Half the width of the middle 68 %: of the logarithm, where the quantity has a unit."""
    values = quantity.values
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.log(values) if quantity.unit else values
    moved = moved[np.isfinite(moved)]
    if not moved.size:
        return np.inf
    low, high = np.quantile(moved, [0.1587, 0.8413])
    return max(0.5 * float(high - low), 1e-12)


def contractions(prior: Sequence[Derived], posterior: Sequence[Derived]) -> list[float]:
    """Share by which the data shrink the variance of each quantity.

    Parameters
    ----------
    prior, posterior : sequence of Derived
        The same quantities of draws from both.
    """
    return [
        1.0 - (spread(after) / spread(before)) ** 2
        for before, after in zip(prior, posterior, strict=True)
    ]
