"""Panels of intervals with common rows, as in the figures of comparisons, studies, populations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from biaxbayes.figures.style import RUNS, add_note, blank_figure, colour, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

COLUMNS = 4
LABEL_LENGTH, LEAST_LABEL_MM = 18, 2.6
"""Characters of a label, and the least distance of rows that are labelled one by one."""
LOG_SPREAD = 8.0
"""Ratio of the ends above which a positive scale gets a logarithmic axis."""
MARKERS = ("o", "s", "^", "D", "v", "P")


def panel_rows(
    count: int,
    tall_mm: float,
    places: Sequence[float],
    labels: Sequence[str],
    width_mm: float,
    note: str,
) -> tuple[Figure, list[Axes]]:
    """A figure of equal panels, four in a row, with labelled rows and a note at its foot."""
    lines = max(-(-count // COLUMNS), 1)
    figure = blank_figure(width_mm, lines * (tall_mm + 13.0) + 7.0)
    panels = figure.subplots(lines, COLUMNS, squeeze=False)
    for ax in panels.flat[count:]:
        ax.remove()
    for ax in panels.flat[:count]:
        ax.set_yticks(places, labels)
        ax.tick_params(axis="y", length=0.0, labelleft=ax.get_subplotspec().is_first_col())
        ax.spines["left"].set_visible(False)
    add_note(figure, note)
    return figure, list(panels.flat[:count])


def group_colour(k: int) -> str:
    """Colour of the k-th group, layer or run."""
    return colour(RUNS[k % len(RUNS)])


def group_marker(k: int) -> str:
    """Marker of the k-th group or layer."""
    return MARKERS[k % len(MARKERS)]


def group_handle(k: int, label: str, note: str = "") -> Line2D:
    """Entry of the k-th group or layer in a legend."""
    from matplotlib.lines import Line2D

    return Line2D(
        [],
        [],
        color=group_colour(k),
        marker=group_marker(k),
        markersize=3.4,
        linewidth=1.0,
        label=plain(label, LABEL_LENGTH) + note,
    )
