"""Specimens before and after pooling, their groups, and the stress of a new specimen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.figures.panels import (
    LABEL_LENGTH,
    LEAST_LABEL_MM,
    group_colour,
    group_marker,
    row_panels,
)
from biaxbayes.figures.quantities import LOG_SPREAD, axis_text, plain
from biaxbayes.figures.run.corner import overlay_figure
from biaxbayes.figures.style import PAGE_MM, add_note, blank_figure, few_ticks, print_style
from biaxbayes.parameters import Parameter, Quantity

ROW_MM, TALLEST_MM = 4.4, 110.0
ALONE = "0.62"
"""Grey of a specimen alone."""
NOTE = "grey: alone; coloured: pooled; diamond: group's median; thin: a new specimen; 90 %"
PAIRS = "new specimens: filled 50 %, outline 90 %; points: tested specimens, pooled"
BAND_NOTE = (
    "band: 90 % of new specimens, up to ten times the median; thin lines: equibiaxial records"
)
HIGHEST = 10.0
"""Times the largest median at which the axis of a band ends."""


def forest_figure(
    specimens: pd.DataFrame, groups: pd.DataFrame, parameters: Sequence[Parameter]
) -> Figure:
    """Draw every specimen alone (grey) and pooled (coloured), the group and a new specimen."""
    rows: list[tuple[str, str, int]] = []
    for k, group in enumerate(groups["group"].unique()):
        members = specimens.loc[specimens["group"] == group, "specimen"].unique()
        rows += [("specimen", str(m), k) for m in members] + [("group", str(group), k)]
    row_mm = min(ROW_MM, TALLEST_MM / len(rows))
    labels = {
        float(i): plain(name, LABEL_LENGTH)
        for i, (kind, name, _) in enumerate(rows)
        if kind == "group" or row_mm >= LEAST_LABEL_MM
    }
    with print_style():
        figure, axes = row_panels(
            len(parameters),
            row_mm * len(rows) + 1.0,
            list(labels),
            list(labels.values()),
            NOTE,
        )
        for ax, p in zip(axes, parameters, strict=True):
            alone = specimens[specimens["quantity"] == p.name].to_dict("records")
            pooled = groups[groups["quantity"] == p.name].to_dict("records")
            records = {("specimen", str(r["specimen"])): r for r in alone}
            records |= {("group", str(r["group"])): r for r in pooled}
            for i, (kind, name, k) in enumerate(rows):
                record, hue = records[kind, name], group_colour(k)
                if kind == "group":
                    _draw_interval(ax, record, "new_specimen", i, hue, 0.6)
                    _draw_interval(ax, record, "mean", i, hue, 2.0, "D", 3.6)
                else:
                    _draw_interval(ax, record, "single", i - 0.17, ALONE, 1.0, "o", 2.0)
                    marker = group_marker(k)
                    _draw_interval(ax, record, "pooled", i + 0.17, hue, 1.4, marker, 2.8)
            ax.set(ylim=(len(rows) - 0.4, -0.6), xlabel=axis_text(Quantity(p)).label)
            low, high = ax.dataLim.intervalx
            if p.logarithmic and low > 0.0 and high > LOG_SPREAD * low:
                ax.set_xscale("log")
            few_ticks(ax.xaxis)
    return figure


def _draw_interval(
    ax: Axes,
    record: Mapping[Any, Any],
    name: str,
    y: float,
    hue: str,
    width: float,
    marker: str = "",
    size: float = 0.0,
) -> None:
    """The 90 % interval of a row, and its median where there is a marker."""
    ends = [float(record[f"{name}_{q}"]) for q in ("q05", "q95")]
    ax.plot(ends, [y, y], color=hue, linewidth=width, solid_capstyle="butt")
    if marker:
        ax.plot(record[f"{name}_q50"], y, marker, color=hue, markersize=size)


def pairs_figure(
    draws: Mapping[str, pd.DataFrame], specimens: pd.DataFrame, parameters: Sequence[Parameter]
) -> Figure:
    """New specimens of each group, pair by pair, with the tested ones as points."""
    names = [p.name for p in parameters]
    medians = specimens.pivot_table(
        index=["group", "specimen"], columns="quantity", values="pooled_q50"
    )
    return overlay_figure(
        [table[names] for table in draws.values()],
        list(draws),
        points=[{n: medians.loc[[group], n].to_numpy() for n in names} for group in draws],
        title=PAIRS,
    )


def band_figure(
    bands: pd.DataFrame,
    records: Sequence[tuple[str, np.ndarray, np.ndarray]],
    *,
    directions: tuple[str, str] = ("x", "y"),
) -> Figure:
    """Draw equibiaxial Cauchy stress of a new specimen over the records, a panel per group.

    `records` are (group, total stretch (n, 2), Cauchy stress in kPa (n, 2)).
    """
    groups = list(bands["group"].unique())
    with print_style():
        figure = blank_figure(PAGE_MM, 48.0 * len(groups) + 6.0)
        axes = figure.subplots(len(groups), 2, squeeze=False, sharex=True)
        for (k, axis), ax in np.ndenumerate(axes):
            part, hue = bands[bands["group"] == groups[k]], group_colour(k)
            stretch = part["total_stretch"]
            low, median, high = (part[f"cauchy_{'xy'[axis]}_{q}"] for q in ("q05", "q50", "q95"))
            ax.fill_between(stretch, low, high, color=hue, alpha=0.2, linewidth=0.0)
            ax.plot(stretch, median, color=hue)
            for group, measured, stress in records:
                if group == groups[k]:
                    ax.plot(measured[:, axis], stress[:, axis], color="0.25", linewidth=0.5)
            ax.set_xlim(stretch.min(), stretch.max())
            ax.set_ylim(0.0, min(ax.get_ylim()[1], HIGHEST * median.max()))
            few_ticks(ax.xaxis)
            few_ticks(ax.yaxis)
            ax.set_title(f"{plain(groups[k], LABEL_LENGTH)}, {plain(directions[axis], 20)}")
        for ax in axes[-1]:
            ax.set_xlabel("total equibiaxial stretch")
        figure.supylabel("Cauchy stress (kPa)")
        add_note(figure, BAND_NOTE)
    return figure
