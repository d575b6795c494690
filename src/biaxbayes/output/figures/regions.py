"""A joint posterior as regions of stated content."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.findings.bounded_density import levels

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["CONTENTS", "regions"]

CONTENTS = (0.5, 0.9, 0.99)
"""Shares of the draws that the regions hold."""
SHADES = (0.18, 0.42, 0.78)
"""Their darkness, the widest first."""


def regions(
    ax: Axes, x: np.ndarray, y: np.ndarray, density: np.ndarray, colour: str, *, filled: bool
) -> None:
    """Draw a joint density from :func:`biaxbayes.findings.bounded_density.surface`.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x, y, density : ndarray
    colour : str
    filled : bool
        Three shaded regions, or the outline of the one that holds 90 %.
    """
    from matplotlib.colors import to_rgb

    if not filled:
        ax.contour(x, y, density, levels=levels(density, (0.9,)), colors=[colour], linewidths=0.9)
        return
    # Shades are mixed with white, not made transparent: panels stay small in a vector file.
    hue = np.array(to_rgb(colour))
    shades = [tuple(1.0 - share * (1.0 - hue)) for share in SHADES]
    heights = [*levels(density, CONTENTS), np.inf]
    ax.contourf(x, y, density, levels=heights, colors=shades)
