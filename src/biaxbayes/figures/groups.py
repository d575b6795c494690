"""All specimens of a study; alone and pooled, with groups and the stress of a new specimen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from biaxbayes.figures import style
from biaxbayes.figures.corner import overlay_figure
from biaxbayes.figures.panels import LABEL_LENGTH, MIN_LABEL_MM, group_look, row_panels, set_panel
from biaxbayes.figures.quantities import axis_span, axis_text, known_or_default, plain, quantity
from biaxbayes.identifiability.verdict import FIXED
from biaxbayes.parameters import Parameter, Quantity
from biaxbayes.prediction.percentiles import QUANTILES

# --- the specimens of a study, quantity by quantity, ordered by group ----------------------------

STUDY_ROW_MM, TALLEST_STUDY_MM = 4.2, 62.0


@style.print_style()
def study_figure(table: pd.DataFrame, group_of: Mapping[str, str]) -> Figure:
    """Draw medians and 90 % intervals of every specimen; open: not converged."""
    table = table.assign(group=table["specimen"].map(group_of))
    drawn = table[np.isfinite(table["q50"].astype(float))]
    groups = list(dict.fromkeys(table["group"]))
    specimens = table.drop_duplicates("specimen")[["specimen", "group"]]
    specimens = specimens.sort_values("group", key=lambda c: c.map(groups.index), kind="stable")
    listed = [q.name for q in known_or_default(None).assessed()]
    listed += ["Hx", "Hy", "stiffness_x at 1", "stiffness_y at 1"]
    names = [n for n in listed if (drawn["quantity"] == n).any()]
    row_mm = min(STUDY_ROW_MM, TALLEST_STUDY_MM / max(len(specimens), 1))
    if row_mm >= MIN_LABEL_MM:
        rows = {float(i): str(name) for i, name in enumerate(specimens["specimen"])}
    else:  # the groups, where specimens lie too close
        group = specimens["group"].reset_index(drop=True)
        rows = {float(np.mean(part.index)): k or "no group" for k, part in group.groupby(group)}
    labels = [plain(name, LABEL_LENGTH) for name in rows.values()]
    note = "90 %; filled: converged; open: not; cross: fixed"
    figure, axes = row_panels(len(names), row_mm * len(specimens), list(rows), labels, note)
    for ax, name in zip(axes, names, strict=True):
        part = drawn[drawn["quantity"] == name].set_index("specimen")
        q = quantity(name)
        axis = axis_span(q, part[["q05", "q50", "q95"]].to_numpy(dtype=float).ravel())
        for i, (specimen, group) in enumerate(specimens.itertuples(index=False)):
            if specimen not in part.index:
                continue
            row = part.loc[specimen]
            if row["verdict"] == FIXED:
                ax.plot(row["q50"], i, "x", color="0.35", ms=3.4, mew=0.8)
                continue
            hue, marker = group_look(groups.index(group))
            interval = np.clip([row["q05"], row["q95"]], axis.low, axis.high)
            ax.plot(interval, [i, i], color=hue, linewidth=1.0)
            face = hue if row["state"] == "converged" else "white"
            look: dict[str, Any] = {"color": hue, "mfc": face, "mew": 0.8, "clip_on": False}
            ax.plot(row["q50"], i, marker, ms=3.4, **look)
        set_panel(ax, axis, q.label, len(specimens))
    shown = [k for k, group in enumerate(groups) if (drawn["group"] == group).any()]
    if len(shown) > 1:
        handles = []
        for k in shown:
            (hue, marker), label = group_look(k), plain(groups[k] or "no group", LABEL_LENGTH)
            look = {"color": hue, "marker": marker, "label": label}
            handles.append(Line2D([], [], linewidth=1.0, ms=3.4, **look))
        figure.legend(handles=handles, loc="outside lower left", ncols=min(len(shown), 6))
    return figure


# --- before and after pooling --------------------------------------------------------------------

ROW_MM, TALLEST_MM = 4.4, 110.0
ALONE = "0.62"
"""Grey of a specimen alone."""
NOTE = "grey: alone; coloured: pooled; diamond: group's median; thin: a new specimen; 90 %"
BAND_NOTE = (
    "coloured: median and 90 % of new specimens, to the largest stretch of any specimen; "
    "thin: equibiaxial records"
)
HIGHEST = 10.0
"""The stress axis ends at most at this multiple of the largest median."""


@style.print_style()
def forest_figure(
    specimens: pd.DataFrame, groups: pd.DataFrame, parameters: Sequence[Parameter]
) -> Figure:
    """Draw every specimen alone (grey) and pooled (coloured), the group and a new specimen."""
    rows: list[tuple[str, Any, int]] = []
    for k, group in enumerate(groups["group"].unique()):
        members = specimens.loc[specimens["group"] == group, "specimen"].unique()
        rows += [("specimen", m, k) for m in members] + [("group", group, k)]
    row_mm = min(ROW_MM, TALLEST_MM / len(rows))
    labels = {
        float(i): plain(name, LABEL_LENGTH)
        for i, (kind, name, _) in enumerate(rows)
        if kind == "group" or row_mm >= MIN_LABEL_MM
    }
    tall, names = row_mm * len(rows) + 1.0, list(labels.values())
    figure, axes = row_panels(len(parameters), tall, list(labels), names, NOTE)
    for ax, p in zip(axes, parameters, strict=True):
        tables = {
            kind: table[table["quantity"] == p.name].set_index(kind)
            for kind, table in (("specimen", specimens), ("group", groups))
        }
        for i, (kind, name, k) in enumerate(rows):
            row, (hue, marker) = tables[kind].loc[name], group_look(k)
            intervals: list[tuple[str, float, str, float, str, float]] = [
                ("single", i - 0.17, ALONE, 1.0, "o", 2.0),
                ("pooled", i + 0.17, hue, 1.4, marker, 2.8),
            ]
            if kind == "group":
                intervals = [
                    ("new_specimen", i, hue, 0.6, "", 0.0),
                    ("mean", i, hue, 2.0, "D", 3.6),
                ]
            for part, y, tint, width, symbol, size in intervals:
                low, median, high = (float(row[f"{part}_{q}"]) for q in QUANTILES)
                ax.plot([low, high], [y, y], color=tint, lw=width, solid_capstyle="butt")
                ax.plot(median, y, marker=symbol, ls="", color=tint, markersize=size)
        text = axis_text(Quantity(p))
        ax.set(ylim=(len(rows) - 0.4, -0.6), xlabel=text.label)
        if text.is_log(*ax.dataLim.intervalx):
            ax.set_xscale("log")
        style.limit_ticks(ax.xaxis)
    return figure


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
        title="new specimens: filled 50 %, outline 90 %; points: tested specimens, pooled",
    )


@style.print_style()
def band_figure(
    bands: pd.DataFrame,
    records: Sequence[tuple[str, np.ndarray, np.ndarray]],
    *,
    directions: tuple[str, str] = ("x", "y"),
) -> Figure:
    """Stress of a new specimen over records: group, total stretch and Cauchy stress (n, 2), kPa."""
    groups = list(bands["group"].unique())
    figure = style.blank_figure(style.PAGE_MM, 48.0 * len(groups) + 6.0)
    highest = max((float(stress.max()) for _, _, stress in records), default=0.0)
    axes = figure.subplots(len(groups), 2, squeeze=False, sharex=True, sharey=True)
    for (k, axis), ax in np.ndenumerate(axes):
        part, (hue, _) = bands[bands["group"] == groups[k]], group_look(k)
        stretch = part["total_stretch"]
        low, median, high = (part[f"cauchy_{'xy'[axis]}_{q}"] for q in ("q05", "q50", "q95"))
        ax.fill_between(stretch, low, high, color=hue, alpha=0.2, linewidth=0.0)
        ax.plot(stretch, median, color=hue)
        for group, measured, stress in records:
            if group == groups[k]:
                ax.plot(measured[:, axis], stress[:, axis], color="0.25", linewidth=0.5)
        highest = max(highest, min(high.max(), HIGHEST * median.max()))
        style.limit_ticks(ax.xaxis)
        style.limit_ticks(ax.yaxis)
        ax.set_title(f"{plain(groups[k], LABEL_LENGTH)}, {plain(directions[axis], 20)}")
    axes[0, 0].set_xlim(left=bands["total_stretch"].min())
    axes[0, 0].set_ylim(0.0, 1.05 * highest)
    for ax in axes[-1]:
        ax.set_xlabel("total equibiaxial stretch")
    figure.supylabel("Cauchy stress (kPa)")
    style.add_note(figure, BAND_NOTE)
    return figure
