"""Parts of several figures: panels of intervals with common rows, coloured cells, bands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from biaxbayes.figures import style
from biaxbayes.identifiability.bounded_density import Span

PANELS_PER_LINE = 4
LABEL_LENGTH, MIN_LABEL_MM = 18, 2.6
"""Characters of a label, and the least distance of rows that are labelled singly."""
GROUP_MARKERS = ("o", "s", "^", "D", "v", "P")


def row_panels(
    count: int, tall_mm: float, positions: Sequence[float], labels: Sequence[str], note: str
) -> tuple[Figure, list[Axes]]:
    """A figure of equal panels, four per line, with labelled rows and a note at its foot."""
    lines = max(-(-count // PANELS_PER_LINE), 1)
    figure = style.blank_figure(style.PAGE_MM, lines * (tall_mm + 13.0) + 7.0)
    panels = figure.subplots(lines, PANELS_PER_LINE, squeeze=False)
    for ax in panels.flat[count:]:
        ax.remove()
    for ax in panels.flat[:count]:
        ax.set_yticks(positions, labels)
        ax.tick_params(axis="y", length=0.0, labelleft=ax.get_subplotspec().is_first_col())
        ax.spines["left"].set_visible(False)
    style.add_note(figure, note)
    return figure, list(panels.flat[:count])


def set_panel(ax: Axes, axis: Span, label: str, rows: int) -> None:
    """Range, scale and label of a panel whose rows are counted from the top."""
    ax.set(ylim=(rows - 0.4, -0.6), xscale="log" if axis.log else "linear")
    ax.set(xlim=(axis.low, axis.high), xlabel=label)
    style.limit_ticks(ax.xaxis)


def group_look(k: int) -> tuple[str, str]:
    """Colour and marker of the k-th group, layer or run."""
    return style.colour(k), GROUP_MARKERS[k % len(GROUP_MARKERS)]


def draw_cells(
    ax: Axes,
    texts: Sequence[Sequence[str]],
    colours: Sequence[Sequence[str]],
    *,
    rows: Sequence[str],
    columns: Sequence[str],
) -> None:
    """Fill an axes with cells, a label at the left of each row and above each column."""
    image = np.array([[to_rgb(face) for face in row] for row in colours])
    ax.imshow(image, aspect="auto", interpolation="nearest")
    for (i, j), text in np.ndenumerate(np.array(texts, dtype=object)):
        text_style = style.small_text(ha="center", va="center", linespacing=1.1)
        ax.text(j, i, text, color=style.text_colour(colours[i][j]), **text_style)
    ax.set_yticks(range(len(rows)), rows)
    ax.set_xticks(range(len(columns)), columns)
    ax.xaxis.tick_top()
    ax.set_xticks(np.arange(len(columns) - 1) + 0.5, minor=True)
    ax.set_yticks(np.arange(len(rows) - 1) + 0.5, minor=True)
    ax.grid(which="minor", color="white", linewidth=1.5)
    ax.tick_params(which="both", length=0.0)
    ax.spines[:].set_visible(False)


def draw_bands(
    ax: Axes, along: np.ndarray, table: pd.DataFrame, stem: str, hue: str, *, upright: bool = True
) -> None:
    """Predictive and credible band of columns of a table, over or beside ``along``."""
    fill = ax.fill_between if upright else ax.fill_betweenx
    for kind, opacity in style.BAND_OPACITY.items():
        low, high = (table[f"{stem}{kind}_{end}"] for end in ("low", "high"))
        fill(along, low, high, color=hue, alpha=opacity, linewidth=0.0)


def band_handles(probability: float, words: str) -> list[Patch]:
    """Entries of a legend for both bands; ``words`` stand behind their kind."""
    return [
        Patch(fc="0.3", alpha=alpha, lw=0.0, label=f"{kind}{words}, {100 * probability:g} %")
        for kind, alpha in reversed(style.BAND_OPACITY.items())
    ]
