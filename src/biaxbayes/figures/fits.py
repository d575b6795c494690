"""Deterministic fits over the data of a specimen, and the residuals of each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.figures.specimen import LOADS, MARKERS
from biaxbayes.figures.style import (
    COLUMN_MM,
    PAGE_MM,
    blank_figure,
    few_ticks,
    plain,
    print_style,
)
from biaxbayes.options import FIT_METHODS
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from biaxbayes.fitting.result import FitResult

MAX_PROTOCOLS, DATA_POINTS = 6, 40
DASHES = {"x": "-", "y": "--"}
HEIGHTS = (3.0, 1.4)
# Fits often coincide: the first are wide, and the last lie narrow on top of them.
COLOURS = {method: f"C{k}" for k, method in enumerate(FIT_METHODS)}
WIDTHS = dict(zip(FIT_METHODS, np.linspace(2.6, 0.5, len(FIT_METHODS)), strict=True))
DATA: dict[str, Any] = {"color": "0.3", "mfc": "none", "mew": 0.5, "ms": 2.5}


def fits_figure(specimen: Specimen, fits: Sequence[FitResult]) -> Figure:
    """Draw fits over the data: loads above, measured minus fitted below.

    Parameters
    ----------
    specimen : Specimen
    fits : sequence of FitResult
        The fits of ``zeroed`` are drawn with the mounting force put back on.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels per protocol, for the first six.
    """
    shown = specimen.protocols[:MAX_PROTOCOLS]
    columns = min(3, len(shown))
    blocks = -(-len(shown) // columns)
    with print_style():
        width = COLUMN_MM if columns == 1 else PAGE_MM
        figure = blank_figure(width, 78.0 * blocks + 18.0)
        grid = figure.subplots(
            2 * blocks, columns, squeeze=False, height_ratios=HEIGHTS * blocks, sharex="col"
        )
        for k, protocol in enumerate(shown):
            upper, lower = grid[2 * (k // columns) : 2 * (k // columns) + 2, k % columns]
            _draw_fits(upper, lower, specimen, k, fits)
            if len(specimen.protocols) > 1:
                upper.set_title(plain(protocol.name, 30))
            if k % columns == 0:
                upper.set_ylabel(LOADS[specimen.stress_pair])
                lower.set_ylabel(f"data − fit ({specimen.unit})")
        for ax in grid[-2:, (len(shown) - 1) % columns + 1 :].flat:
            ax.remove()
        _legend(figure, specimen, fits, 3 if columns == 1 else 2 + len(fits))
        left = len(specimen.protocols) - len(shown)
        more = f" ({left} more protocols not drawn)" if left else ""
        figure.supxlabel("measured stretch" + more)
    return figure


def _draw_fits(
    upper: Axes, lower: Axes, specimen: Specimen, k: int, fits: Sequence[FitResult]
) -> None:
    """Loads of a protocol with the fitted ones, and measured minus fitted loads."""
    protocol = specimen.protocols[k]
    load, moving = specimen.load(protocol), slice(protocol.rest_rows, None)
    points = np.unique(np.linspace(0, protocol.rows - 1, DATA_POINTS).round().astype(int))
    for axis, name in enumerate("xy"):
        own = protocol.stretch_x if axis == 0 else protocol.stretch_y
        # a fixed direction is drawn over the stretch in x
        stretch = own if np.ptp(own) > 0.0 else protocol.stretch_x
        upper.plot(stretch[points], load[points, axis], MARKERS[name], **DATA)
        for fit in fits:
            residual = fit.residuals[k][:, axis]
            how: dict[str, Any] = {"color": COLOURS[fit.method], "linestyle": DASHES[name]}
            how["linewidth"] = WIDTHS[fit.method]
            upper.plot(stretch[moving], load[moving, axis] - residual, **how)
            lower.plot(stretch[moving], residual, **how)
    lower.axhline(0.0, color="0.6", linewidth=0.5, zorder=0)
    lower.tick_params(labelbottom=True)
    few_ticks(lower.xaxis, 5)


def _legend(figure: Figure, specimen: Specimen, fits: Sequence[FitResult], columns: int) -> None:
    from matplotlib.lines import Line2D

    handles = []
    for name, direction in (("x", specimen.axis_x), ("y", specimen.axis_y)):
        label = f"{name}: {plain(direction or 'data and fit', 20)}"
        handles.append(Line2D([], [], marker=MARKERS[name], ls=DASHES[name], label=label, **DATA))
    for fit in fits:
        colour, width = COLOURS[fit.method], WIDTHS[fit.method]
        handles.append(Line2D([], [], color=colour, linewidth=width, label=fit.method))
    figure.legend(handles=handles, loc="outside upper center", ncols=columns)
