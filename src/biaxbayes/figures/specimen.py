"""A specimen as recorded, one panel per protocol; deterministic fits over it and their residuals.

Loads in x and y are drawn over their stretches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from biaxbayes.figures.quantities import plain
from biaxbayes.figures.style import (
    AXIS_MARKERS,
    COLUMN_MM,
    LOAD_LABELS,
    PAGE_MM,
    blank_figure,
    colour,
    limit_ticks,
    print_style,
)
from biaxbayes.fitting.result import FitResult
from biaxbayes.options import FIT_METHODS
from biaxbayes.prediction.percentiles import evenly_chosen
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

POINTS, REST_POINTS = 300, 50
"""Rows of a curve, and rows at rest, that are drawn."""
PANEL_MM = (56.0, 48.0)
MAX_PANELS = 24


def specimen_figure(specimen: Specimen) -> Figure:
    """Draw the first 24 protocols, at most 300 rows each; the rows at rest in black."""
    protocols = specimen.protocols[:MAX_PANELS]
    columns = 2 if len(protocols) == 4 else min(3, len(protocols))
    rows = math.ceil(len(protocols) / columns)
    with print_style():
        figure = blank_figure(max(columns * PANEL_MM[0], COLUMN_MM), rows * PANEL_MM[1] + 14.0)
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for ax in grid.flat[len(protocols) :]:
            ax.remove()
        for ax, protocol in zip(grid.flat, protocols, strict=False):
            _draw_protocol(ax, protocol)
            ax.tick_params(labelbottom=True)
            if len(specimen.protocols) > 1:
                ax.set_title(plain(protocol.name, 34))
        figure.supxlabel("measured stretch")
        figure.supylabel(LOAD_LABELS[specimen.stress_pair])
        handles, labels = grid[0, 0].get_legend_handles_labels()
        for k, name in enumerate((specimen.axis_x, specimen.axis_y)):
            labels[k] += f": {plain(name, 24)}" if name else ""
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def _draw_protocol(ax: Axes, protocol: Protocol) -> None:
    shown = evenly_chosen(protocol.rows, POINTS)
    rest = slice(0, protocol.rest_rows, max(1, protocol.rest_rows // REST_POINTS))
    for axis in "xy":
        stretch, load = getattr(protocol, f"stretch_{axis}"), getattr(protocol, f"load_{axis}")
        how: dict[str, Any] = {"marker": AXIS_MARKERS[axis], "color": colour(axis), "label": axis}
        ax.plot(stretch[shown], load[shown], ms=2.0, mew=0.0, lw=0.5, **how)
        label = "rows at rest" if axis == "y" else None
        black: dict[str, Any] = {"color": "black", "label": label, "zorder": 2.1}
        ax.plot(stretch[rest], load[rest], "+", ms=6.0, mew=0.8, **black)
    ax.axhline(0.0, color="0.75", linewidth=0.5, zorder=0)
    ax.margins(x=0.04, y=0.06)
    ax.locator_params(axis="x", nbins=5)


# --- deterministic fits --------------------------------------------------------------------------

MAX_DRAWN_PROTOCOLS, DATA_POINTS = 6, 40
AXIS_DASHES = {"x": "-", "y": "--"}
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
    count = min(len(specimen.protocols), MAX_DRAWN_PROTOCOLS)
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
                upper.set_ylabel(LOAD_LABELS[specimen.stress_pair])
                lower.set_ylabel(f"data − fit ({specimen.unit})")
        for ax in grid[-2:, (count - 1) % columns + 1 :].flat:
            ax.remove()
        handles = []
        for name, direction in (("x", specimen.axis_x), ("y", specimen.axis_y)):
            label = f"{name}: {plain(direction or 'data and fit', 20)}"
            look = {"marker": AXIS_MARKERS[name], "linestyle": AXIS_DASHES[name], **DATA}
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
        upper.plot(stretch[points], load[points, axis], AXIS_MARKERS[name], **DATA)
        for fit in fits:
            residual = fit.residuals[k][:, axis] * specimen.load_scale[axis]
            look = {"linestyle": AXIS_DASHES[name], **LOOKS[fit.method]}
            upper.plot(stretch[moving], load[moving, axis] - residual, **look)
            lower.plot(stretch[moving], residual, **look)
    lower.axhline(0.0, color="0.6", linewidth=0.5, zorder=0)
    lower.tick_params(labelbottom=True)
    limit_ticks(lower.xaxis, 5)
