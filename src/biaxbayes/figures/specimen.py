"""A specimen as recorded: load against stretch in both directions, one panel per protocol."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.figures.style import COLUMN_MM, blank_figure, colour, plain, print_style
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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

    One panel per protocol (the first 24), with common axes. Of longer curves 300 rows are drawn,
    evenly chosen; the rows at rest are drawn in black.
    """
    protocols = specimen.protocols[:MAX_PANELS]
    count = len(protocols)
    columns = 2 if count == 4 else min(3, count)
    rows = math.ceil(count / columns)
    with print_style():
        figure = blank_figure(max(columns * PANEL_MM[0], COLUMN_MM), rows * PANEL_MM[1] + 14.0)
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for ax, protocol in zip(grid.flat, protocols, strict=False):
            _draw_protocol(ax, protocol)
            if len(specimen.protocols) > 1:
                ax.set_title(plain(protocol.name, 34))
        for ax in grid.flat[count:]:
            ax.remove()
        for ax in grid.flat[max(count - columns, 0) : count]:
            # The lowest panel of each column carries the ticks of the shared axis.
            ax.tick_params(labelbottom=True)
        figure.supxlabel("measured stretch")
        figure.supylabel(LOADS[specimen.stress_pair])
        handles, labels = grid[0, 0].get_legend_handles_labels()
        for k, name in enumerate((specimen.axis_x, specimen.axis_y)):
            labels[k] += f": {plain(name, 24)}" if name else ""
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def _draw_protocol(ax: Axes, protocol: Protocol) -> None:
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
