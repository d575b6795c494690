"""One parameter at a time: its scale, the shape of its draws, the bounds of its range.

The likelihood of a parameter with everything else averaged out is posterior over prior density.
In the variable v = cumulative prior probability the prior is flat, so that the density of v is
that likelihood, whatever the prior: its value at v = 0 and 1, relative to its maximum, says
whether the data close the parameter's range on that side.

Physical ends are those of the law, such as kappa at 0 (aligned fibres) and at 1/3 (isotropic), and
stiffnesses and exponents towards 0. An angle of 0 or 90 degrees is a mirror of the material, not an
end. Bounds that a user set are no property of tissue and are listed apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from biaxbayes.identifiability.bounded_density import Span, curve
from biaxbayes.model.priors import DrawnPrior, Prior, Tie
from biaxbayes.parameters import MATERIAL, STRETCH, OfQuantity, Parameter, Quantities, Quantity
from biaxbayes.prediction.percentiles import QUANTILES

# --- the scale on which a parameter's prior and posterior are compared ---------------------------

LEVELS = (np.arange(4096) + 0.5) / 4096
"""Cumulative probabilities whose values represent a prior."""
INTERVAL = (QUANTILES["q05"], QUANTILES["q95"])
"""Ends of the intervals of verdicts and tables."""
Z90 = 1.645
"""Standard deviations from the mean of a normal to the ends of its central 90 % interval."""


@dataclass(frozen=True)
class ComparisonScale(OfQuantity):
    """A parameter with its prior (a number if fixed) and the scale to compare them on."""

    quantity: Quantity
    prior: Prior | DrawnPrior | Tie | float

    @property
    def parameter(self) -> Parameter:
        """The parameter, in whichever mounted state."""
        return self.quantity.parameter

    @property
    def label(self) -> str:
        """Name of the scale."""
        return f"ln {self.name}" if self.parameter.logarithmic else self.name

    def to_scale(self, values: np.ndarray) -> np.ndarray:
        """Natural values (kPa, degrees) on the scale."""
        with np.errstate(divide="ignore"):
            return np.log(values) if self.parameter.logarithmic else np.asarray(values, dtype=float)

    def from_scale(self, scaled: np.ndarray) -> np.ndarray:
        """Inverse of :meth:`to_scale`."""
        return np.exp(scaled) if self.parameter.logarithmic else np.asarray(scaled, dtype=float)

    @property
    def limits(self) -> tuple[float, float]:
        """Natural values where the density ends; infinite where it does not."""
        p = self.parameter
        low, high = p.range if p.bounded else (-np.inf, np.inf)
        if isinstance(self.prior, Prior):
            low, high = max(low, self.prior.low), min(high, self.prior.high)
        return low, high


def parameter_scales(
    priors: Mapping[str, Prior | DrawnPrior | Tie | float],
    quantities: Quantities,
    draws: pd.DataFrame,
) -> tuple[ComparisonScale, ...]:
    """The material parameters and mounting stretches of a run, in the order of its columns."""
    assessed = {q.name: q for q in quantities.assessed()}
    return tuple(
        ComparisonScale(assessed[n], priors[n]) for n in map(str, draws.columns) if n in assessed
    )


# --- shape of a one-dimensional sample: its density and its peaks --------------------------------

GRID_MARGIN = 0.15  # of the sample's range, added on either side for the tails
MAX_VALLEY_RATIO, MIN_MODE_MASS = 0.7, 0.05


@dataclass(frozen=True)
class Density:
    """A density on a grid, shapes (m,)."""

    x: np.ndarray
    height: np.ndarray

    @property
    def peak(self) -> float:
        """Its maximum."""
        return float(self.height.max())

    def at(self, x: float) -> float:
        """Height at a point; zero outside the grid."""
        return float(np.interp(x, self.x, self.height, left=0.0, right=0.0))

    def width_above(self, fraction: float) -> float:
        """Length on which the density is at least a fraction of its maximum."""
        above = self.height >= fraction * self.peak
        return float(np.sum(np.gradient(self.x)[above]))


def density(sample: np.ndarray, limits: tuple[float, float] = (-np.inf, np.inf)) -> Density:
    """Density of a sample, reflected at limits; its grid reaches a limit that is near."""
    low, high = float(sample.min()), float(sample.max())
    beyond = max(GRID_MARGIN * (high - low), 1e-9 * max(1.0, abs(low)))
    low, high = max(low - beyond, limits[0]), min(high + beyond, limits[1])
    axis = Span(low, high, closed_low=low == limits[0], closed_high=high == limits[1])
    x, height = curve(sample, axis)
    return Density(x, np.maximum(height, 0.0) / (high - low))


def count_modes(
    sample: np.ndarray,
    limits: tuple[float, float] = (-np.inf, np.inf),
    whole: Density | None = None,
) -> int:
    """Number of peaks that the whole sample and two interleaved halves show."""
    fewest = _peaks(whole or density(sample, limits))
    for half in (sample[::2], sample[1::2]):
        if fewest > 1 and half.size:
            fewest = min(fewest, _peaks(density(half, limits)))
    return fewest


def _peaks(shape: Density) -> int:
    """Number of peaks by prominence: valleys are removed, the shallowest first."""
    h = shape.height
    padded = np.pad(h, 1)  # so that an end of the range may be a peak
    peaks = np.flatnonzero((h > padded[:-2]) & (h >= padded[2:])).tolist()
    valleys = [int(a + np.argmin(h[a : b + 1])) for a, b in pairwise(peaks)]
    while valleys:
        depth = [h[v] / min(h[a], h[b]) for v, a, b in zip(valleys, peaks, peaks[1:], strict=False)]
        ends = [0, *valleys, h.size - 1]
        mass = [float(np.sum(h[a : b + 1]) / np.sum(h)) for a, b in pairwise(ends)]
        shallow, light = int(np.argmax(depth)), int(np.argmin(mass))
        if depth[shallow] > MAX_VALLEY_RATIO:
            join = shallow
        elif mass[light] < MIN_MODE_MASS:
            join = min(light, len(valleys) - 1)
        else:
            break
        lower = join if h[peaks[join]] < h[peaks[join + 1]] else join + 1
        del peaks[lower], valleys[join]
    return max(len(peaks), 1)


# --- where a parameter's range ends, and whether the data keep it away from there ----------------

PRIOR_TAIL = 0.025  # fraction of a prior without bounds that counts as its end
BOUND_TAIL = 0.05  # fraction of a prior that counts as near a bound
OUT_OF_REACH = 1e-3  # fraction of a prior near an end of the law below which the prior excludes it


@dataclass(frozen=True)
class RangeEnd:
    """One end of a parameter's range."""

    side: int  # 0 low, 1 high
    value: float  # natural; without an end the prior's 2.5 % or 97.5 % quantile
    kind: str  # "physical" (of the law), "user" (bound of the prior) or "prior" (its tail)
    distance: float  # what counts as near, in the parameter's unit
    mass: float  # fraction of the draws that near
    prior_mass: float  # fraction of the prior that near
    support: float  # averaged likelihood there over its maximum


def _prior_mass(prior: Prior | DrawnPrior, side: int, threshold: float) -> float:
    """Fraction of a prior beyond a threshold, on one side."""
    below = float(prior.cdf(np.array([threshold]))[0])
    return below if side == 0 else 1.0 - below


def range_ends(
    scale: ComparisonScale, values: np.ndarray, likelihood: Density, distance: float | None
) -> tuple[RangeEnd, ...]:
    """Both ends of a parameter's range, none for a mirror; `likelihood` is over the prior's cdf."""
    prior, parameter = scale.prior, scale.parameter
    assert isinstance(prior, Prior | DrawnPrior)
    out = []
    for side in (0, 1):
        end, bound = parameter.range[side], (prior.low, prior.high)[side]
        physical = parameter.kind == MATERIAL and np.isfinite(end)
        by_user = np.isfinite(bound) and not (physical and abs(bound - end) < 1e-12)
        if bound == 0.0 and parameter.kind == STRETCH:
            by_user = False  # a stretch is positive, which is no one's choice
        if parameter.mirror and not by_user:
            continue
        tail = BOUND_TAIL if by_user else PRIOR_TAIL
        threshold = float(prior.ppf(np.array([tail if side == 0 else 1.0 - tail]))[0])
        kind, value, near = "prior", threshold, 0.0  # in the tail of the prior
        if by_user:
            kind, value, near = "user", float(bound), abs(threshold - float(bound))
        elif physical:
            assert distance is not None
            inside = end + distance if side == 0 else end - distance
            # a prior that excludes the end of the law, as one from imaging may, ends before it
            if _prior_mass(prior, side, inside) > OUT_OF_REACH:
                kind, value, near, threshold = "physical", end, distance, inside
        prior_mass = _prior_mass(prior, side, threshold)
        mass = float((values <= threshold if side == 0 else values >= threshold).mean())
        if kind == "prior":
            support = min(mass / prior_mass / likelihood.peak, 1.0)
        else:
            support = likelihood.at(float(side)) / likelihood.peak
        out.append(RangeEnd(side, value, kind, near, mass, prior_mass, support))
    return tuple(out)
