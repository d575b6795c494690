"""Bands and medians of predictions, as in the figures of stress and inflation."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.figures.style import CREDIBLE, PREDICTIVE
from biaxbayes.prediction.stress import INSIDE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DASHES = (0, (3, 2))
GREY = "0.3"


def draw_bands(ax: Axes, abscissa: np.ndarray, table: pd.DataFrame, stem: str, tint: str) -> None:
    """Credible and predictive band of a column of the table."""
    for kind, opacity in (("predictive", PREDICTIVE), ("credible", CREDIBLE)):
        low, high = (table[f"{stem}_{kind}_{end}"] for end in ("low", "high"))
        ax.fill_between(abscissa, low, high, color=tint, alpha=opacity, linewidth=0.0)


def draw_median(ax: Axes, x: Any, y: Any, table: pd.DataFrame, tint: str) -> None:
    """A line, solid where the states were tested and dashed elsewhere."""
    x, y = np.asarray(x), np.asarray(y)
    for tested, rows in _segments(table["extrapolation"].to_numpy() == INSIDE):
        ax.plot(x[rows], y[rows], color=tint, linestyle="-" if tested else DASHES)


def _segments(tested: np.ndarray) -> Iterator[tuple[bool, slice]]:
    """Tested and untested segments; each ends where the next begins, so that the line is whole."""
    edges = [0, *(np.flatnonzero(np.diff(tested.astype(int))) + 1), tested.size]
    for first, last in pairwise(edges):
        yield bool(tested[first]), slice(first, min(last + 1, tested.size))


def add_legend(ax: Axes, table: pd.DataFrame, probability: float, *, bands: bool) -> None:
    """Legend of an axes, with entries of the bands and of states that were not tested."""
    if bands:
        for name, opacity in (("credible", CREDIBLE), ("predictive", PREDICTIVE)):
            ax.fill_between(
                [],
                [],
                [],
                color=GREY,
                alpha=opacity,
                linewidth=0.0,
                label=f"{name}, {100 * probability:g} %",
            )
    if bands and (table["extrapolation"] != INSIDE).any():
        ax.plot([], [], color=GREY, linestyle=DASHES, label="not tested")
    ax.legend(loc="upper left", borderaxespad=0.2)
