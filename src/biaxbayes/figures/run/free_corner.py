"""The table in the corner that the panels of a figure leave free: as much of it as has room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from biaxbayes.figures.labels import POINT_MM, number, range_text, shortened, text_mm
from biaxbayes.figures.quantities import MEAN, AxisText
from biaxbayes.figures.run.regions import CONTENTS
from biaxbayes.figures.style import MM, RUNS, colour, font_points
from biaxbayes.identifiability.bounded_density import Span
from biaxbayes.parameters import mounting_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["NARROW_MM", "Column", "Found", "tabulate"]

NARROW_MM = 120.0
"""Below this width symbol and unit stand one above the other."""
MOST_NAME_MM = 32.0
"""Width of the name of a run in the table."""


class Column(NamedTuple):
    """One quantity of the figure: its axis, and run by run its draws (None: not varied).

    Those that are drawn, and all, which the table in the corner tells the numbers of.
    """

    name: str
    quantity: AxisText
    axis: Span
    draws: list[np.ndarray | None]
    every: list[np.ndarray | None]
    own: list[Span | None]


class Found(NamedTuple):
    """Median and interval of one quantity in one run."""

    median: float
    low: float
    high: float
    piled: tuple[bool, bool]

    def cells(self, *, log: bool) -> list[str]:
        """As two cells of the table."""
        if self.low == self.high:
            return [f"{self.median:.4g}", "fixed"]
        median = number(self.median, self.low, self.high, log=log)
        return [median, range_text(self.low, self.high, self.piled, log=log)]


def tabulate(
    figure: Figure,
    columns: list[Column],
    rows: list[list[Found | None]],
    truth: list[float | None],
    names: tuple[str, str] | None,
    probability: float,
    width_mm: float,
) -> None:
    """Medians and intervals; the headings are the legend."""
    wide, size = width_mm >= NARROW_MM, font_points("legend.fontsize")
    content = f"{100 * probability:g} %"
    headings = []
    for run in range(len(rows[0])):
        hue = colour(RUNS[run])
        name = "" if names is None else shortened(names[run], MOST_NAME_MM, size)
        head = f"{content} interval" if wide and names is None else content
        headings += [
            Heading("median", 3 * run + 1, hue, name),
            Heading(head, 3 * run, hue, name),
        ]
    known = any(v is not None for v in truth)
    if known:
        headings.append(Heading("truth", 2))
    table = []
    for column, found, value in zip(columns, rows, truth, strict=True):
        q = column.quantity
        cells = [q.label if wide else q.symbol]
        for one in found:
            cells += ["", ""] if one is None else one.cells(log=column.axis.log)
        table.append([*cells, "" if value is None else f"{value:.5g}"][: len(headings) + 1])
    notes = [(f"regions: {', '.join(f'{100 * c:g}' for c in CONTENTS)} % of the draws", "0.3")]
    if any(c.name in mounting_names("stretch") for c in columns):
        notes.append(("all within the law", "0.3"))
    if names is not None:
        other = shortened(names[1], MOST_NAME_MM if wide else 18.0, size)
        notes.append((f"outlines: {other}{', 90 %' if wide else ''}", colour(RUNS[1])))
    if known:
        notes.append(("dashed: truth", "0.3"))
    if any(MEAN in c.quantity.symbol for c in columns):
        notes.append(("bar: mean over protocols" if wide else "bar: mean", "0.3"))
    write_table(figure, headings, table, notes, 1.45 if wide else 1.25)


class Heading(NamedTuple):
    """A column of the table; columns of high rank are left out first where there is no room."""

    text: str
    rank: int
    colour: str = "black"
    run: str = ""


def write_table(
    figure: Figure,
    headings: list[Heading],
    table: list[list[str]],
    notes: list[tuple[str, str]],
    spacing: float,
) -> None:
    """Write as many columns, and below them as many notes, as the free corner holds.

    Where there are several runs, the name of each stands above its columns, over a rule.
    """
    size = font_points("legend.fontsize")
    line, gap = spacing * size * POINT_MM, 0.9 * size * POINT_MM
    width, height = (side / MM for side in figure.get_size_inches())
    margin = 2.0

    def free(depth: float) -> float:
        """Width at the right edge that no panel covers down to a depth, mm."""
        above = [ax.bbox for ax in figure.axes if height - ax.bbox.y1 / figure.dpi / MM < depth]
        covered = max((box.x1 for box in above), default=0.0) / figure.dpi / MM
        return width - covered - 2.0 * margin

    def write(x: float, y: float, text: str, **how: Any) -> None:
        place = 1.0 - (x + margin) / width, 1.0 - (y + margin) / height
        figure.text(*place, text, fontsize=size, va="baseline", **how)

    symbols = max(text_mm(cells[0], size) for cells in table)
    lines = [[h.text for h in headings], *(cells[1:] for cells in table)]
    widths = [max(text_mm(texts[k], size) for texts in lines) for k in range(len(headings))]
    first = 1.2 * line if any(h.run for h in headings) else 0.0  # height of the runs' names
    room = free(margin + first + line * len(lines))
    order = sorted(range(len(headings)), key=lambda k: headings[k].rank)
    while order and symbols + sum(_spread(headings, widths, order, gap)) > room:
        order.pop()
    if not order:
        return
    right = 0.0
    for k, across in sorted(
        zip(order, _spread(headings, widths, order, gap), strict=True), reverse=True
    ):
        head = headings[k]
        if head.run and not any(j > k and headings[j].run == head.run for j in order):
            own = [j for j in order if headings[j].run == head.run]
            wide = max(sum(widths[j] + gap for j in own) - gap, text_mm(head.run, size))
            write(right, 0.8 * line, head.run, color=head.colour, ha="right")
            _rule(figure, (right + margin, margin + 1.15 * line, wide), head.colour)
        for row, texts in enumerate(lines):
            write(right, first + line * (row + 0.8), texts[k], color=head.colour, ha="right")
        right += across
    for row, cells in enumerate(table):
        write(right + symbols, first + line * (row + 1.8), cells[0])
    down = first + line * (len(lines) + 1.4)
    for note, hue in notes:
        if text_mm(note, size) <= free(margin + down + 0.2 * line):
            write(0.0, down, note, color=hue, ha="right")
            down += line


def _spread(
    headings: Sequence[Heading], widths: Sequence[float], order: Sequence[int], gap: float
) -> list[float]:
    """Width of each chosen column with its gap, mm; the first of a run makes room for its name."""
    size, out = font_points("legend.fontsize"), []
    for k in order:
        own = [j for j in order if headings[j].run and headings[j].run == headings[k].run]
        taken = sum(widths[j] + gap for j in own)
        spare = text_mm(headings[k].run, size) + gap - taken if own and k == min(own) else 0.0
        out.append(widths[k] + gap + max(spare, 0.0))
    return out


def _rule(figure: Figure, place: tuple[float, float, float], hue: str) -> None:
    """A thin line: distance of its right end from the right edge and from the top, length; mm."""
    from matplotlib.lines import Line2D

    width, height = (side / MM for side in figure.get_size_inches())
    right, down, length = place
    ends = [1.0 - (right + length) / width, 1.0 - right / width]
    figure.add_artist(Line2D(ends, [1.0 - down / height] * 2, color=hue, linewidth=0.6))
