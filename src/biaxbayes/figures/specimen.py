"""A specimen as recorded: load against stretch in both directions, one panel per protocol."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.figures.quantities import plain
from biaxbayes.figures.style import COLUMN_MM, LOADS, MARKERS, blank_figure, colour, print_style
from biaxbayes.prediction.bands import evenly_chosen
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
        figure.supylabel(LOADS[specimen.stress_pair])
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
        how: dict[str, Any] = {
            "marker": MARKERS[axis],
            "ms": 2.0,
            "mew": 0.0,
            "lw": 0.5,
            "color": colour(axis),
        }
        ax.plot(stretch[shown], load[shown], label=axis, **how)
    for axis in "xy":
        stretch, load = getattr(protocol, f"stretch_{axis}"), getattr(protocol, f"load_{axis}")
        label = "rows at rest" if axis == "y" else None
        ax.plot(stretch[rest], load[rest], "+", color="black", ms=6.0, mew=0.8, label=label)
    ax.axhline(0.0, color="0.75", linewidth=0.5, zorder=0)
    ax.margins(x=0.04, y=0.06)
    ax.locator_params(axis="x", nbins=5)
