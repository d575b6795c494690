"""A table of coloured cells with texts, as in the matrix of verdicts and the design."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.figures.style import font_points, text_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_cells(
    ax: Axes,
    texts: Sequence[Sequence[str]],
    colours: Sequence[Sequence[str]],
    *,
    rows: Sequence[str],
    columns: Sequence[str],
) -> None:
    """Fill an axes with cells, a label at the left of each row and above each column."""
    from matplotlib.colors import to_rgb

    image = np.array([[to_rgb(face) for face in row] for row in colours])
    ax.imshow(image, aspect="auto", interpolation="nearest")
    for i, line in enumerate(texts):
        for j, text in enumerate(line):
            ax.text(
                j,
                i,
                text,
                ha="center",
                va="center",
                color=text_colour(colours[i][j]),
                fontsize=font_points("legend.fontsize"),
                linespacing=1.1,
            )
    ax.set_yticks(range(len(rows)), rows)
    ax.set_xticks(range(len(columns)), columns)
    ax.xaxis.tick_top()
    ax.set_xticks(np.arange(len(columns) - 1) + 0.5, minor=True)
    ax.set_yticks(np.arange(len(rows) - 1) + 0.5, minor=True)
    ax.grid(which="minor", color="white", linewidth=1.5)
    ax.tick_params(which="both", length=0.0)
    ax.spines[:].set_visible(False)
