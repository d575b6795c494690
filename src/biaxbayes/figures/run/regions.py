"""The joint posterior of two quantities as regions of given content, drawn by the corner package.

The density is ours: draws in cells, smoothed by a kernel whose width suits each pair and run, wider
where few draws lie.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from scipy.ndimage import gaussian_filter

from biaxbayes.identifiability.bounded_density import Span, robust_sd
from biaxbayes.prediction.bands import evenly_chosen

CONTENTS = (0.5, 0.9, 0.99)
"""Contents of the regions as shares of the draws."""
SHADES = (0.18, 0.42, 0.78)
"""Darkness of the regions, the widest first."""
FILL = 0.3
"""Opacity of the region of 50 % and of the marginal in an overlay."""
CELLS = 1.5
"""Width (sd) of the smoothing kernel in cells of the histogram."""
WIDER = 1.25
"""Width of the kernel of a pair, relative to Scott's."""
WIDEST = 1.5
"""Times that the kernel of a pair is doubled at most, for draws beyond the region of 90 %."""
VISIBLE = 20_000
"""Number of draws of a pair that are used; more would not be visible."""


def regions(
    ax: Axes, pair: Sequence[np.ndarray], axes: Sequence[Span], hue: str, *, filled: bool | None
) -> None:
    """Draw a joint posterior: shaded (True), the 90 % outline (False), or 50 % in it (None)."""
    import corner  # imports ArviZ, which takes a second or two

    shown = evenly_chosen(len(pair[0]), VISIBLE)
    along = np.array([a.forward(draws[shown]) for a, draws in zip(axes, pair, strict=True)])
    bins = cells(along)
    centres = [a.back((np.arange(n) + 0.5) / n) for a, n in zip(axes, bins, strict=True)]
    density, at_draws = _smooth(along, bins)
    look = _look(hue, filled)
    # corner counts the mass of the density; smoothing has spread that of the draws
    edges = np.quantile(at_draws, 1.0 - np.array(look["levels"]))
    look["levels"] = [density[density >= edge].sum() / density.sum() for edge in edges]
    corner.hist2d(
        *(c.ravel() for c in np.meshgrid(*centres, indexing="ij")),
        weights=density.ravel(),
        ax=ax,
        range=[(a.low, a.high) for a in axes],
        axes_scale=["log" if a.log else "linear" for a in axes],
        bins=bins,
        **look,
    )


def _smooth(along: np.ndarray, bins: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed density in cells and at the draws; the kernel widens where the density is low.

    Width (Abramson 1982): h (f90 / f)^(1/2) where the density f is below f90, that at the
    edge of the 90 % region. A single width leaves islands of single draws.
    """
    inside = np.all((along >= 0.0) & (along <= 1.0), axis=0)
    cell = [
        np.minimum((u * n).astype(int), n - 1) for u, n in zip(along[:, inside], bins, strict=True)
    ]
    counts = np.bincount(np.ravel_multi_index(cell, bins), minlength=bins[0] * bins[1])
    counts = counts.reshape(bins).astype(float)
    pilot = gaussian_filter(counts, CELLS)
    edge = np.quantile(pilot[tuple(cell)], 1.0 - CONTENTS[1])
    # log2 of the width; between two powers of two a cell's draws are shared by both kernels
    wider = np.clip(0.5 * np.log2(edge / np.maximum(pilot, 1e-300)), 0.0, WIDEST)
    density = np.zeros_like(counts)
    for k in range(math.ceil(WIDEST) + 1):
        share = counts * np.maximum(1.0 - np.abs(wider - k), 0.0)
        density += gaussian_filter(share, CELLS * 2.0**k)
    return density, density[tuple(cell)]


def cells(along: np.ndarray) -> list[int]:
    """Cells per axis for Scott's kernel h = sd n^(-1/6), narrower on a ridge."""
    sd, n = np.array([max(robust_sd(u), 1e-6) for u in along]), along.shape[1]
    r = np.corrcoef(np.clip(along, 0.0, 1.0))[0, 1] if n > 2 else 0.0
    # sd of one quantity where the other is known: sd sqrt(1 - r^2); halfway to it, in logs
    ridge = (1.0 - min(abs(np.nan_to_num(r)), 0.999) ** 2) ** 0.25
    return [int(np.clip(CELLS / h, 30, 250)) for h in WIDER * ridge * sd * n ** (-1.0 / 6.0)]


def _look(hue: str, filled: bool | None) -> dict[str, Any]:
    """Colours and levels of :func:`corner.hist2d`."""
    look: dict[str, Any] = {"color": hue, "plot_datapoints": False, "plot_density": False}
    look |= {"quiet": True, "no_fill_contours": True, "fill_contours": filled is not False}
    if filled is False:
        return look | {"levels": (0.9,), "contour_kwargs": {"linewidths": 0.9}}
    if filled is None:
        fills: dict[str, Any] = {"colors": ["none", "none", (*to_rgb(hue), FILL)]}
        edges: dict[str, Any] = {"linewidths": [0.8, 0.0]}
        return look | {"levels": CONTENTS[:2], "contourf_kwargs": fills, "contour_kwargs": edges}
    # Shades are mixed with white, not made transparent: panels stay small in a vector file.
    shades = [tuple(1.0 - s * (1.0 - np.array(to_rgb(hue)))) for s in SHADES]
    fills = {"colors": ["none", *shades], "antialiased": True}
    edges = {"colors": shades, "linewidths": 0.3}
    return look | {"levels": CONTENTS, "contourf_kwargs": fills, "contour_kwargs": edges}
