"""All specimens of a study, quantity by quantity, ordered by layer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.figures.panels import (
    LABEL_LENGTH,
    LEAST_LABEL_MM,
    group_colour,
    group_handle,
    group_marker,
    row_panels,
)
from biaxbayes.figures.quantities import AxisText, axis_span, known_or_default, plain, quantity
from biaxbayes.figures.style import few_ticks, print_style
from biaxbayes.identifiability.verdict import FIXED
from biaxbayes.studies.groups import KNOWN

DERIVED = ("Hx", "Hy", "stiffness_x at 1", "stiffness_y at 1")
ROW_MM, TALLEST_PANEL_MM = 4.2, 62.0
NOTE = "within the law; filled: identified or bounded; open: neither; cross: fixed"


def study_figure(table: pd.DataFrame) -> Figure:
    """Draw medians and 90 % intervals of every specimen; open symbols are not identified."""
    drawn = table[np.isfinite(table["q50"].astype(float))]
    layers = list(dict.fromkeys(table["layer"]))
    specimens = table.drop_duplicates("specimen")[["specimen", "layer"]]
    specimens = specimens.sort_values("layer", key=lambda c: c.map(layers.index), kind="stable")
    assessed = [q.name for q in known_or_default(None).assessed()]
    names = [n for n in (*assessed, *DERIVED) if (drawn["quantity"] == n).any()]
    row_mm = min(ROW_MM, TALLEST_PANEL_MM / max(len(specimens), 1))
    if row_mm >= LEAST_LABEL_MM:
        rows = {float(i): str(name) for i, name in enumerate(specimens["specimen"])}
    else:  # the layers, where specimens lie too close
        layer = specimens["layer"].reset_index(drop=True)
        rows = {float(np.mean(part.index)): k or "no layer" for k, part in layer.groupby(layer)}
    labels = [plain(name, LABEL_LENGTH) for name in rows.values()]
    with print_style():
        tall = row_mm * len(specimens)
        figure, axes = row_panels(len(names), tall, list(rows), labels, NOTE)
        for ax, name in zip(axes, names, strict=True):
            part = drawn[drawn["quantity"] == name].set_index("specimen")
            _draw_panel(ax, part, quantity(name), specimens, layers)
        shown = [k for k, layer in enumerate(layers) if (drawn["layer"] == layer).any()]
        if len(shown) > 1:
            handles = [group_handle(k, layers[k] or "no layer") for k in shown]
            figure.legend(handles=handles, loc="outside lower left", ncols=min(len(shown), 6))
    return figure


def _draw_panel(
    ax: Axes, part: pd.DataFrame, q: AxisText, specimens: pd.DataFrame, layers: list[str]
) -> None:
    axis = axis_span(q, part[["q05", "q50", "q95"]].to_numpy(dtype=float).ravel())
    for i, (name, layer) in enumerate(specimens.itertuples(index=False)):
        if name not in part.index:
            continue
        record, k = part.loc[name], layers.index(layer)
        if record["verdict"] == FIXED:
            ax.plot(record["q50"], i, "x", color="0.35", ms=3.4, mew=0.8)
            continue
        identified = record["state"] == "converged" and record["verdict"] in KNOWN
        hue = group_colour(k)
        interval = np.clip([record["q05"], record["q95"]], axis.low, axis.high)
        ax.plot(interval, [i, i], color=hue, linewidth=1.0)
        look: dict[str, Any] = {
            "color": hue,
            "mfc": hue if identified else "white",
            "ms": 3.4,
            "mew": 0.8,
        }
        ax.plot(record["q50"], i, group_marker(k), clip_on=False, **look)
    ax.set(ylim=(len(specimens) - 0.4, -0.6), xscale="log" if axis.log else "linear")
    ax.set(xlim=(axis.low, axis.high), xlabel=q.label)
    few_ticks(ax.xaxis)
