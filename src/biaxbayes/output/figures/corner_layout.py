"""Where the panels of a corner figure stand, and the table in its free corner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.findings.bounded_density import Span
from biaxbayes.output.figures.lettering import POINT_MM, text_width
from biaxbayes.output.figures.ticks import Ticks, choose_ticks, set_ticks
from biaxbayes.output.style import MM, font_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Entry", "Grid", "Heading", "write_table"]

PANEL_MM = 46.0
"""Largest panel, for few quantities."""
GAP = 0.09
"""Space between panels, as a share of a panel."""
NARROW_MM = 120.0
"""Below this width symbol and unit stand one above the other."""


class Grid:
    """Panels of a lower triangle at exact places, so that the width in print is exact.

    Parameters
    ----------
    spans : sequence of Span
        One a quantity.
    labels : sequence of (str, str)
        Symbol and unit of each.
    width_mm : float

    Attributes
    ----------
    figure : Figure
    axes : list of list of Axes
        ``axes[i][j]`` shows quantity j across and i up, j <= i.
    """

    def __init__(
        self, spans: Sequence[Span], labels: Sequence[tuple[str, str]], width_mm: float
    ) -> None:
        from matplotlib.figure import Figure

        self.width_mm = width_mm
        self.count = len(spans)
        self.points = font_points("axes.labelsize")
        self._spans, narrow = spans, width_mm < NARROW_MM
        self._labels = [
            s if not unit else f"{s}\n({unit})" if narrow else f"{s} ({unit})" for s, unit in labels
        ]
        lines = 2.0 if narrow and any(unit for _, unit in labels) else 1.0
        name = (1.35 * lines + 0.3) * self.points * POINT_MM
        self.left, self.bottom, self.margin = 14.0, 10.0, 2.5
        for _ in range(3):  # margins depend on the tick labels, and these on the panels' size
            self._fit_panels()
            self._choose()
            self.left = name + max((t.extent for t in self._up[1:]), default=-name) + 3.2
            self.bottom = name + max(t.extent for t in self._across) + 3.0
        self._fit_panels()
        height = self.bottom + self.used + self.margin
        self.height_mm = height
        self.figure: Figure = Figure((width_mm * MM, height * MM))
        self.axes = [[self._panel(i, j) for j in range(i + 1)] for i in range(self.count)]

    def _fit_panels(self) -> None:
        panels = self.count + GAP * (self.count - 1)
        self.side = min((self.width_mm - self.left - self.margin) / panels, PANEL_MM)
        self.used = self.side * panels

    def _choose(self) -> None:
        overhang = 0.4 * GAP * self.side
        sizes = [font_points(f"{axis}tick.labelsize") for axis in "xy"]
        self._across, self._up = (
            [
                choose_ticks(s, self.side, size, horizontal=across, overhang=overhang)
                for s in self._spans
            ]
            for size, across in zip(sizes, (True, False), strict=True)
        )

    def _panel(self, i: int, j: int) -> Axes:
        x, y = self._corner(i, j)
        return self.figure.add_axes(
            (
                x / self.width_mm,
                y / self.height_mm,
                self.side / self.width_mm,
                self.side / self.height_mm,
            )
        )

    def _corner(self, i: int, j: int) -> tuple[float, float]:
        """Lower left corner of a panel, mm."""
        step = self.side * (1.0 + GAP)
        return self.left + j * step, self.bottom + (self.count - 1 - i) * step

    def free_width(self, depth: float) -> float:
        """Width at the right edge that no panel covers down to a depth below the top, mm."""
        rows = int(np.ceil(max(depth - self.margin, 0.0) / (self.side * (1.0 + GAP))))
        rows = min(max(rows, 1), self.count)
        return self.width_mm - self._corner(0, rows - 1)[0] - self.side - 1.5 * self.margin

    def finish(self) -> None:
        """Set ranges, ticks and labels, the same way in all panels."""
        last = self.count - 1
        for i, row in enumerate(self.axes):
            for j, ax in enumerate(row):
                _show(ax, self._spans[j], "x", self._across[j], labels=i == last)
                if i == last:
                    ax.set_xlabel(self._labels[j])
                    self._place_label(ax, self._across, "x")
                if i == j:
                    continue
                _show(ax, self._spans[i], "y", self._up[i], labels=j == 0)
                if j == 0:
                    ax.set_ylabel(self._labels[i], linespacing=1.1)
                    self._place_label(ax, self._up[1:], "y")

    def _place_label(self, ax: Axes, ticks: list[Ticks], which: str) -> None:
        away = -(max(t.extent for t in ticks) + 2.9) / self.side
        if which == "x":
            ax.xaxis.set_label_coords(0.5, away)
        else:
            ax.yaxis.set_label_coords(away, 0.5)

    def write(self, x: float, y: float, text: str, **how: Any) -> None:
        """Write text at a place in mm from the upper right corner inside the margins."""
        self.figure.text(
            1.0 - (x + self.margin) / self.width_mm,
            1.0 - (y + self.margin) / self.height_mm,
            text,
            verticalalignment="baseline",
            **how,
        )


def _show(ax: Axes, span: Span, which: str, ticks: Ticks, *, labels: bool) -> None:
    if span.log:
        ax.set(**{f"{which}scale": "log"})
    ax.set(**{f"{which}lim": (span.low, span.high)})
    set_ticks(getattr(ax, f"{which}axis"), ticks, labels=labels)


@dataclass(frozen=True)
class Heading:
    """A column of the table.

    Attributes
    ----------
    text : str
    rank : int
        Columns of high rank are left out first where there is no room.
    colour : str
        That of the run.
    """

    text: str
    rank: int
    colour: str = "black"


@dataclass(frozen=True)
class Entry:
    """A row of the table: a quantity and one cell a heading."""

    symbol: str
    cells: tuple[str, ...]


def write_table(
    grid: Grid,
    headings: Sequence[Heading],
    entries: Sequence[Entry],
    notes: Sequence[tuple[str, str]],
) -> None:
    """Write as many columns of a table as the free corner holds, and the notes below it.

    Parameters
    ----------
    grid : Grid
    headings, entries : sequence
    notes : sequence of (str, str)
        Text and colour; those that do not fit are left out.
    """
    size = font_points("legend.fontsize")
    spacing = 1.45 if grid.width_mm >= NARROW_MM else 1.25
    line, gap = spacing * size * POINT_MM, 0.9 * size * POINT_MM
    symbols = max(_symbol_width(e.symbol, size) for e in entries)
    widths = [
        max(text_width(t, size) for t in (h.text, *(e.cells[k] for e in entries)))
        for k, h in enumerate(headings)
    ]
    free = grid.free_width(grid.margin + line * (1 + len(entries)))
    order = sorted(range(len(headings)), key=lambda k: headings[k].rank)
    while order and symbols + sum(widths[k] + gap for k in order) > free:
        order.pop()
    if not order:
        return
    right = 0.0
    for k in sorted(order, reverse=True):
        how: Any = {"fontsize": size, "color": headings[k].colour, "horizontalalignment": "right"}
        for row, text in enumerate((headings[k].text, *(e.cells[k] for e in entries))):
            grid.write(right, line * (row + 0.8), text, **how)
        right += widths[k] + gap
    for row, entry in enumerate(entries):
        left = right + symbols
        grid.write(left, line * (row + 1.8), entry.symbol, fontsize=size)
    down = line * (len(entries) + 2.4)
    for note, hue in notes:
        if text_width(note, size) <= grid.free_width(grid.margin + down + 0.2 * line):
            grid.write(0.0, down, note, fontsize=size, horizontalalignment="right", color=hue)
            down += line


def _symbol_width(symbol: str, points: float) -> float:
    """Width of a symbol in mathematical text with its unit, mm."""
    mathematics, _, unit = symbol.rpartition("$")
    return text_width(unit, points) + (3.0 if "lambda" in mathematics else 1.6) * points * POINT_MM
