"""All specimens of a study, quantity by quantity, ordered by layer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.figures.forest import (
    LABEL_LENGTH,
    LEAST_LABEL_MM,
    LOG_SPREAD,
    group_colour,
    group_handle,
    group_marker,
    panel_rows,
)
from biaxbayes.figures.quantities import AxisText, known_or_default, quantity
from biaxbayes.figures.style import PAGE_MM, few_ticks, plain, print_style
from biaxbayes.identifiability.bounded_density import span
from biaxbayes.identifiability.verdict_names import FIXED
from biaxbayes.studies.groups import KNOWN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DERIVED = {
    "Hx": AxisText("$H_x$", "", (0.0, 1.0)),
    "Hy": AxisText("$H_y$", "", (0.0, 1.0)),
    "stiffness_x at 1": AxisText("$c_{xx}$ at 1", "kPa", (0.0, np.inf), True),
    "stiffness_y at 1": AxisText("$c_{yy}$ at 1", "kPa", (0.0, np.inf), True),
}
ROW_MM, TALLEST_PANEL_MM = 4.2, 62.0
NOTE = "within the law; filled: determined; open: not determined; cross: fixed"


def study_figure(
    table: pd.DataFrame, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians and 90 % intervals of every specimen, one panel per quantity.

    Open symbols stand for parameters that the specimen does not determine.

    Parameters
    ----------
    table : DataFrame
        The study table.
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    drawn = table[np.isfinite(table["q50"].astype(float))]
    layers = list(dict.fromkeys(table["layer"]))
    specimens = table.drop_duplicates("specimen")[["specimen", "layer"]]
    specimens = specimens.sort_values("layer", key=lambda c: c.map(layers.index), kind="stable")
    judged = [q.name for q in known_or_default(None).judged()]
    names = [n for n in (*judged, *DERIVED) if (drawn["quantity"] == n).any()]
    row_mm = min(ROW_MM, TALLEST_PANEL_MM / max(len(specimens), 1))
    places, labels = _row_labels(specimens, row_mm)
    with print_style(style):
        figure, axes = panel_rows(
            len(names), row_mm * len(specimens), places, labels, width_mm, NOTE
        )
        for ax, name in zip(axes, names, strict=True):
            part = drawn[drawn["quantity"] == name].set_index("specimen")
            _draw_panel(ax, part, DERIVED.get(name) or quantity(name), specimens, layers)
        shown = [k for k, layer in enumerate(layers) if (drawn["layer"] == layer).any()]
        if len(shown) > 1:
            handles = [group_handle(k, layers[k] or "no layer") for k in shown]
            figure.legend(handles=handles, loc="outside lower left", ncols=min(len(shown), 6))
    return figure


def _row_labels(specimens: pd.DataFrame, row_mm: float) -> tuple[list[float], list[str]]:
    """Labels at the rows: the specimens, or the layers where specimens lie too close."""
    if row_mm >= LEAST_LABEL_MM:
        rows = list(enumerate(specimens["specimen"]))
    else:
        layers = specimens["layer"].reset_index(drop=True)
        rows = [(at.index.to_numpy().mean(), k or "no layer") for k, at in layers.groupby(layers)]
    return [float(at) for at, _ in rows], [plain(name, LABEL_LENGTH) for _, name in rows]


def _draw_panel(
    ax: Axes, part: pd.DataFrame, q: AxisText, specimens: pd.DataFrame, layers: list[str]
) -> None:
    ends = part[["q05", "q50", "q95"]].to_numpy(dtype=float).ravel()
    log = bool(q.scale and ends.min() > 0.0 and ends.max() > LOG_SPREAD * ends.min())
    axis = span(ends, edges=q.edges, log=log)
    for i, (name, layer) in enumerate(specimens.itertuples(index=False)):
        if name not in part.index:
            continue
        record, k = part.loc[name], layers.index(layer)
        if record["verdict"] == FIXED:
            ax.plot(record["q50"], i, "x", color="0.35", markersize=3.4, markeredgewidth=0.8)
            continue
        determined = record["state"] == "converged" and record["verdict"] in KNOWN
        interval = np.clip([record["q05"], record["q95"]], axis.low, axis.high)
        ax.plot(interval, [i, i], color=group_colour(k), linewidth=1.0)
        ax.plot(
            record["q50"],
            i,
            group_marker(k),
            color=group_colour(k),
            markerfacecolor=group_colour(k) if determined else "white",
            markersize=3.4,
            markeredgewidth=0.8,
            clip_on=False,
        )
    ax.set(ylim=(len(specimens) - 0.4, -0.6), xscale="log" if axis.log else "linear")
    ax.set(xlim=(axis.low, axis.high), xlabel=q.label)
    few_ticks(ax.xaxis)
