"""All specimens of a study, quantity by quantity, ordered by layer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from biaxbayes.findings.bounded_density import Span, span
from biaxbayes.findings.study_groups import KNOWN
from biaxbayes.findings.verdict import FIXED
from biaxbayes.output.figures.compare import ROLES
from biaxbayes.output.figures.quantities import Quantity, quantity
from biaxbayes.output.figures.ticks import choose_ticks, set_ticks
from biaxbayes.output.style import MM, PAGE_MM, colour, plain, print_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["study_figure"]

PARAMETERS = ("C1", "k1", "k2", "alpha", "kappa", "mounting_stretch_x", "mounting_stretch_y")
CURVES = {
    "Hx": Quantity("$H_x$", "", (0.0, 1.0)),
    "Hy": Quantity("$H_y$", "", (0.0, 1.0)),
    "stiffness_x at 1": Quantity("$c_{xx}$ at 1", "kPa", (0.0, np.inf), True),
    "stiffness_y at 1": Quantity("$c_{yy}$ at 1", "kPa", (0.0, np.inf), True),
}
COLUMNS = 4
TALLEST_ROW_MM, TALLEST_PANEL_MM, LEAST_LABEL_MM = 4.2, 62.0, 2.6
BETWEEN_MM, FOOT_MM, HEAD_MM = 12.0, 8.0, 2.0
LABEL_LENGTH = 18
TAIL_STRETCH = 8.0
"""Ratio of the ends from which a positive scale gets a logarithmic axis."""
MARKERS = ("o", "s", "^", "D", "v", "P")


class _Row(NamedTuple):
    """A specimen in the figure."""

    label: str
    layer: int


def study_figure(
    table: pd.DataFrame, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians and 90 % intervals of every specimen, a panel a quantity.

    Open symbols stand for parameters that the specimen does not determine.

    Parameters
    ----------
    table : DataFrame
        The study table.
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.output.style.read_style`.
    """
    from matplotlib.figure import Figure

    known = table[np.isfinite(table["q50"].astype(float))]
    layers = list(dict.fromkeys(table["layer"]))
    first = table.drop_duplicates("specimen")
    rows = sorted(
        (
            _Row(str(s), layers.index(k))
            for s, k in zip(first["specimen"], first["layer"], strict=True)
        ),
        key=lambda row: row.layer,
    )
    panels = [n for n in (*PARAMETERS, *CURVES) if (known["quantity"] == n).any()]
    row_mm = min(TALLEST_ROW_MM, TALLEST_PANEL_MM / max(len(rows), 1))
    tall = row_mm * len(rows) + 1.0
    lines = max(-(-len(panels) // COLUMNS), 1)
    height = HEAD_MM + lines * (tall + BETWEEN_MM) + FOOT_MM
    names = _names(rows, layers, row_mm)
    label_mm = 4.0 + 1.4 * max((len(plain(n, LABEL_LENGTH)) for _, n in names), default=0)
    wide = (width_mm - label_mm - 3.0) / COLUMNS
    with print_style(style):
        figure = Figure((width_mm * MM, height * MM))
        for k, name in enumerate(panels):
            line, column = divmod(k, COLUMNS)
            bottom = height - HEAD_MM - (line + 1) * tall - line * BETWEEN_MM
            box = (label_mm + column * wide, bottom, wide - 5.0, tall)
            ax = figure.add_axes(
                (box[0] / width_mm, box[1] / height, box[2] / width_mm, box[3] / height)
            )
            _panel(ax, known[known["quantity"] == name], name, rows, box[2])
            ax.set_yticks(
                [at for at, _ in names] if column == 0 else [],
                [plain(n, LABEL_LENGTH) for _, n in names] if column == 0 else [],
            )
        drawn = [k for k, layer in enumerate(layers) if (known["layer"] == layer).any()]
        _legend(figure, layers, drawn, width_mm, height)
    return figure


def _names(rows: list[_Row], layers: list[str], row_mm: float) -> list[tuple[float, str]]:
    """What stands at the rows: the specimens, or the layers where specimens lie too close."""
    if row_mm >= LEAST_LABEL_MM:
        return [(float(i), row.label) for i, row in enumerate(rows)]
    out = []
    for k, layer in enumerate(layers):
        places = [i for i, row in enumerate(rows) if row.layer == k]
        out.append((float(np.mean(places)), layer or "no layer"))
    return out


def _panel(ax: Axes, part: pd.DataFrame, name: str, rows: list[_Row], width_mm: float) -> None:
    shown = CURVES.get(name) or quantity(name)
    axis = _axis(part, shown)
    found = {str(r["specimen"]): r for r in part.to_dict("records")}
    for i, row in enumerate(rows):
        record = found.get(row.label)
        if record is None:
            continue
        hue = colour(ROLES[row.layer % len(ROLES)])
        known = record["state"] == "reliable" and record["verdict"] in KNOWN
        if record["verdict"] == FIXED:
            ax.plot(record["q50"], i, "x", color="0.35", markersize=3.4, markeredgewidth=0.8)
            continue
        ends = np.clip([record["q05"], record["q95"]], axis.low, axis.high)
        ax.plot(ends, [i, i], color=hue, linewidth=1.0)
        ax.plot(
            record["q50"],
            i,
            MARKERS[row.layer % len(MARKERS)],
            color=hue,
            markerfacecolor=hue if known else "white",
            markersize=3.4,
            markeredgewidth=0.8,
            clip_on=False,
        )
    ax.set_ylim(len(rows) - 0.4, -0.6)
    if axis.log:
        ax.set_xscale("log")
    ax.set_xlim(axis.low, axis.high)
    ticks = choose_ticks(axis, width_mm, 7.0, horizontal=True, overhang=2.0, most=4)
    set_ticks(ax.xaxis, ticks, labels=True)
    ax.tick_params(axis="y", length=0.0)
    ax.spines["left"].set_visible(False)
    ax.set_xlabel(shown.label, labelpad=2.0)


def _axis(part: pd.DataFrame, shown: Quantity) -> Span:
    """Range of all medians and intervals."""
    ends = part[["q05", "q50", "q95"]].to_numpy(dtype=float).ravel()
    log = shown.scale and ends.min() > 0.0 and ends.max() > TAIL_STRETCH * ends.min()
    return span(ends, edges=shown.edges, log=bool(log))


def _legend(
    figure: Figure, layers: list[str], drawn: list[int], width_mm: float, height_mm: float
) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            color=colour(ROLES[k % len(ROLES)]),
            marker=MARKERS[k % len(MARKERS)],
            markersize=3.4,
            linewidth=1.0,
            label=plain(layers[k] or "no layer", LABEL_LENGTH),
        )
        for k in drawn
    ]
    if len(drawn) > 1:
        figure.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(0.005, 0.2 / height_mm),
            ncols=min(len(handles), 6),
            borderaxespad=0.0,
        )
    note = "filled: determined; open: not determined; cross: fixed"
    figure.text(1.0 - 1.0 / width_mm, 1.6 / height_mm, note, ha="right", color="0.35", fontsize=7.0)
