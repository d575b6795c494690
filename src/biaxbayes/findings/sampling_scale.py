"""The scale on which a parameter's prior and posterior are compared.

Stiffnesses and the exponent are compared in natural logs, the angle in degrees, the dispersion
and the mounting stretches as they are: the scales on which the default priors are normal or
flat.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtr, ndtri

from biaxbayes.inference.priors import DEFAULT_BOUNDS, Prior, Tie
from biaxbayes.mechanics.goh import PARAMETERS

__all__ = ["Scale", "judged_scales", "prior_cumulative", "prior_values"]

LOGARITHMIC = ("C1", "k1", "k2")
UNITS = {"C1": "kPa", "k1": "kPa", "alpha": "deg"}
LEVELS = 4096  # prior percentiles that stand for a prior


@dataclass(frozen=True)
class Scale:
    """A parameter, its prior and the scale to compare them on.

    Attributes
    ----------
    name : str
        As in the draws.
    kind : str
        The name without the label of a mounted state.
    prior : Prior, Tie or float
        A number where the parameter was fixed.
    """

    name: str
    kind: str
    prior: Prior | Tie | float

    @property
    def unit(self) -> str:
        """Unit of the parameter, empty where it has none."""
        return UNITS.get(self.kind, "")

    @property
    def logarithmic(self) -> bool:
        """Whether it is compared in natural logs."""
        return self.kind in LOGARITHMIC

    @property
    def label(self) -> str:
        """Name of the scale."""
        return f"ln {self.name}" if self.logarithmic else self.name

    def of(self, natural: np.ndarray) -> np.ndarray:
        """Natural values on the scale."""
        with np.errstate(divide="ignore"):
            return np.log(natural) if self.logarithmic else np.asarray(natural, dtype=float)

    def natural(self, scaled: np.ndarray) -> np.ndarray:
        """Inverse of :meth:`of`."""
        return np.exp(scaled) if self.logarithmic else np.asarray(scaled, dtype=float)

    @property
    def walls(self) -> tuple[float, float]:
        """Natural values where the density ends; infinite where it does not."""
        low, high = DEFAULT_BOUNDS.get(self.kind, (-np.inf, np.inf))
        if isinstance(self.prior, Prior):
            low, high = max(low, self.prior.low), min(high, self.prior.high)
        return low, high


def judged_scales(
    priors: Mapping[str, Prior | Tie | float], draws: pd.DataFrame
) -> tuple[Scale, ...]:
    """The material parameters and mounting stretches of a run, in the order of its columns."""
    out = []
    for name in map(str, draws.columns):
        kind = name.split("[")[0]
        if kind in PARAMETERS or kind in ("mounting_stretch_x", "mounting_stretch_y"):
            out.append(Scale(name, kind, priors[name]))
    return tuple(out)


def prior_cumulative(prior: Prior, natural: np.ndarray) -> np.ndarray:
    """Cumulative prior probability of natural values."""
    z, low, high, logs = _standard(prior)
    with np.errstate(divide="ignore"):
        x = np.log(np.maximum(natural, 0.0)) if logs else np.asarray(natural, dtype=float)
    if prior.family in ("uniform", "loguniform"):
        return np.clip((x - low) / (high - low), 0.0, 1.0)
    first, last = ndtr(z(low)), ndtr(z(high))
    return np.clip((ndtr(z(x)) - first) / (last - first), 0.0, 1.0)


def prior_values(prior: Prior, probability: np.ndarray | None = None) -> np.ndarray:
    """Natural values at cumulative prior probabilities (default: 4096 even ones)."""
    if probability is None:
        probability = (np.arange(LEVELS) + 0.5) / LEVELS
    z, low, high, logs = _standard(prior)
    if prior.family in ("uniform", "loguniform"):
        x = low + (high - low) * probability
    else:
        first, last = ndtr(z(low)), ndtr(z(high))
        location, scale = _location_scale(prior)
        x = location + scale * ndtri(first + (last - first) * probability)
    return np.exp(x) if logs else x


def _location_scale(prior: Prior) -> tuple[float, float]:
    location = float(np.log(prior.location)) if prior.family == "lognormal" else prior.location
    return location, prior.scale


def _standard(prior: Prior):
    """Standardisation, range and whether it is in logs, where the prior is normal or flat."""
    logs = prior.family in ("lognormal", "loguniform")
    low, high = prior.low, prior.high
    if logs:
        low = float(np.log(low)) if low > 0.0 else -np.inf
        high = float(np.log(high)) if high < np.inf else np.inf

    def z(x):
        location, scale = _location_scale(prior)
        return (x - location) / scale

    return z, low, high, logs
