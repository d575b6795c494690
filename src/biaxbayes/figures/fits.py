"""Deterministic fits over the data of a specimen, and the residuals of each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from biaxbayes.figures.quantities import plain
from biaxbayes.figures.style import (
    COLUMN_MM,
    LOADS,
    MARKERS,
    PAGE_MM,
    blank_figure,
    few_ticks,
    print_style,
)
from biaxbayes.fitting.result import FitResult
from biaxbayes.options import FIT_METHODS
from biaxbayes.prediction.bands import evenly_chosen
from biaxbayes.specimens.specimen import Specimen

MAX_PROTOCOLS, DATA_POINTS = 6, 40
LINES = {"x": "-", "y": "--"}
HEIGHTS = (3.0, 1.4)
# Fits often coincide: the first are wide, and the last lie narrow on top of them.
LOOKS: dict[str, dict[str, Any]] = {
    method: {"color": f"C{k}", "linewidth": width}
    for k, (method, width) in enumerate(
        zip(FIT_METHODS, np.linspace(2.6, 0.5, len(FIT_METHODS)), strict=True)
    )
}
DATA: dict[str, Any] = {"color": "0.3", "mfc": "none", "mew": 0.5, "ms": 2.5}


def fits_figure(specimen: Specimen, fits: Sequence[FitResult]) -> Figure:
    """Draw measured and fitted loads, and residuals, of the first six protocols."""
    count = min(len(specimen.protocols), MAX_PROTOCOLS)
    columns = min(3, count)
    blocks = -(-count // columns)
    with print_style():
        width = COLUMN_MM if columns == 1 else PAGE_MM
        figure = blank_figure(width, 78.0 * blocks + 18.0)
        grid = figure.subplots(
            2 * blocks, columns, squeeze=False, height_ratios=HEIGHTS * blocks, sharex="col"
        )
        for k in range(count):
            upper, lower = grid[2 * (k // columns) : 2 * (k // columns) + 2, k % columns]
            _draw_fits(upper, lower, specimen, k, fits)
            if len(specimen.protocols) > 1:
                upper.set_title(plain(specimen.protocols[k].name, 30))
            if k % columns == 0:
                upper.set_ylabel(LOADS[specimen.stress_pair])
                lower.set_ylabel(f"data − fit ({specimen.unit})")
        for ax in grid[-2:, (count - 1) % columns + 1 :].flat:
            ax.remove()
        handles = []
        for name, direction in (("x", specimen.axis_x), ("y", specimen.axis_y)):
            label = f"{name}: {plain(direction or 'data and fit', 20)}"
            look = {"marker": MARKERS[name], "linestyle": LINES[name], **DATA}
            handles.append(Line2D([], [], label=label, **look))
        handles += [Line2D([], [], label=fit.method, **LOOKS[fit.method]) for fit in fits]
        ncols = 3 if columns == 1 else len(handles)
        figure.legend(handles=handles, loc="outside upper center", ncols=ncols)
        left = len(specimen.protocols) - count
        more = f" ({left} more protocols not drawn)" if left else ""
        figure.supxlabel("measured stretch" + more)
    return figure


def _draw_fits(
    upper: Axes, lower: Axes, specimen: Specimen, k: int, fits: Sequence[FitResult]
) -> None:
    """Loads of a protocol with the fitted ones, and measured minus fitted loads."""
    protocol = specimen.protocols[k]
    load, moving = specimen.load(protocol), slice(protocol.rest_rows, None)
    points = evenly_chosen(protocol.rows, DATA_POINTS)
    for axis, name in enumerate("xy"):
        stretch = protocol.stretch_x if axis == 0 else protocol.stretch_y
        if np.ptp(stretch) == 0.0:  # a fixed direction is drawn over the stretch in x
            stretch = protocol.stretch_x
        upper.plot(stretch[points], load[points, axis], MARKERS[name], **DATA)
        for fit in fits:
            residual = fit.residuals[k][:, axis]
            look = {"linestyle": LINES[name], **LOOKS[fit.method]}
            upper.plot(stretch[moving], load[moving, axis] - residual, **look)
            lower.plot(stretch[moving], residual, **look)
    lower.axhline(0.0, color="0.6", linewidth=0.5, zorder=0)
    lower.tick_params(labelbottom=True)
    few_ticks(lower.xaxis, 5)
