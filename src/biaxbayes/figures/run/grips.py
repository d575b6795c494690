"""Effect of hooks on the loads of a specimen: a sketch to scale, and the ratio of forces."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from biaxbayes.fem.sheet_tester import GAUGE
from biaxbayes.figures.quantities import plain
from biaxbayes.figures.style import (
    COLUMN_MM,
    CREDIBLE,
    PAGE_MM,
    blank_figure,
    colour,
    few_ticks,
    print_style,
)
from biaxbayes.grips.geometry import edges_mm, stated_hooks
from biaxbayes.specimens.specimen import Specimen

MAX_PROTOCOLS = 6
HEIGHT_MM = 55.0
TWO_SD = 2.0


def grips_figure(specimen: Specimen, ratios: pd.DataFrame) -> Figure:
    """Sketch the sheet and its hooks; draw the hook load over the uniform one, with two sd."""
    names = ratios["protocol"].drop_duplicates().to_list()[:MAX_PROTOCOLS]
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    with print_style():
        figure = blank_figure(PAGE_MM, HEIGHT_MM * rows)
        widths = (1.0, 0.75 + columns)
        ((left, right),) = figure.subfigures(1, 2, squeeze=False, width_ratios=widths)
        _draw_sketch(left.subplots(), specimen)
        axes = right.subplots(rows, columns, squeeze=False, sharey=True)
        for ax in axes.flat[len(names) :]:
            ax.set_visible(False)
        for ax, name in zip(axes.flat, names, strict=False):
            _draw_ratios(ax, ratios[ratios["protocol"] == name])
            if len(names) > 1:
                ax.set_title(plain(str(name), 30))
        axes[0, 0].set_ylabel("force on hooks /\nforce of a uniform test")
        axes[0, 0].legend()
    return figure


def sketch_figure(specimen: Specimen) -> Figure:
    """Sketch of the unloaded sheet, its hooks and the markers, to scale."""
    a, b = edges_mm(specimen)
    with print_style():
        figure = blank_figure(COLUMN_MM, COLUMN_MM * max(b / a, 0.5))
        ax = figure.subplots()
        _draw_sketch(ax, specimen)
        ax.set_anchor("N")
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _draw_sketch(ax: Axes, specimen: Specimen) -> None:
    """The whole sheet in mm: patches that the hooks of x and y move, and the markers."""
    hooks, (a, b) = stated_hooks(specimen), edges_mm(specimen)
    ax.add_patch(Rectangle((-a / 2.0, -b / 2.0), a, b, fill=False, color="0.3"))
    for axis, (across, along) in zip("xy", ((a, b), (b, a)), strict=True):
        offsets = (np.arange(hooks.count) - 0.5 * (hooks.count - 1.0)) * hooks.spacing(along)
        for side in (-1.0, 1.0):
            for offset in offsets:
                place = (side * (across / 2.0 - hooks.inset_mm), float(offset))
                centre = place if axis == "x" else place[::-1]
                label = f"hooks in {axis}" if side > 0.0 and offset == offsets[0] else None
                patch = Circle(centre, hooks.radius_mm, color=colour(axis), alpha=0.6, lw=0)
                patch.set_label(label)
                ax.add_patch(patch)
    if specimen.metadata.get("stretch_from", "markers") == "markers":
        x, y = 0.5 * GAUGE * a, 0.5 * GAUGE * b
        ax.plot([x, x, -x, -x], [y, -y, y, -y], "s", color="0.3", ms=2.0, label="markers")
    ax.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
    ax.autoscale_view()


def _draw_ratios(ax: Axes, rows: pd.DataFrame) -> None:
    """Ratio of a protocol against the measured stretch of its direction."""
    for axis, line in (("x", "-"), ("y", "--")):
        stretch, ratio = rows[f"stretch_{axis}"], rows[f"force_ratio_{axis}"]
        error = TWO_SD * ratio * rows[f"sd_log_force_ratio_{axis}"]
        ax.plot(stretch, ratio, line, color=colour(axis), label=axis)
        ax.fill_between(
            stretch, ratio - error, ratio + error, color=colour(axis), alpha=CREDIBLE, lw=0
        )
    ax.set_xlabel("stretch")
    few_ticks(ax.xaxis, 4)
