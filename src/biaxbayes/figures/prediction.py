"""Predictions with both bands: stress along a path, and pressure over diameter of a tube."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.spatial.distance import cdist

from biaxbayes.experiments.tube import MMHG_PER_KPA
from biaxbayes.figures import style
from biaxbayes.figures.panels import band_handles, draw_bands
from biaxbayes.figures.quantities import plain
from biaxbayes.options import CONTENT
from biaxbayes.prediction.stress import INSIDE

STRESS_NAMES = {"cauchy": "Cauchy stress", "piola": "first Piola-Kirchhoff stress"}
CURVE_MM, BAND_STRIP_MM = 56.0, 16.0
"""Heights of the curves and of the bands less their median."""
GREY = "0.3"
READINGS: dict[str, Any] = {"markersize": 1.3, "markeredgewidth": 0.0, "linestyle": "none"}


@style.print_style()
def stress_figure(
    table: pd.DataFrame,
    *,
    relative_to: str,
    probability: float,
    directions: tuple[str, str],
    measured: pd.DataFrame,
    width_mm: float,
) -> Figure:
    """Draw stress against stretch with both bands, and below the bands less their median."""
    stress = "cauchy" if any(str(c).startswith("cauchy") for c in table) else "piola"
    axes = [axis for axis in "xy" if f"{stress}_{axis}_kPa_median" in table]  # of a strip one
    along, label, name = _abscissa(table, relative_to)
    if len(measured):  # the state of the path that is nearest to each reading
        stretches = ["stretch_x", "stretch_y"]
        nearest = cdist(measured[stretches], table[stretches]).argmin(axis=1)
    wide = width_mm >= style.SIDE_BY_SIDE_MM and len(axes) == 2
    heights = [CURVE_MM, *[BAND_STRIP_MM] * (1 if wide else len(axes))]
    figure = style.blank_figure(width_mm, sum(heights) + 16.0)
    grid = figure.add_gridspec(len(heights), 2 if wide else 1, height_ratios=heights)
    first = figure.add_subplot(grid[0, 0])
    second = figure.add_subplot(grid[0, 1], sharex=first, sharey=first) if wide else first
    cells = [grid[1, k] if wide else grid[1 + k, 0] for k in range(len(axes))]
    strips = [figure.add_subplot(cell, sharex=first) for cell in cells]
    for k, (axis, ax, strip) in enumerate(zip(axes, (first, second), strips, strict=False)):
        stem, tint = f"{stress}_{axis}_kPa", style.colour(axis)
        name_of = directions["xy".index(axis)]
        direction = "" if name_of == axis else f": {plain(name_of, 24)}"
        draw_bands(ax, along, table, f"{stem}_", tint)
        _draw_line(ax, along, table[f"{stem}_median"], table, tint, f"{axis}{direction}")
        draw_bands(strip, along, _less_median(table, stem), f"{stem}_", tint)
        strip.axhline(0.0, color="0.4", linewidth=0.5, zorder=0.5)
        if len(measured):
            at, marker = measured[name] if name else 1.0 + nearest, style.AXIS_MARKERS[axis]
            ax.plot(at, measured[stem], marker, color=tint, **READINGS)
            strip.plot(at, measured[f"{stem}_residual"], marker, color=tint, **READINGS)
        if k == 0 or not wide:
            strip.set_ylabel("less median\n(kPa)", linespacing=1.1, **style.small_text())
        style.limit_ticks(strip.yaxis, 3)
        ax.margins(x=0.0)
        ax.tick_params(labelbottom=False, labelleft=k == 0 or not wide)
        lowest = wide or k == len(axes) - 1
        strip.tick_params(labelbottom=lowest)
        if lowest:
            strip.set_xlabel(label)
    first.set_ylabel(f"{STRESS_NAMES[stress]} (kPa)")
    figure.align_ylabels()
    if len(measured):
        first.plot([], [], marker="o", color=GREY, label="measured", **READINGS)
    _add_legend(first, table, probability)
    if wide:
        second.legend(loc="upper left", borderaxespad=0.2)
    return figure


def _abscissa(table: pd.DataFrame, relative_to: str) -> tuple[np.ndarray, str, str]:
    """The stretch that varies most along the path, if it orders the rows; else their number."""
    x, y = table["stretch_x"].to_numpy(), table["stretch_y"].to_numpy()
    axis, leading = ("x", x) if np.ptp(x) >= np.ptp(y) else ("y", y)
    steps = np.diff(leading)
    if len(leading) > 1 and not ((steps > 0).all() or (steps < 0).all()):
        return np.arange(1, len(leading) + 1, dtype=float), "state (row of the path)", ""
    direction = "" if np.allclose(x, y) else f" in {axis}"
    kind = "measured" if relative_to == "mounted" else "total"
    return leading, f"{kind} stretch{direction}", f"stretch_{axis}"


@style.print_style()
def inflation_figure(
    table: pd.DataFrame, *, probability: float = CONTENT, width_mm: float = style.COLUMN_MM
) -> Figure:
    """Draw pressure against outer diameter with both bands, and the bands less their median."""
    upright = "pressure_kPa_median" in table
    stem, other = ("pressure_kPa", "outer_diameter_mm")[:: 1 if upright else -1]
    along, median = table[other].to_numpy(), table[f"{stem}_median"]
    tint = style.colour(0)
    figure = style.blank_figure(width_mm, 0.85 * width_mm)
    if upright:
        ax, strip = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
        _draw_line(ax, along, median, table, tint, "median")
        strip.set(xlabel="outer diameter (mm)", ylabel="less median\n(kPa)")
        strip.axhline(0.0, color=tint)
    else:
        ax, strip = figure.subplots(1, 2, sharey=True, width_ratios=(3.0, 1.0))
        _draw_line(ax, median, along, table, tint, "median")
        ax.set_xlabel("outer diameter (mm)")
        strip.set_xlabel("less median\n(mm)")
        strip.axvline(0.0, color=tint)
    for panel, shown in ((ax, table), (strip, _less_median(table, stem))):
        draw_bands(panel, along, shown, f"{stem}_", tint, upright=upright)
    strip.locator_params(nbins=3, axis="y" if upright else "x")
    ax.set_ylabel("pressure (kPa)")
    ax.margins(y=0.0)
    mercury = (ax if upright else strip).secondary_yaxis(
        "right", functions=(lambda kPa: kPa * MMHG_PER_KPA, lambda mmHg: mmHg / MMHG_PER_KPA)
    )
    mercury.set_ylabel("pressure (mmHg)")
    mercury.spines["right"].set_visible(True)
    _add_legend(ax, table, probability)
    return figure


# --- bands, lines and legends of both figures ----------------------------------------------------


def _less_median(table: pd.DataFrame, stem: str) -> pd.DataFrame:
    """The table with the median of a quantity subtracted from its bands."""
    names = [f"{stem}_{kind}_{end}" for kind in style.BAND_OPACITY for end in ("low", "high")]
    return table[names].sub(table[f"{stem}_median"], axis=0)


def _draw_line(ax: Axes, x: Any, y: Any, table: pd.DataFrame, tint: str, label: str) -> None:
    """A line, solid where the states were tested and dashed elsewhere."""
    x, y = np.asarray(x), np.asarray(y)
    tested = table["extrapolation"].to_numpy() == INSIDE
    ends = [0, *(np.flatnonzero(np.diff(tested.astype(int))) + 1), tested.size]
    for first, last in pairwise(ends):
        # each segment ends where the next begins, so that the line is whole
        part = slice(first, min(last + 1, tested.size))
        ax.plot(x[part], y[part], color=tint, linestyle="-" if tested[first] else style.DASHES)
    ax.plot([], [], color=tint, label=label)


def _add_legend(ax: Axes, table: pd.DataFrame, probability: float) -> None:
    """Lines of the axes, then the bands and states that were not tested."""
    handles: list[Any] = ax.get_legend_handles_labels()[0]
    handles += band_handles(probability, "")
    if (table["extrapolation"] != INSIDE).any():
        handles.append(Line2D([], [], color=GREY, linestyle=style.DASHES, label="not tested"))
    ax.legend(handles=handles, loc="upper left", borderaxespad=0.2)
