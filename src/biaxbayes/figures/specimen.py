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

from biaxbayes.evenly import evenly_chosen
from biaxbayes.figures.bands import curve_names, load_panels
from biaxbayes.figures.quantities import plain
from biaxbayes.figures.style import (
    AXIS_MARKERS,
    COLUMN_MM,
    PAGE_MM,
    blank_figure,
    colour,
    limit_ticks,
    print_style,
)
from biaxbayes.fitting.fit_result import FitResult
from biaxbayes.options import FIT_METHODS
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

POINTS, REST_POINTS = 300, 50
"""Rows of a curve, and rows at rest, that are drawn."""
FIXED = 0.05
"""Extent of a stretch over that of the other direction, up to which it is fixed."""
PANEL_MM = (56.0, 48.0)
MAX_PANELS = 24


@print_style()
def specimen_figure(specimen: Specimen) -> Figure:
    """Draw the first 24 protocols, at most 300 rows each; the rows at rest in black."""
    protocols, panels = specimen.protocols[:MAX_PANELS], load_panels(specimen)
    columns = 2 if len(protocols) == 4 else min(3, len(protocols))
    rows = math.ceil(len(protocols) / columns) * len(panels)
    figure = blank_figure(max(columns * PANEL_MM[0], COLUMN_MM), rows * PANEL_MM[1] + 14.0)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for ax in grid[-len(panels) :, (len(protocols) - 1) % columns + 1 :].flat:
        ax.remove()
    for k, protocol in enumerate(protocols):
        down, across = len(panels) * (k // columns), k % columns
        for i, (label, directions) in enumerate(panels):
            ax = grid[down + i, across]
            if k:
                ax.sharey(grid[i, 0])
            _draw_protocol(ax, protocol, specimen, directions)
            ax.tick_params(labelbottom=True, labelleft=across == 0)
            if across == 0:
                ax.set_ylabel(label)
        if len(specimen.protocols) > 1:
            grid[down, across].set_title(plain(protocol.name, 34))
    figure.supxlabel("measured stretch")
    names, handles = curve_names(specimen, 24), []
    for k in specimen.experiment.axes:
        look: dict[str, Any] = {"color": colour("xy"[k]), "marker": AXIS_MARKERS["xy"[k]]}
        handles.append(Line2D([], [], ms=2.0, lw=0.5, label=names[k], **look))
    if specimen.experiment.is_mounted:
        look = {"color": "black", "marker": "+", "linestyle": ""}
        handles.append(Line2D([], [], ms=6.0, label="rows at rest", **look))
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _over(protocol: Protocol, axis: int) -> np.ndarray:
    """The stretch that a load is drawn over: its own, or the other one where that is fixed."""
    extent = np.ptp(protocol.known_stretch, axis=0)
    return protocol.stretch[:, axis if extent[axis] > FIXED * extent[1 - axis] else 1 - axis]


def _draw_protocol(
    ax: Axes, protocol: Protocol, specimen: Specimen, directions: Sequence[int]
) -> None:
    shown = evenly_chosen(protocol.rows, POINTS)
    rest = slice(0, protocol.rest_rows, max(1, protocol.rest_rows // REST_POINTS))
    for k in directions:
        stretch, load, hue = _over(protocol, k), protocol.recorded_load[:, k], colour("xy"[k])
        look: dict[str, Any] = {"marker": AXIS_MARKERS["xy"[k]], "color": hue}
        ax.plot(stretch[shown], load[shown], ms=2.0, mew=0.0, lw=0.5, **look)
        ax.plot(stretch[rest], load[rest], "+", ms=6.0, mew=0.8, color="black", zorder=2.1)
    ax.axhline(0.0, color="0.75", linewidth=0.5, zorder=0)
    ax.margins(x=0.04, y=0.06)
    ax.locator_params(axis="x", nbins=5)


# --- deterministic fits --------------------------------------------------------------------------

MAX_DRAWN_PROTOCOLS, DATA_POINTS = 6, 40
AXIS_DASHES = {"x": "-", "y": "--"}
HEIGHTS = (3.0, 1.4)
# Fits often coincide: the first are wide, and the last lie narrow on top of them.
WIDTHS = np.linspace(2.6, 0.5, len(FIT_METHODS))
LOOKS: dict[str, dict[str, Any]] = {
    method: {"color": f"C{k}", "linewidth": WIDTHS[k]} for k, method in enumerate(FIT_METHODS)
}
DATA: dict[str, Any] = {"color": "0.3", "mfc": "none", "mew": 0.5, "ms": 2.5}


@print_style()
def fits_figure(specimen: Specimen, fits: Sequence[FitResult]) -> Figure:
    """Draw measured and fitted loads, and residuals, of the first six protocols of all pieces."""
    tested = [(piece, p) for piece in specimen.pieces for p in piece.protocols]
    count = min(len(tested), MAX_DRAWN_PROTOCOLS)
    columns = min(3, count)
    blocks = -(-count // columns)
    units = max(len(load_panels(piece)) for piece, _ in tested[:count])
    width = COLUMN_MM if columns == 1 else PAGE_MM
    figure = blank_figure(width, 78.0 * blocks * units + 18.0)
    heights = HEIGHTS * (blocks * units)
    look: dict[str, Any] = {"squeeze": False, "height_ratios": heights, "sharex": "col"}
    grid = figure.subplots(len(heights), columns, **look)
    drawn = []
    for k, (piece, protocol) in enumerate(tested[:count]):
        column = grid[2 * units * (k // columns) :, k % columns]
        for i, (label, directions) in enumerate(load_panels(piece)):
            upper, lower = column[2 * i : 2 * i + 2]
            _draw_fits(upper, lower, piece, protocol, directions, fits, k)
            if k % columns == 0 or piece.test != specimen.test:
                upper.set_ylabel(label)
                lower.set_ylabel(f"data − fit ({piece.units[directions[0]]})")
            drawn += [upper, lower]
        if len(tested) > 1:
            own = "" if piece.name == specimen.name else f"{piece.name}: "
            column[0].set_title(plain(own + protocol.name, 30))
    for ax in set(grid.flat) - set(drawn):
        ax.remove()
    handles = []
    for k in sorted({k for piece in specimen.pieces for k in piece.experiment.axes}):
        look = {"marker": AXIS_MARKERS["xy"[k]], "linestyle": AXIS_DASHES["xy"[k]], **DATA}
        handles.append(Line2D([], [], label=curve_names(specimen, 20)[k], **look))
    handles += [Line2D([], [], label=fit.method, **LOOKS[fit.method]) for fit in fits]
    ncols = 3 if columns == 1 else len(handles)
    figure.legend(handles=handles, loc="outside upper center", ncols=ncols)
    left = len(tested) - count
    more = f" ({left} more protocols not drawn)" if left else ""
    figure.supxlabel("measured stretch" + more)
    return figure


def _draw_fits(
    upper: Axes,
    lower: Axes,
    piece: Specimen,
    protocol: Protocol,
    directions: Sequence[int],
    fits: Sequence[FitResult],
    k: int,
) -> None:
    """Loads of protocol k with the fitted ones, and measured minus fitted loads."""
    load, moving = piece.load(protocol), slice(protocol.rest_rows, None)
    points = evenly_chosen(protocol.rows, DATA_POINTS)
    for axis in directions:
        name, stretch = "xy"[axis], _over(protocol, axis)
        upper.plot(stretch[points], load[points, axis], AXIS_MARKERS[name], **DATA)
        for fit in fits:
            residual = fit.residuals[k][:, axis] * piece.load_scale[axis]
            look = {"linestyle": AXIS_DASHES[name], **LOOKS[fit.method]}
            upper.plot(stretch[moving], load[moving, axis] - residual, **look)
            lower.plot(stretch[moving], residual, **look)
    lower.axhline(0.0, color="0.6", linewidth=0.5, zorder=0)
    lower.tick_params(labelbottom=True)
    limit_ticks(lower.xaxis, 5)
