"""A specimen as recorded and its deterministic fits: a panel or two a protocol.

Load against stretch in both directions; below the fits what each misses of the data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.figures.style import COLUMN_MM, PAGE_MM, blank_figure, colour, plain, print_style
from biaxbayes.options import FIT_METHODS
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from biaxbayes.fitting.result import FitResult
    from biaxbayes.specimens.protocol import Protocol

MARKERS = {"x": "o", "y": "s"}
POINTS = 300
PANEL_MM = (56.0, 48.0)
MAX_PANELS = 24
LOADS = {
    "force": "force (N)",
    "piola": "first Piola-Kirchhoff stress (kPa)",
    "cauchy": "Cauchy stress (kPa)",
}


def specimen_figure(specimen: Specimen) -> Figure:
    """Draw a specimen.

    Parameters
    ----------
    specimen : Specimen

    Returns
    -------
    matplotlib.figure.Figure
        One panel a protocol (the first 24), the same axes in all. Every row up to 300 a
        curve, evenly chosen beyond; the rows at rest are drawn in black.
    """
    protocols = specimen.protocols[:MAX_PANELS]
    columns = min(3, len(protocols)) if len(protocols) != 4 else 2
    rows = math.ceil(len(protocols) / columns)
    width, height = max(columns * PANEL_MM[0], 85.0), rows * PANEL_MM[1] + 14.0
    with print_style():
        figure = blank_figure(width, height)
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for ax, protocol in zip(grid.flat, protocols, strict=False):
            _panel(ax, protocol)
            if len(specimen.protocols) > 1:
                ax.set_title(plain(protocol.name, 34))
        for ax in grid.flat[len(protocols) :]:
            ax.remove()
        for column in range(columns):
            # The lowest panel of each column carries the ticks of the shared axis.
            lowest = grid[(len(protocols) - 1 - column) // columns, column]
            lowest.tick_params(labelbottom=True)
        figure.supxlabel("measured stretch")
        figure.supylabel(LOADS[specimen.stress_pair])
        names = [specimen.axis_x, specimen.axis_y]
        handles, labels = grid[0, 0].get_legend_handles_labels()
        labels = [
            f"{label}: {plain(name, 24)}" if name else label
            for label, name in zip(labels, [*names, None], strict=False)
        ]
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def _panel(ax: Axes, protocol: Protocol) -> None:
    index = np.unique(np.linspace(0, protocol.rows - 1, POINTS).round().astype(int))
    if protocol.rows <= POINTS:
        index = np.arange(protocol.rows)
    rest = slice(0, protocol.rest_rows, max(1, protocol.rest_rows // 50))
    for axis in "xy":
        stretch, load = getattr(protocol, f"stretch_{axis}"), getattr(protocol, f"load_{axis}")
        ax.plot(
            stretch[index],
            load[index],
            marker=MARKERS[axis],
            markersize=2.0,
            markeredgewidth=0.0,
            linewidth=0.5,
            color=colour(axis),
            label=axis,
        )
        ax.plot(
            stretch[rest],
            load[rest],
            linestyle="none",
            marker="+",
            markersize=6.0,
            markeredgewidth=0.8,
            color="black",
            zorder=3,
            label="rows at rest" if axis == "y" else None,
        )
    ax.axhline(0.0, color="0.75", linewidth=0.5, zorder=0)
    ax.margins(x=0.04, y=0.06)
    ax.locator_params(axis="x", nbins=5)


# --- fits over the data they were made of, and what each misses ----------------------------------


MOST = 6
"""Protocols that are drawn; what is left out is said."""
DATA_POINTS = 40
DASHES = {"x": "-", "y": "--"}
HEIGHTS = (3.0, 1.4)


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
        A column of two panels a protocol, the first six.
    """
    from matplotlib.lines import Line2D

    shown = specimen.protocols[:MOST]
    columns = min(3, len(shown))
    blocks = -(-len(shown) // columns)
    width = COLUMN_MM if columns == 1 else PAGE_MM
    with print_style():
        figure = blank_figure(width, 78.0 * blocks + 18.0)
        grid = figure.subplots(
            2 * blocks, columns, squeeze=False, height_ratios=HEIGHTS * blocks, sharex="col"
        )
        colours = {method: f"C{k}" for k, method in enumerate(FIT_METHODS)}
        # Fits often coincide: the first are wide, and the last lie narrow on top of them.
        widths = dict(zip(colours, np.linspace(2.6, 0.5, len(colours)), strict=True))
        for k, protocol in enumerate(shown):
            upper, lower = (grid[2 * (k // columns) + i, k % columns] for i in range(2))
            load, moving = specimen.load(protocol), slice(protocol.rest_rows, None)
            every = np.unique(np.linspace(0, protocol.rows - 1, DATA_POINTS).round().astype(int))
            for axis, name in enumerate("xy"):
                stretch = getattr(protocol, f"stretch_{name}")
                path = stretch if np.ptp(stretch) > 0.0 else protocol.stretch_x
                upper.plot(
                    path[every],
                    load[every, axis],
                    MARKERS[name],
                    markersize=2.5,
                    markerfacecolor="none",
                    markeredgewidth=0.5,
                    color="0.3",
                )
                for fit in fits:
                    missed = fit.residuals[k][:, axis]
                    how = {"linestyle": DASHES[name], "color": colours[fit.method]}
                    how["linewidth"] = widths[fit.method]
                    upper.plot(path[moving], load[moving, axis] - missed, **how)
                    lower.plot(path[moving], missed, **how)
            lower.axhline(0.0, color="0.6", linewidth=0.5, zorder=0)
            if len(specimen.protocols) > 1:
                upper.set_title(plain(protocol.name, 30))
            if k % columns == 0:
                upper.set_ylabel(LOADS[specimen.stress_pair])
                lower.set_ylabel(f"data − fit ({specimen.unit})")
            lower.tick_params(labelbottom=True)
            lower.locator_params(axis="x", nbins=5)
        for ax in grid[-2:, (len(shown) - 1) % columns + 1 :].flat:
            ax.remove()
        left = len(specimen.protocols) - len(shown)
        figure.supxlabel(
            "measured stretch" + (f" ({left} more protocols not drawn)" if left else "")
        )
        handles = [
            Line2D(
                [], [], color="0.3", marker=MARKERS[n], markerfacecolor="none", ls=DASHES[n], ms=3
            )
            for n in "xy"
        ]
        names = [
            f"{n}: {plain(getattr(specimen, f'axis_{n}') or 'data and fit', 20)}" for n in "xy"
        ]
        handles += [Line2D([], [], color=colours[f.method], lw=widths[f.method]) for f in fits]
        names += [f.method for f in fits]
        figure.legend(
            handles, names, loc="outside upper center", ncols=3 if columns == 1 else len(names)
        )
    return figure
