"""Densities of draws on a grid, smoothed, that end where physics ends them.

A Gaussian kernel smears mass over the edges kappa = 0, kappa = 1/3, alpha = 0 and 90 degrees, and a
posterior that piles up there would seem to vanish there. Mass that leaves through an edge is
reflected back, so the density keeps its height up to the edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Span", "at_edges", "curve", "interval", "levels", "span", "surface"]

BINS_1D, BINS_2D = 256, 96
TAIL = 2.5
"""Width of the kernel in the tails, relative to that elsewhere."""
THIN = 0.12
"""Tails are outside of the region of 90 %, and below this share of the highest density."""
MARGIN = 0.08
"""Share of the range of the draws that is left free beside them."""
TOUCHING = 0.5
"""A density at an edge above this share of its maximum is piled up there."""


@dataclass(frozen=True)
class Span:
    """Range of one axis of a figure.

    Attributes
    ----------
    low, high : float
    closed_low, closed_high : bool
        Whether an end is a physical edge with mass at it.
    log : bool
        Whether the axis is logarithmic; ``low`` and ``high`` are natural values all the same.
    """

    low: float
    high: float
    closed_low: bool = False
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

    @property
    def closed(self) -> tuple[bool, bool]:
        """``(closed_low, closed_high)``."""
        return self.closed_low, self.closed_high


def span(
    *columns: np.ndarray,
    edges: tuple[float, float] = (-np.inf, np.inf),
    log: bool = False,
    include: tuple[float, ...] = (),
) -> Span:
    """Range that shows the draws of one or more runs.

    Parameters
    ----------
    *columns : ndarray, shape (n,)
    edges : (float, float)
        Physical edges of the quantity. The range ends there if draws come close.
    log : bool
        Use a logarithmic axis, if all draws are positive.
    include : tuple of float
        Values that must be visible.
    """
    log = log and all(float(c.min()) > 0.0 for c in columns) and all(v > 0 for v in include)
    moved = [np.log(c) if log else c for c in columns]
    seen = [float(np.log(v)) if log else v for v in include]
    low = min([float(np.quantile(c, 0.002)) for c in moved] + seen)
    high = max([float(np.quantile(c, 0.998)) for c in moved] + seen)
    margin = MARGIN * (high - low)
    if margin <= 1e-9 * max(abs(low), abs(high)):
        margin = 0.05 * max(abs(low), 1e-6)
    low, high = low - margin, high + margin
    first, last = ((np.log(e) if e > 0.0 else -np.inf) if log and e < np.inf else e for e in edges)
    closed = low <= first, high >= last
    low, high = max(low, first), min(high, last)
    if log:
        low, high = float(np.exp(low)), float(np.exp(high))
    return Span(float(low), float(high), bool(closed[0]), bool(closed[1]), log)


def curve(values: np.ndarray, axis: Span) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed density along one axis.

    Parameters
    ----------
    values : ndarray, shape (n,)
    axis : Span

    Returns
    -------
    x : ndarray, shape (m,)
        Natural values, evenly spaced on the axis, its ends included.
    density : ndarray, shape (m,)
        Per unit of length of the axis (so per logarithm on a logarithmic one).
    """
    u = axis.forward(values)
    counts, _ = np.histogram(u, BINS_1D, (0.0, 1.0))
    # Silverman's rule with a robust sd: h = 0.9 sd n^(-1/5)
    bandwidth = 0.9 * _robust_sd(u) * min(u.size, 20_000) ** -0.2
    sd = max(bandwidth * BINS_1D, 1.0)
    reach = min(int(np.ceil(4.0 * sd)), BINS_1D)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sd) ** 2)
    padded = _padded(counts.astype(float), reach, (axis.closed,))
    density = np.convolve(padded, kernel / kernel.sum(), mode="valid") * BINS_1D / u.size
    middle = (np.arange(BINS_1D) + 0.5) / BINS_1D
    # At a closed end the slope is zero by symmetry; elsewhere the tail is followed outwards.
    ends = np.interp([0.0, 1.0], middle, density)
    x = axis.back(np.concatenate([[0.0], middle, [1.0]]))
    return x, np.concatenate([ends[:1], density, ends[1:]])


def surface(
    first: np.ndarray, second: np.ndarray, axes: tuple[Span, Span]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed joint density on two axes.

    The kernel has the shape of the draws' covariance, so that a narrow ridge stays narrow.

    Parameters
    ----------
    first, second : ndarray, shape (n,)
    axes : (Span, Span)

    Returns
    -------
    x, y : ndarray, shape (m,)
        Natural values of the grid.
    density : ndarray, shape (m, m)
        Rows follow ``y``, as matplotlib wants it; sums to the share of draws on the grid.
    """
    u = np.column_stack([axis.forward(v) for axis, v in zip(axes, (first, second), strict=True)])
    inside = np.all((u >= 0.0) & (u <= 1.0), axis=1)
    cells = np.minimum((u[inside] * BINS_2D).astype(int), BINS_2D - 1)
    counts = np.bincount(cells[:, 1] * BINS_2D + cells[:, 0], minlength=BINS_2D**2)
    grid = counts.reshape(BINS_2D, BINS_2D) / len(u)
    # Scott's rule: kernel covariance = h^2 * covariance of the draws, h = n^(-1/6)
    scott = min(len(u), 20_000) ** (-1.0 / 3.0)
    narrow, wide = (0.8 * scott * BINS_2D**2 * c for c in _covariances(u))
    closed = (axes[1].closed, axes[0].closed)
    smooth = _smoothed(grid, narrow, closed)
    # Few draws make the tails: a wider kernel there, as an adaptive estimate has it.
    tail = smooth < min(levels(np.pad(smooth, 1), (0.9,))[0], THIN * smooth.max())
    smooth = _smoothed(np.where(tail, 0.0, grid), narrow, closed)
    smooth += _smoothed(np.where(tail, grid, 0.0), TAIL**2 * wide, closed)
    middle = (np.arange(BINS_2D) + 0.5) / BINS_2D
    # The outermost cells are drawn up to the end of the axis.
    x, y = (axis.back(np.concatenate([[0.0], middle, [1.0]])) for axis in axes)
    return x, y, np.pad(smooth, 1, mode="edge")


def levels(density: np.ndarray, contents: tuple[float, ...]) -> np.ndarray:
    """Heights whose regions hold the given shares of the mass, ascending.

    Parameters
    ----------
    density : ndarray
        From :func:`surface`.
    contents : tuple of float
        Such as ``(0.5, 0.9)``.
    """
    ordered = np.sort(density[1:-1, 1:-1], axis=None)[::-1]
    mass = np.cumsum(ordered)
    if not mass[-1] > 0.0:
        return np.linspace(1.0, 2.0, len(contents))
    index = np.searchsorted(mass / mass[-1], sorted(contents, reverse=True))
    heights = ordered[np.minimum(index, ordered.size - 1)]
    # Contours need levels that rise, whatever the ties.
    return np.maximum.accumulate(heights + np.arange(len(heights)) * 1e-9 * ordered[0])


def at_edges(density: np.ndarray, axis: Span) -> tuple[bool, bool]:
    """Whether a density from :func:`curve` piles up at the (low, high) edge."""
    high = TOUCHING * density.max()
    return bool(axis.closed_low and density[0] > high), bool(
        axis.closed_high and density[-1] > high
    )


def interval(
    values: np.ndarray, piled: tuple[bool, bool], probability: float = 0.9
) -> tuple[float, float]:
    """Central interval, or one-sided where the draws pile up at one physical edge.

    A central interval would exclude the edge, which is where the density is highest.
    """
    tail = 1.0 - probability
    if piled == (True, False):
        return float(values.min()), float(np.quantile(values, probability))
    if piled == (False, True):
        return float(np.quantile(values, tail)), float(values.max())
    low, high = np.quantile(values, [0.5 * tail, 1.0 - 0.5 * tail])
    return float(low), float(high)


def _robust_sd(u: np.ndarray) -> float:
    """Standard deviation, or that of the middle half where tails inflate it."""
    q25, q75 = np.quantile(u, [0.25, 0.75])
    spread = float(q75 - q25) / 1.349
    sd = float(np.std(np.clip(u, -1.0, 2.0)))
    return min(sd, spread) if spread > 0.0 else sd


def _covariances(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance with the sds of :func:`_robust_sd`, and that of the draws on the axes."""
    seen = np.clip(u, 0.0, 1.0)
    centred = seen - np.median(seen, axis=0)
    full = centred.T @ centred / len(u)
    scale = np.sqrt(np.diag(full))
    sd = np.array([_robust_sd(u[:, 0]), _robust_sd(u[:, 1])])
    if np.any(scale == 0.0):
        return np.diag(sd**2), np.diag(sd**2)
    correlation = np.clip(full[0, 1] / np.prod(scale), -0.995, 0.995)
    shape = np.array([[1.0, correlation], [correlation, 1.0]])
    return shape * np.outer(sd, sd), shape * np.outer(scale, scale)


def _padded(grid: np.ndarray, reach: int, closed: tuple[tuple[bool, bool], ...]) -> np.ndarray:
    """The grid with its mirror image beyond closed ends and nothing beyond open ones."""
    for axis, ends in enumerate(closed):
        for end, is_closed in enumerate(ends):
            width = [(0, 0)] * grid.ndim
            width[axis] = (0, reach) if end else (reach, 0)
            if is_closed:
                grid = np.pad(grid, width, mode="symmetric")
            else:
                grid = np.pad(grid, width)
    return grid


def _smoothed(
    grid: np.ndarray, covariance: np.ndarray, closed: tuple[tuple[bool, bool], ...]
) -> np.ndarray:
    """The grid convolved with a Gaussian kernel of a covariance in cells."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    covariance = covariance + 0.7**2 * np.eye(2)  # never finer than the grid
    reach = int(min(np.ceil(4.0 * np.sqrt(covariance.max())), BINS_2D))
    padded = _padded(grid, reach, closed)
    step = np.arange(-reach, reach + 1)
    dx, dy = np.meshgrid(step, step)
    (pxx, pxy), (_, pyy) = np.linalg.inv(covariance)
    kernel = np.exp(-0.5 * (pxx * dx**2 + 2.0 * pxy * dx * dy + pyy * dy**2))
    # Cyclic convolution: what wraps around falls on the padding, which is cut off.
    shape = [next_fast_len(n, real=True) for n in padded.shape]
    product = rfft2(padded, shape) * rfft2(kernel / kernel.sum(), shape)
    full = irfft2(product, shape)[2 * reach :, 2 * reach :]
    return np.asarray(np.maximum(full[: grid.shape[0], : grid.shape[1]], 0.0))
