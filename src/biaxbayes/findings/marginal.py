"""Shape of a one-dimensional sample: its density, its peaks, and where it stays open.

The likelihood of a parameter with everything else averaged out is posterior over prior density.
In the variable v = cumulative prior probability the prior is flat, so that the density of v is
that likelihood, whatever the prior: its value at v = 0 and 1, relative to its maximum, says
whether the data close the parameter's range on that side.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from biaxbayes.findings.bounded_density import Span, curve

__all__ = ["Density", "count_modes", "density"]

BEYOND = 0.15  # of the sample's range, left beside it for the tails
SADDLE, MODE_MASS = 0.7, 0.05


@dataclass(frozen=True)
class Density:
    """A density on a grid.

    Attributes
    ----------
    x, height : ndarray, shape (m,)
    """

    x: np.ndarray
    height: np.ndarray

    @property
    def peak(self) -> float:
        """Its maximum."""
        return float(self.height.max())

    def at(self, x: float) -> float:
        """Height at a point; zero outside the grid."""
        return float(np.interp(x, self.x, self.height, left=0.0, right=0.0))

    def width_above(self, share: float) -> float:
        """Length on which the density is at least a share of its maximum."""
        above = self.height >= share * self.peak
        return float(np.sum(np.gradient(self.x)[above]))


def density(sample: np.ndarray, walls: tuple[float, float] = (-np.inf, np.inf)) -> Density:
    """Density of a sample, reflected at walls.

    Parameters
    ----------
    sample : ndarray, shape (n,)
    walls : (float, float)
        Where the density ends, infinite where it does not.

    Returns
    -------
    Density
        Its grid spans the sample, and reaches a wall that is near.
    """
    low, high = float(sample.min()), float(sample.max())
    beyond = max(BEYOND * (high - low), 1e-9 * max(1.0, abs(low)))
    low, high = max(low - beyond, walls[0]), min(high + beyond, walls[1])
    axis = Span(low, high, closed_low=low == walls[0], closed_high=high == walls[1])
    x, height = curve(sample, axis)
    return Density(x, np.maximum(height, 0.0) / (high - low))


def count_modes(sample: np.ndarray, walls: tuple[float, float] = (-np.inf, np.inf)) -> int:
    """Number of separate peaks, such that Monte Carlo noise does not add any.

    A peak counts if the lowest point between it and any higher one is below 70 % of it and if
    5 % of the draws lie in it; in the whole sample and in both of two interleaved halves.
    """
    return min(
        _peaks(density(part, walls)) for part in (sample, sample[::2], sample[1::2]) if part.size
    )


def _peaks(found: Density) -> int:
    """Peaks by prominence: valleys are taken away, the shallowest first."""
    h = found.height
    inner = np.flatnonzero((h[1:-1] > h[:-2]) & (h[1:-1] >= h[2:])) + 1
    tops = [int(i) for i in inner]
    if h[0] > h[1]:
        tops.insert(0, 0)
    if h[-1] > h[-2]:
        tops.append(h.size - 1)
    valleys = [int(a + np.argmin(h[a : b + 1])) for a, b in pairwise(tops)]
    while valleys:
        depth = [h[v] / min(h[a], h[b]) for v, a, b in zip(valleys, tops, tops[1:], strict=False)]
        ends = [0, *valleys, h.size - 1]
        mass = [h[a : b + 1].sum() / h.sum() for a, b in pairwise(ends)]
        shallow, light = int(np.argmax(depth)), int(np.argmin(mass))
        if depth[shallow] > SADDLE:
            join = shallow
        elif mass[light] < MODE_MASS:
            join = min(light, len(valleys) - 1)
        else:
            break
        lower = join if h[tops[join]] < h[tops[join + 1]] else join + 1
        del tops[lower], valleys[join]
    return max(len(tops), 1)
