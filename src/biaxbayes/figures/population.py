"""Specimens before and after pooling, what they have in common, and the next one's stress."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.figures.compare import FOREST_COLUMNS, LABEL_LENGTH, MARKERS, panel_rows
from biaxbayes.figures.labels import few_ticks
from biaxbayes.figures.quantities import AxisText, axis_text
from biaxbayes.figures.style import (
    MM,
    PAGE_MM,
    RUNS,
    blank_figure,
    colour,
    font_points,
    layout,
    plain,
    print_style,
    settle,
)
from biaxbayes.parameters import Parameter, Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_MM, TALLEST_MM, LEAST_LABEL_MM = 4.4, 110.0, 2.6
GREY = "0.62"
WIDE_LOG = 8.0
LEVELS = (0.9, 0.5)
BINS, ROOM = 40, 0.25


def _axis(parameter: Parameter) -> AxisText:
    return axis_text(Quantity(parameter))


def _hue(k: int) -> str:
    return colour(RUNS[k % len(RUNS)])


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
        A panel each.
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    order = list(dict.fromkeys(groups["group"]))
    rows: list[tuple[str, str, int]] = []
    for k, group in enumerate(order):
        members = dict.fromkeys(specimens.loc[specimens["group"] == group, "specimen"])
        rows += [("specimen", str(m), k) for m in members] + [("group", str(group), k)]
    row_mm = min(ROW_MM, TALLEST_MM / len(rows))
    note = "grey: alone; coloured: pooled; diamond: group's median; thin: a new specimen; 90 %"
    with print_style(style):
        figure, axes = panel_rows(len(parameters), row_mm * len(rows) + 1.0, width_mm, note)
        for k, (ax, p) in enumerate(zip(axes, parameters, strict=True)):
            _forest_panel(ax, specimens, groups, p, rows)
            labelled = [] if k % FOREST_COLUMNS else list(enumerate(rows))
            if row_mm < LEAST_LABEL_MM:
                labelled = [(i, row) for i, row in labelled if row[0] == "group"]
            names = [plain(row[1], LABEL_LENGTH) for _, row in labelled]
            ax.set_yticks([i for i, _ in labelled], names)
        settle(figure)
    return figure


def _forest_panel(
    ax: Axes,
    specimens: pd.DataFrame,
    groups: pd.DataFrame,
    p: Parameter,
    rows: list[tuple[str, str, int]],
) -> None:
    own = {r["specimen"]: r for r in specimens[specimens["quantity"] == p.name].to_dict("records")}
    of = {r["group"]: r for r in groups[groups["quantity"] == p.name].to_dict("records")}
    ends: list[float] = []
    for i, (kind, name, k) in enumerate(rows):
        hue = _hue(k)
        if kind == "group":
            r = of[name]
            _line(ax, r, "new_specimen", i, hue, 0.6, ends)
            _line(ax, r, "mean", i, hue, 2.0, ends)
            ax.plot(r["mean_q50"], i, "D", color=hue, markersize=3.6)
            continue
        r = own[name]
        _line(ax, r, "single", i - 0.17, GREY, 1.0, ends)
        ax.plot(r["single_q50"], i - 0.17, "o", color=GREY, markersize=2.0)
        _line(ax, r, "pooled", i + 0.17, hue, 1.4, ends)
        ax.plot(r["pooled_q50"], i + 0.17, MARKERS[k % len(MARKERS)], color=hue, markersize=2.8)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    known = np.array([e for e in ends if np.isfinite(e)])
    if (
        p.logarithmic
        and known.size
        and known.min() > 0.0
        and np.ptp(np.log(known)) > np.log(WIDE_LOG)
    ):
        ax.set_xscale("log")
    few_ticks(ax.xaxis, most=4, overhang=2.0)
    ax.set_xlabel(_axis(p).label, labelpad=2.0)


def _line(
    ax: Axes, r: dict[Any, Any], what: str, at: float, hue: str, width: float, ends: list[float]
) -> None:
    low, high = float(r[f"{what}_q05"]), float(r[f"{what}_q95"])
    ends += [low, high]
    ax.plot([low, high], [at, at], color=hue, linewidth=width, solid_capstyle="butt")


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
        New specimens by group, a column a parameter.
    specimens : DataFrame
        specimens.csv.
    parameters : sequence of Parameter
    width_mm : float
    style : mapping, optional
    """
    p = len(parameters)
    with print_style(style):
        figure = blank_figure(width_mm * MM, width_mm * MM, layout())
        axes = figure.subplots(p, p, squeeze=False)
        for i, row in enumerate(parameters):
            for j, column in enumerate(parameters):
                ax = axes[i, j]
                if j > i:
                    ax.set_visible(False)
                    continue
                _pair(ax, draws, specimens, column, None if i == j else row)
                few_ticks(ax.xaxis, most=3, overhang=1.0)
                if i == p - 1:
                    ax.set_xlabel(_axis(column).label)
                else:
                    ax.set_xticklabels([])
                if i == j:
                    ax.set_yticks([])
                elif j == 0:
                    ax.set_ylabel(_axis(row).label)
                    few_ticks(ax.yaxis, most=3)
                else:
                    few_ticks(ax.yaxis, most=3)
                    ax.set_yticklabels([])
        _legend(figure, list(draws))
        settle(figure)
    return figure


def _pair(
    ax: Axes,
    draws: Mapping[str, pd.DataFrame],
    specimens: pd.DataFrame,
    x: Parameter,
    y: Parameter | None,
) -> None:
    from scipy.ndimage import gaussian_filter

    for k, (group, table) in enumerate(draws.items()):
        hue = _hue(k)
        of = specimens[specimens["group"] == group]
        columns = [_range(table[q.name], q) for q in ([x] if y is None else [x, y])]
        if y is None:
            counts, edges = np.histogram(table[x.name], BINS, range=columns[0], density=True)
            ax.plot(0.5 * (edges[1:] + edges[:-1]), gaussian_filter(counts, 1.2), color=hue)
            continue
        counts, ex, ey = np.histogram2d(table[x.name], table[y.name], BINS, range=columns)
        smooth = gaussian_filter(counts.T, 1.5)
        heights = np.sort(smooth.ravel())[::-1]
        share = np.cumsum(heights) / heights.sum()
        last = len(heights) - 1
        levels = [heights[min(int(np.searchsorted(share, x)), last)] for x in LEVELS]
        if levels[0] < levels[1]:
            middle = [0.5 * (e[1:] + e[:-1]) for e in (ex, ey)]
            ax.contour(*middle, smooth, levels=levels, colors=[hue], linewidths=[0.6, 1.0])
        points = [of[of["quantity"] == q.name].set_index("specimen")["pooled_q50"] for q in (x, y)]
        ax.plot(*points, MARKERS[k % len(MARKERS)], color=hue, markersize=2.6, linestyle="none")
    ranges = np.array([_range(table[x.name], x) for table in draws.values()])
    ax.set_xlim(ranges[:, 0].min(), ranges[:, 1].max())
    if y is None:
        ax.set_ylim(bottom=0.0)


def _range(values: pd.Series, p: Parameter) -> tuple[float, float]:
    """Of a panel: all but the farthest draws, with room for a contour to close."""
    low, high = np.quantile(values, [0.01, 0.98])
    room = ROOM * (high - low)
    return max(float(low - room), p.low), min(float(high + room), p.high)


def _legend(figure: Figure, groups: list[str]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            color=_hue(k),
            marker=MARKERS[k % len(MARKERS)],
            markersize=3.0,
            linewidth=1.0,
            label=f"{plain(group, LABEL_LENGTH)}: new specimens (50, 90 %), tested ones as points",
        )
        for k, group in enumerate(groups)
    ]
    figure.legend(handles=handles, loc="upper right", fontsize=font_points("legend.fontsize"))


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
    """
    groups = list(dict.fromkeys(bands["group"]))
    with print_style(style):
        height = (48.0 * len(groups) + 6.0) * MM
        figure = blank_figure(width_mm * MM, height, layout())
        axes = figure.subplots(len(groups), 2, squeeze=False, sharex=True)
        for k, group in enumerate(groups):
            part = bands[bands["group"] == group]
            hue = _hue(k)
            for axis, ax in enumerate(axes[k]):
                name = f"cauchy_{'xy'[axis]}"
                ends = (part[f"{name}_q05"], part[f"{name}_q95"])
                ax.fill_between(part["total_stretch"], *ends, color=hue, alpha=0.2, linewidth=0)
                ax.plot(part["total_stretch"], part[f"{name}_q50"], color=hue)
                for of, stretch, stress in records:
                    if of == group:
                        ax.plot(stretch[:, axis], stress[:, axis], color="0.25", linewidth=0.5)
                ax.set_xlim(part["total_stretch"].min(), part["total_stretch"].max())
                ax.set_ylim(bottom=0.0)
                few_ticks(ax.xaxis, most=4)
                few_ticks(ax.yaxis, most=4)
                ax.set_title(f"{plain(group, LABEL_LENGTH)}, {plain(directions[axis], 20)}")
                if k == len(groups) - 1:
                    ax.set_xlabel("total equibiaxial stretch")
            axes[k, 0].set_ylabel("Cauchy stress (kPa)")
        size = font_points("legend.fontsize")
        told = "band: 90 % of new specimens; thin lines: equibiaxial records"
        figure.supxlabel(told, x=0.995, ha="right", color="0.35", fontsize=size)
        settle(figure)
    return figure
