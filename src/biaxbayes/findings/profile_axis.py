"""The axis that a profile is walked along: which scale, how far, in which steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.inference.starting_points import UPPER
from biaxbayes.mechanics.goh import PARAMETERS
from biaxbayes.mechanics.mounting import BRACKET

__all__ = ["Axis", "axis_of"]

LOGARITHMIC = ("C1", "k1", "k2")
LEAST = {"C1": 1e-4, "k1": 1e-4, "k2": 1e-4}
"""Where a walk towards zero ends; the value itself then stands for zero (kPa, kPa, 1)."""


@dataclass(frozen=True)
class Axis:
    """Scale and range of a profiled parameter.

    Attributes
    ----------
    index : int
        Position among the unknowns (C1, k1, k2, cos^2 alpha, kappa, mounting stretches).
    kind : str
        Parameter name without the label of a mounted state.
    low, high : float
        Range on the axis: natural logs, degrees, or natural values.
    first_step, least_step, most_step : float
    """

    index: int
    kind: str
    low: float
    high: float
    first_step: float
    least_step: float
    most_step: float

    @property
    def unit(self) -> str:
        """Unit of the natural values."""
        return {"C1": "kPa", "k1": "kPa", "alpha": "deg"}.get(self.kind, "")

    @property
    def mirrored(self) -> bool:
        """Whether the curve goes on as its own image at the ends."""
        return self.kind == "alpha"

    def forward(self, unknown: float) -> float:
        """From an unknown of the fit to the axis."""
        if self.kind in LOGARITHMIC:
            return float(np.log(max(unknown, LEAST[self.kind])))
        if self.kind == "alpha":
            return float(np.rad2deg(np.arccos(np.sqrt(min(max(unknown, 0.0), 1.0)))))
        return float(unknown)

    def back(self, at: float) -> float:
        """From the axis to an unknown of the fit."""
        if self.kind in LOGARITHMIC:
            return 0.0 if at <= self.low else float(np.exp(at))
        if self.kind == "alpha":
            return 0.0 if at >= 90.0 else float(np.cos(np.radians(at)) ** 2)
        return float(at)

    def natural(self, at: float) -> float:
        """From the axis to natural units."""
        if self.kind in LOGARITHMIC:
            return 0.0 if at <= self.low else float(np.exp(at))
        return float(at)

    def clipped(self, at: float) -> float:
        """A place within the range."""
        return float(min(max(at, self.low), self.high))

    def anchors(self, centre: float) -> np.ndarray:
        """Places over the whole range where a profile is looked at from afresh."""
        if self.kind in LOGARITHMIC:
            steps = np.log([1e-3, 1e-2, 0.1, 0.3, 3.0, 10.0, 100.0])
            return np.unique(np.clip([self.low, *(centre + steps)], self.low, self.high))
        if self.kind in ("alpha", "kappa"):
            return np.linspace(self.low, self.high, 9)
        return np.clip(centre + np.array([-0.05, -0.02, 0.02, 0.05]), self.low, self.high)

    def at_end(self, at: float, side: int) -> bool:
        """Whether the walk on a side has reached the end of the range."""
        return at <= self.low if side < 0 else at >= self.high


def axis_of(parameter: str, index: int) -> Axis:
    """Axis of a parameter at a position among the unknowns."""
    kind = parameter.split("[")[0]
    if kind in LOGARITHMIC:
        high = float(np.log(UPPER[PARAMETERS.index(kind)]))
        return Axis(index, kind, float(np.log(LEAST[kind])), high, 0.02, 1e-4, 0.8)
    if kind == "alpha":
        return Axis(index, kind, 0.0, 90.0, 0.5, 1e-3, 5.0)
    if kind == "kappa":
        return Axis(index, kind, 0.0, 1.0 / 3.0, 0.004, 1e-5, 0.02)
    return Axis(index, kind, *BRACKET, 0.0005, 1e-6, 0.01)
