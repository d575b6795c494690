"""Distances of posteriors from one another, and from their priors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from biaxbayes.derived.determined import Derived
from biaxbayes.identifiability.marginals import parameter_scales
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior, Tie
from biaxbayes.parameters import MATERIAL
from biaxbayes.prediction.percentiles import quantile_columns


def distance(a: np.ndarray, b: np.ndarray) -> dict[str, float]:
    """Columns on the difference b - a of finite draws (n,) and (m,) of two independent runs.

    ``standardised`` is (mean b - mean a) / sqrt(var a + var b); ``kolmogorov`` the largest
    difference of the two cumulative distributions: 0 where they are the same, 1 where they do not
    overlap, whatever the scale of the quantity.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    rng = np.random.default_rng(0)  # pairs the draws
    n = max(a.size, b.size)
    difference = np.resize(rng.permutation(b), n) - np.resize(rng.permutation(a), n)
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
    return quantile_columns("difference", difference) | {
        "standardised": standardised,
        "probability_b_greater": float(0.5 * below.mean() / a.size),
        "kolmogorov": float(np.abs(cumulative[0] - cumulative[1]).max()),
    }


PRIOR_DRAWS = 4096
EQUIBIAXIAL_STEPS = 5


def equibiaxial_steps(largest: float) -> list[float]:
    """Five total equibiaxial stretches, evenly up to the largest, rounded down to 0.001."""
    top = 1.0 + np.floor(1e3 * (largest - 1.0)) / 1e3 if largest > 1.005 else largest
    steps = 1.0 + (top - 1.0) * np.arange(1, EQUIBIAXIAL_STEPS + 1) / EQUIBIAXIAL_STEPS
    return [float(round(v, 6)) for v in steps]


def prior_material(posterior: Posterior, draws: pd.DataFrame) -> pd.DataFrame:
    """Materials from the priors of a run; of them follow the priors of derived quantities."""
    rng = np.random.default_rng(0)
    level = (np.arange(PRIOR_DRAWS) + 0.5) / PRIOR_DRAWS
    columns: dict[str, np.ndarray] = {}
    scales = parameter_scales(posterior.priors, posterior.quantities, draws)
    material = {s.name: s.prior for s in scales if s.parameter.kind == MATERIAL}
    for name, prior in material.items():
        if isinstance(prior, Prior):
            columns[name] = prior.ppf(rng.permutation(level))
        elif isinstance(prior, int | float):
            columns[name] = np.full(PRIOR_DRAWS, float(prior))
    for name, prior in material.items():
        if isinstance(prior, Tie):
            columns[name] = prior.factor * columns[prior.other]
    return pd.DataFrame(columns)


def spread(quantity: Derived) -> float:
    """Half the width of the middle 68 %: of the logarithm, where the quantity has a unit."""
    values = quantity.values
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = np.log(values) if quantity.unit else values
    scaled = scaled[np.isfinite(scaled)]
    if not scaled.size:
        return np.inf
    low, high = np.quantile(scaled, [0.1587, 0.8413])
    return max(0.5 * float(high - low), 1e-12)


def contractions(prior: Sequence[Derived], posterior: Sequence[Derived]) -> list[float]:
    """Fraction by which the data shrink the variance of each quantity, given in the same order."""
    pairs = zip(prior, posterior, strict=True)
    return [1.0 - (spread(after) / spread(before)) ** 2 for before, after in pairs]
