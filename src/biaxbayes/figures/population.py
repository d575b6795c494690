"""Specimens before and after pooling, what they have in common, and the next one's stress."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter

from biaxbayes.figures.forest import (
    LABEL_LENGTH,
    LEAST_LABEL_MM,
    LOG_SPREAD,
    group_colour,
    group_handle,
    group_marker,
    panel_rows,
)
from biaxbayes.figures.quantities import axis_text
from biaxbayes.figures.style import (
    PAGE_MM,
    add_note,
    blank_figure,
    few_ticks,
    plain,
    print_style,
)
from biaxbayes.parameters import Parameter, Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_MM, TALLEST_MM = 4.4, 110.0
ALONE = "0.62"
"""Grey of a specimen alone."""
CONTENTS = (0.9, 0.5)
"""Shares of new specimens that the contours hold."""
BINS = 40
NOTE = "grey: alone; coloured: pooled; diamond: group's median; thin: a new specimen; 90 %"
BAND_NOTE = "band: 90 % of new specimens; thin lines: equibiaxial records"


def forest_figure(
    specimens: pd.DataFrame,
    groups: pd.DataFrame,
    parameters: Sequence[Parameter],
    *,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Every specimen alone (grey) and pooled (coloured), below them the group and a new specimen.

    Parameters
    ----------
    specimens, groups : DataFrame
        specimens.csv and population.csv.
    parameters : sequence of Parameter
        One panel each.
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    rows: list[tuple[str, str, int]] = []
    for k, group in enumerate(groups["group"].unique()):
        members = specimens.loc[specimens["group"] == group, "specimen"].unique()
        rows += [("specimen", str(m), k) for m in members] + [("group", str(group), k)]
    row_mm = min(ROW_MM, TALLEST_MM / len(rows))
    labelled = [
        (i, plain(name, LABEL_LENGTH))
        for i, (kind, name, _) in enumerate(rows)
        if kind == "group" or row_mm >= LEAST_LABEL_MM
    ]
    places, labels = [i for i, _ in labelled], [name for _, name in labelled]
    with print_style(style):
        tall = row_mm * len(rows) + 1.0
        figure, axes = panel_rows(len(parameters), tall, places, labels, width_mm, NOTE)
        for ax, p in zip(axes, parameters, strict=True):
            alone = specimens[specimens["quantity"] == p.name].to_dict("records")
            pooled = groups[groups["quantity"] == p.name].to_dict("records")
            records = {str(r["specimen"]): r for r in alone}
            common = {str(r["group"]): r for r in pooled}
            for i, (kind, name, k) in enumerate(rows):
                if kind == "group":
                    _draw_group(ax, common[name], i, group_colour(k))
                else:
                    _draw_specimen(ax, records[name], i, k)
            ax.set(ylim=(len(rows) - 0.4, -0.6), xlabel=axis_text(Quantity(p)).label)
            low, high = ax.dataLim.intervalx
            if p.logarithmic and low > 0.0 and high > LOG_SPREAD * low:
                ax.set_xscale("log")
            few_ticks(ax.xaxis)
    return figure


def _draw_specimen(ax: Axes, record: Mapping[Any, Any], row: int, k: int) -> None:
    _draw_interval(ax, record, "single", row - 0.17, ALONE, 1.0)
    ax.plot(record["single_q50"], row - 0.17, "o", color=ALONE, markersize=2.0)
    _draw_interval(ax, record, "pooled", row + 0.17, group_colour(k), 1.4)
    ax.plot(record["pooled_q50"], row + 0.17, group_marker(k), color=group_colour(k), ms=2.8)


def _draw_group(ax: Axes, record: Mapping[Any, Any], row: int, hue: str) -> None:
    _draw_interval(ax, record, "new_specimen", row, hue, 0.6)
    _draw_interval(ax, record, "mean", row, hue, 2.0)
    ax.plot(record["mean_q50"], row, "D", color=hue, markersize=3.6)


def _draw_interval(
    ax: Axes, record: Mapping[Any, Any], name: str, y: float, hue: str, width: float
) -> None:
    ends = [float(record[f"{name}_{q}"]) for q in ("q05", "q95")]
    ax.plot(ends, [y, y], color=hue, linewidth=width, solid_capstyle="butt")


def pairs_figure(
    draws: Mapping[str, pd.DataFrame],
    specimens: pd.DataFrame,
    parameters: Sequence[Parameter],
    *,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """New specimens of each group, pair by pair, with the tested ones as points.

    Parameters
    ----------
    draws : mapping of str to DataFrame
        New specimens by group, one column per parameter.
    specimens : DataFrame
        specimens.csv.
    parameters : sequence of Parameter
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    count = len(parameters)
    medians = specimens.pivot_table(
        index=["group", "specimen"], columns="quantity", values="pooled_q50"
    )
    ranges = {p.name: _axis_range(draws, medians[p.name], p) for p in parameters}
    with print_style(style):
        figure = blank_figure(width_mm, width_mm)
        axes = figure.subplots(count, count, squeeze=False, sharex="col")
        for (i, j), ax in np.ndenumerate(axes):
            x, y = parameters[j], parameters[i]
            if j > i:
                ax.remove()
                continue
            for k, (group, table) in enumerate(draws.items()):
                if i == j:
                    _draw_density(ax, table[x.name], ranges[x.name], group_colour(k))
                else:
                    _draw_contours(ax, table, (x, y), ranges, group_colour(k))
                    tested = medians.loc[group]
                    ax.plot(
                        tested[x.name],
                        tested[y.name],
                        group_marker(k),
                        color=group_colour(k),
                        ms=2.6,
                    )
            ax.set_xlim(ranges[x.name])
            ax.set_ylim((0.0, None) if i == j else ranges[y.name])
            few_ticks(ax.xaxis, 3)
            few_ticks(ax.yaxis, 3)
            ax.tick_params(labelbottom=i == count - 1, labelleft=j == 0)
            if i == j:
                ax.set_yticks([])
            elif j == 0:
                ax.set_ylabel(axis_text(Quantity(y)).label)
            if i == count - 1:
                ax.set_xlabel(axis_text(Quantity(x)).label)
        figure.align_labels()
        note = ": new specimens (50, 90 %), tested ones as points"
        handles = [group_handle(k, group, note) for k, group in enumerate(draws)]
        figure.legend(handles=handles, loc="upper right").set_in_layout(False)
    return figure


def _axis_range(
    draws: Mapping[str, pd.DataFrame], tested: pd.Series, p: Parameter
) -> tuple[float, float]:
    """All tested specimens and all but the farthest draws, with space for a contour to close."""
    ends = np.array([np.quantile(table[p.name], [0.01, 0.98]) for table in draws.values()])
    margin = 0.25 * (ends[:, 1] - ends[:, 0])
    low = min((ends[:, 0] - margin).min(), tested.min())
    high = max((ends[:, 1] + margin).max(), tested.max())
    return max(float(low), p.low), min(float(high), p.high)


def _draw_density(ax: Axes, values: pd.Series, ends: tuple[float, float], hue: str) -> None:
    density, edges = np.histogram(values, BINS, range=ends, density=True)
    ax.plot(0.5 * (edges[1:] + edges[:-1]), gaussian_filter(density, 1.2), color=hue)


def _draw_contours(
    ax: Axes,
    table: pd.DataFrame,
    pair: tuple[Parameter, Parameter],
    ranges: Mapping[str, tuple[float, float]],
    hue: str,
) -> None:
    """Contours of the smoothed density that hold 90 and 50 % of the draws."""
    across, up = (p.name for p in pair)
    ends = [ranges[across], ranges[up]]
    counts, x, y = np.histogram2d(table[across], table[up], BINS, range=ends)
    density = gaussian_filter(counts.T, 1.5)
    heights = np.sort(density.ravel())[::-1]
    share = np.cumsum(heights) / heights.sum()
    levels = [heights[min(int(np.searchsorted(share, c)), heights.size - 1)] for c in CONTENTS]
    if levels[0] < levels[1]:
        centres = [0.5 * (edges[1:] + edges[:-1]) for edges in (x, y)]
        ax.contour(*centres, density, levels=levels, colors=[hue], linewidths=[0.6, 1.0])


def band_figure(
    bands: pd.DataFrame,
    records: Sequence[tuple[str, np.ndarray, np.ndarray]],
    *,
    directions: tuple[str, str] = ("x", "y"),
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Equibiaxial Cauchy stress of a new specimen over the equibiaxial records, group by group.

    Parameters
    ----------
    bands : DataFrame
        Columns group, total_stretch, and cauchy_x, cauchy_y with q05, q50, q95.
    records : sequence of (group, stretch (n, 2), stress (n, 2))
        Total stretches and Cauchy stresses (kPa) of the tested specimens.
    directions : (str, str)
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    groups = list(bands["group"].unique())
    with print_style(style):
        figure = blank_figure(width_mm, 48.0 * len(groups) + 6.0)
        axes = figure.subplots(len(groups), 2, squeeze=False, sharex=True)
        for k, group in enumerate(groups):
            part, hue = bands[bands["group"] == group], group_colour(k)
            stretch = part["total_stretch"]
            for axis, ax in enumerate(axes[k]):
                low, median, high = (
                    part[f"cauchy_{'xy'[axis]}_{q}"] for q in ("q05", "q50", "q95")
                )
                ax.fill_between(stretch, low, high, color=hue, alpha=0.2, linewidth=0.0)
                ax.plot(stretch, median, color=hue)
                for name, measured, stress in records:
                    if name == group:
                        ax.plot(measured[:, axis], stress[:, axis], color="0.25", linewidth=0.5)
                ax.set_xlim(stretch.min(), stretch.max())
                ax.set_ylim(bottom=0.0)
                few_ticks(ax.xaxis)
                few_ticks(ax.yaxis)
                ax.set_title(f"{plain(group, LABEL_LENGTH)}, {plain(directions[axis], 20)}")
            axes[k, 0].set_ylabel("Cauchy stress (kPa)")
        for ax in axes[-1]:
            ax.set_xlabel("total equibiaxial stretch")
        add_note(figure, BAND_NOTE)
    return figure
