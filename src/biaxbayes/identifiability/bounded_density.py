"""Density of draws along one axis, smoothed, that ends where physics ends it.

A Gaussian kernel smears mass past the ends kappa = 0, kappa = 1/3, alpha = 0 and 90 degrees of a
range, and a posterior that piles up there would seem to vanish there. Mass that leaves the range is
reflected back, so the density keeps its height up to the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BINS = 256
TAIL = 0.0005
"""Fraction of the draws on each side that a range may leave out."""
MARGIN = 0.08
"""Fraction of the range of the draws added on either side."""


@dataclass(frozen=True)
class Span:
    """Range of one axis of a figure, in natural values."""

    low: float
    high: float
    closed_low: bool = False  # a physical limit with mass at it
    closed_high: bool = False
    log: bool = False

    def forward(self, values: np.ndarray) -> np.ndarray:
        """Values as positions on the axis, 0 at its low end and 1 at its high end."""
        low, high = (np.log([self.low, self.high])) if self.log else (self.low, self.high)
        with np.errstate(divide="ignore"):
            moved = np.log(values) if self.log else np.asarray(values, dtype=float)
        return (moved - low) / (high - low)

    def back(self, positions: np.ndarray) -> np.ndarray:
        """Natural values of positions."""
        positions = np.asarray(positions, dtype=float)
        if self.log:
            return self.low * (self.high / self.low) ** positions
        return self.low + (self.high - self.low) * positions


def span(
    *columns: np.ndarray,
    limits: tuple[float, float] = (-np.inf, np.inf),
    log: bool = False,
    include: tuple[float, ...] = (),
) -> Span:
    """Range of the draws of one or more runs and of values to include; it ends at a near limit."""
    log = log and all(float(c.min()) > 0.0 for c in columns) and all(v > 0 for v in include)
    moved = [np.log(c) if log else c for c in columns]
    seen = [float(np.log(v)) if log else v for v in include]
    low = min([float(np.quantile(c, TAIL)) for c in moved] + seen)
    high = max([float(np.quantile(c, 1.0 - TAIL)) for c in moved] + seen)
    margin = MARGIN * (high - low)
    if margin <= 1e-9 * max(abs(low), abs(high)):
        margin = 0.05 * max(abs(low), 1e-6)
    low, high = low - margin, high + margin
    first, last = ((np.log(e) if e > 0.0 else -np.inf) if log and e < np.inf else e for e in limits)
    closed = low <= first, high >= last
    low, high = max(low, first), min(high, last)
    if log:
        low, high = float(np.exp(low)), float(np.exp(high))
    return Span(float(low), float(high), bool(closed[0]), bool(closed[1]), log)


def curve(values: np.ndarray, axis: Span) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed density (m,) per unit of the axis, at natural values (m,) evenly spaced on it."""
    u = axis.forward(values)
    counts, _ = np.histogram(u, BINS, (0.0, 1.0))
    # Silverman's rule with a robust sd: h = 0.9 sd n^(-1/5)
    bandwidth = 0.9 * robust_sd(u) * min(u.size, 20_000) ** -0.2
    sd = max(bandwidth * BINS, 1.0)
    reach = min(int(np.ceil(4.0 * sd)), BINS)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sd) ** 2)
    padded = counts.astype(float)
    sides = ((reach, 0), axis.closed_low), ((0, reach), axis.closed_high)
    for end, closed in sides:
        # A mirror image beyond closed ends, and nothing beyond open ones.
        padded = np.pad(padded, end, mode="symmetric" if closed else "constant")
    density = np.convolve(padded, kernel / kernel.sum(), mode="valid") * BINS / u.size
    middle = (np.arange(BINS) + 0.5) / BINS
    # At a closed end the slope is zero by symmetry; elsewhere the last value is held.
    ends = np.interp([0.0, 1.0], middle, density)
    x = axis.back(np.concatenate([[0.0], middle, [1.0]]))
    return x, np.concatenate([ends[:1], density, ends[1:]])


def robust_sd(u: np.ndarray) -> float:
    """Standard deviation, or (q75 - q25) / 1.349, that of a normal, where tails inflate it."""
    q25, q75 = np.quantile(u, [0.25, 0.75])
    middle_sd = float(q75 - q25) / 1.349
    sd = float(np.std(np.clip(u, -1.0, 2.0)))
    return min(sd, middle_sd) if middle_sd > 0.0 else sd
