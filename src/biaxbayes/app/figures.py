"""Figures that a page draws: Bokeh's documents as plain data, which ``app.js`` embeds."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.models import BoxAnnotation, Range1d
from bokeh.plotting import figure

from biaxbayes.evenly import evenly_chosen
from biaxbayes.figures.style import colour, print_style
from biaxbayes.machines.outcome import Conversion
from biaxbayes.machines.record import Record

MAX_POINTS = 4_000
"""Rows of a file that are drawn."""
GREY = "#8a929c"


def empty_panel(**how: Any) -> Any:
    """A figure that shows the page behind it, light or dark."""
    clear = {"background_fill_color": None, "border_fill_color": None, "outline_line_color": None}
    panel = figure(toolbar_location=None, **clear, **how)
    panel.grid.grid_line_color, panel.grid.grid_line_alpha = GREY, 0.3
    return panel


def record_figure(conversion: Conversion, record: Record) -> Any:
    """Stretches and loads of a table over its lines; the ends of what is kept can be dragged."""
    mine = [r for r in conversion.recordings if r.record is record]
    with print_style():
        hues = [colour("x"), colour("y")]
    kept = np.zeros(record.lines.size, dtype=bool)
    for r in mine:
        kept[r.rows] = True
    shown = evenly_chosen(record.lines.size, MAX_POINTS)
    lines, panels = record.lines[shown], []
    span = Range1d(int(record.lines[0]), int(record.lines[-1]))
    units = record.units
    loads = f"load ({units[0]})"
    if units[0] != units[1]:
        loads = ", ".join(f"{record.load_named(k)} ({units[k]})" for k in (0, 1))
    for curves, title, read in (
        (record.stretch, "stretch", record.columns[:2]), (record.load, loads, record.columns[2:])
    ):  # fmt: skip
        marks = "  ".join(mark for mark, name in zip(("● x", "■ y"), read, strict=True) if name)
        panel = empty_panel(height=210, sizing_mode="stretch_width", x_range=span, tools=[],
                            y_axis_label=f"{title}  {marks}", min_border_right=20)  # fmt: skip
        for k in (k for k in (0, 1) if read[k]):
            for of, hue, size in ((~kept[shown], GREY, 2), (kept[shown], hues[k], 4)):
                panel.scatter(lines[of], curves[shown, k][of], color=hue, size=size,
                              marker="square" if k else "circle")  # fmt: skip
        for r in mine:
            # the lines of `rows` are taken of every table
            panel.add_layout(BoxAnnotation(
                left=int(r.lines.min()), right=int(r.lines.max()), name="kept", resizable="x",
                editable=len(conversion.records) == 1, movable="none", fill_alpha=0.15,
                fill_color=hues[0], line_color=hues[0], line_alpha=1.0, line_width=2,
            ))  # fmt: skip
        panels.append(panel)
    panels[-1].xaxis.axis_label = f"line of {record.source}"
    return json_item(column(*panels, sizing_mode="stretch_width"))
