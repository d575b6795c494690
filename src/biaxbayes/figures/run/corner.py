"""The joint posterior at a glance: every pair of quantities, every quantity alone, of several runs.

Regions are drawn by the corner package (:mod:`.regions`); ranges end at physical edges. A table of
medians and intervals stands in the corner that the panels leave free, as much of it as fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.integrate import trapezoid

from biaxbayes.errors import InputError
from biaxbayes.figures.labels import POINT_MM, few_ticks, shortened, text_mm
from biaxbayes.figures.quantities import MEAN, AxisText, corner_columns, number, range_text
from biaxbayes.figures.run.regions import CONTENTS, FILL, Moved, moved, regions
from biaxbayes.figures.style import (
    MM,
    PAGE_MM,
    RUNS,
    blank_figure,
    colour,
    font_points,
    layout,
    plain,
    print_style,
    settle,
)
from biaxbayes.identifiability.bounded_density import Span, at_edges, curve, interval, span
from biaxbayes.options import CONTENT
from biaxbayes.parameters import Quantities, mounting_names
from biaxbayes.prediction.bands import evenly_chosen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

VISIBLE = 40_000
"""Draws of a quantity that are drawn; more would change nothing to the eye."""
WIDE_SPREAD = 8.0
"""Ratio of the 99.5 % to the 0.5 % point from which a scale gets a logarithmic axis."""
PANEL_MM, LEAST_PANEL_MM = 46.0, 8.0
"""Largest height of a panel, for few quantities, and the smallest width that can be read."""
MARGIN_MM, NARROW_MM = 16.0, 120.0
"""Room for the labels; width below which symbol and unit stand one above the other."""
DASHES = (0, (3, 2))


class Column(NamedTuple):
    """One quantity of the figure: its axis, and run by run its draws (None: not varied).

    ``draws`` are those that are drawn, ``every`` all of them; ``own`` is the axis of one run.
    """

    name: str
    quantity: AxisText
    axis: Span
    draws: list[np.ndarray | None]
    every: list[np.ndarray | None]
    own: list[Span | None]


class Interval(NamedTuple):
    """Median and interval of one quantity in one run; ``piled`` at its low or high end."""

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


def corner_figure(
    draws: pd.DataFrame,
    *,
    truth: Mapping[str, float] | None = None,
    compare: pd.DataFrame | None = None,
    names: tuple[str, str] = ("this run", "compared"),
    parameters: Sequence[str] | None = None,
    probability: float = CONTENT,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
    known: Quantities | None = None,
) -> Figure:
    """Pairwise and marginal posterior of the material parameters and mounting stretches.

    Parameters
    ----------
    draws : DataFrame
        One row a draw, columns as in ``summary.csv``. Constant columns are left out.
    truth : mapping, optional
        Known values by the same names, drawn as dashed lines.
    compare : DataFrame, optional
        Draws of another run, drawn as outlines.
    names : (str, str)
        Of the run and of the compared one, for the legend.
    parameters : sequence of str, optional
        The quantities to draw; all by default.
    probability : float
        Content of the shaded interval of each quantity: central, or one-sided where the draws
        pile up at a physical edge.
    width_mm : float
        Width in print.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    known : Quantities, optional
        What each name is, where it is not the default law with one mounted state.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If nothing varies, a parameter is not there, or the panels do not fit the width.
    """
    runs = [draws] if compare is None else [draws, compare]
    truth = {k: float(v) for k, v in (truth or {}).items() if np.isfinite(v)}
    fixed = [
        {str(n): float(run[n].iloc[0]) for n in run.select_dtypes("number") if not np.ptp(run[n])}
        for run in runs
    ]
    columns = _columns(runs, parameters, seen=[truth, *fixed], shared=True, known=known)
    # What the run itself does not vary is no quantity of its figure.
    columns = [c for c in columns if c.draws[0] is not None]
    if not columns:
        raise InputError("no parameter of this run varies, so there is nothing to draw")
    with print_style(style):
        figure, grid = _panels(columns, width_mm)
        for run in range(len(runs)):
            _pairs(grid, columns, run, filled=run == 0)
        intervals = [
            _marginal(grid[i, i], column, fixed, probability) for i, column in enumerate(columns)
        ]
        true_values = [truth.get(c.name) for c in columns]
        for i, value in enumerate(true_values):
            if value is None:
                continue
            for ax in grid[i:, i]:
                ax.axvline(value, color="black", linewidth=0.7, linestyle=DASHES)
            for ax in grid[i, :i]:
                ax.axhline(value, color="black", linewidth=0.7, linestyle=DASHES)
        _settle(figure, grid)
        labels = names if compare is not None else None
        _table(figure, columns, intervals, true_values, labels, probability)
    return figure


def overlay_figure(
    runs: Sequence[pd.DataFrame],
    labels: Sequence[str],
    *,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
    known: Quantities | None = None,
) -> Figure:
    """Pairwise and marginal posteriors of several runs.

    The filled region holds 50 %, the outline 90 % of a run's draws. Each run is smoothed on the
    range of its own draws, so that a narrow one stays narrow beside a wide one.

    Parameters
    ----------
    runs : sequence of DataFrame
        At most six.
    labels : sequence of str
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    known : Quantities, optional
        What each name is, where it is not the default law with one mounted state.

    Raises
    ------
    InputError
        If there are more than six runs, nothing varies, or the panels do not fit the width.
    """
    if len(runs) > len(RUNS):
        raise InputError(f"an overlay of {len(runs)} runs cannot be read; give six or fewer")
    columns = _columns(runs, known=known)
    if not columns:
        raise InputError("no parameter of these runs varies, so there is nothing to draw")
    with print_style(style):
        figure, grid = _panels(columns, width_mm)
        for run in range(len(runs)):
            _pairs(grid, columns, run, filled=None)
        for i, column in enumerate(columns):
            for run, (values, axis) in enumerate(zip(column.draws, column.own, strict=True)):
                if values is None or axis is None:
                    continue
                # All of the same height: widths are what is compared.
                x, height = curve(values, axis)
                hue = colour(RUNS[run])
                grid[i, i].plot(x, height / height.max(), color=hue, linewidth=0.9)
                grid[i, i].fill_between(x, height / height.max(), color=hue, alpha=FILL, lw=0.0)
            grid[i, i].set_ylim(0.0, 1.08)
        _settle(figure, grid)
        _legend(figure, labels)
    return figure


# --- draws into panels ---------------------------------------------------------------------------


def _columns(
    runs: Sequence[pd.DataFrame],
    parameters: Sequence[str] | None = None,
    *,
    seen: Sequence[Mapping[str, float]] = (),
    shared: bool = False,
    known: Quantities | None = None,
) -> list[Column]:
    """The quantities in the order of the first run that has them, with the values to be seen."""
    picked = [corner_columns(run, known) for run in runs]
    drawn = [evenly_chosen(len(run), VISIBLE) for run in runs]
    names = list(dict.fromkeys(name for columns in picked for name in columns))
    for name in parameters or ():
        if name not in names:
            raise InputError(
                f"no quantity {name[:40]!r} varies in this run",
                remedy=f"choose from {', '.join(names)}",
            )
    out = []
    for name in names if parameters is None else [n for n in names if n in parameters]:
        q = next(columns[name][0] for columns in picked if name in columns)
        every = [columns[name][1] if name in columns else None for columns in picked]
        draws = [None if v is None else v[at] for v, at in zip(every, drawn, strict=True)]
        present = [d for d in draws if d is not None]
        include = tuple(values[name] for values in seen if name in values)
        axis = axis_span(q, *present, include=include)
        own = [None if d is None else span(d, edges=q.edges, log=axis.log) for d in draws]
        out.append(Column(name, q, axis, draws, every, own))
    return out


def axis_span(q: AxisText, *draws: np.ndarray, include: tuple[float, ...] = ()) -> Span:
    """Axis of a quantity: logarithmic where a scale spreads widely.

    Parameters
    ----------
    q : AxisText
    *draws : ndarray, shape (n,)
        Of one or more runs.
    include : tuple of float
        Values that must be visible.
    """
    low, high = np.quantile(np.concatenate(draws), [0.005, 0.995])
    log = bool(q.scale and low > 0.0 and high > WIDE_SPREAD * low)
    return span(*draws, edges=q.edges, log=log, include=include)


def _pairs(grid: np.ndarray, columns: list[Column], run: int, *, filled: bool | None) -> None:
    """Regions of one run in the panels of the pairs that it has."""
    pairs: list[Moved | None] = []
    for i, column in enumerate(columns):
        draws, axis = column.draws[run], column.own[run]
        pairs.append(None if draws is None or axis is None else moved(draws, axis))
        for j, across in enumerate(pairs[:i]):
            up = pairs[i]
            if across is not None and up is not None:
                regions(grid[i, j], (across, up), colour(RUNS[run]), filled=filled)


def _marginal(
    ax: Axes, column: Column, fixed: Sequence[Mapping[str, float]], probability: float
) -> list[Interval | None]:
    """Density of every run, with the interval of the first shaded; medians and intervals."""
    intervals: list[Interval | None] = []
    top = 0.0
    for run, (values, axis, every) in enumerate(
        zip(column.draws, column.own, column.every, strict=True)
    ):
        hue = colour(RUNS[run])
        if values is None or axis is None or every is None:
            at = fixed[run].get(column.name)
            if at is not None:
                ax.axvline(at, color=hue, linewidth=0.9)
            intervals.append(None if at is None else Interval(at, at, at, (False, False)))
            continue
        x, density = curve(values, axis)
        piled = at_edges(density, axis)
        low, high = interval(every, piled, probability)
        density = density / trapezoid(density, column.axis.forward(x))
        ax.plot(x, density, color=hue, linewidth=0.9)
        if run == 0:
            inside = list((x >= low) & (x <= high))
            ax.fill_between(x, density, where=inside, color=hue, alpha=0.3, linewidth=0.0)
        top = max(top, float(density.max()))
        intervals.append(Interval(float(np.median(every)), low, high, piled))
    ax.set_ylim(0.0, 1.08 * top)
    return intervals


# --- places and labels ---------------------------------------------------------------------------


def _panels(columns: list[Column], width_mm: float) -> tuple[Figure, np.ndarray]:
    """Panels of a lower triangle with their ranges and labels."""
    count, narrow = len(columns), width_mm < NARROW_MM
    if (width_mm - MARGIN_MM) / count < LEAST_PANEL_MM:
        raise InputError(
            f"{count} quantities do not fit a width of {width_mm:g} mm",
            remedy="name fewer with `parameters`, or choose `width_mm=180`",
        )
    height = min(width_mm, count * PANEL_MM + MARGIN_MM)
    figure = blank_figure(width_mm * MM, height * MM, layout(across_mm=0.5, down_mm=0.5))
    places = figure.add_gridspec(count, count)
    grid = np.full((count, count), None, dtype=object)
    labels = [c.quantity.label for c in columns]
    if narrow:
        labels = [label.replace(" (", "\n(") for label in labels]
    for i, j in np.argwhere(np.tri(count)).tolist():
        grid[i, j] = ax = figure.add_subplot(places[i, j])
        _show(ax, columns[j].axis, "x", label=labels[j] if i == count - 1 else "")
        if i == j:
            ax.set_yticks([])
            ax.spines["left"].set_visible(False)
        else:
            _show(ax, columns[i].axis, "y", label=labels[i] if j == 0 else "")
    return figure, grid


def _show(ax: Axes, shown: Span, which: str, *, label: str) -> None:
    """Range and ticks of an axis; numbers and a label at the outer panels only."""
    if shown.log:
        ax.set(**{f"{which}scale": "log"})
    ax.set(**{f"{which}lim": (shown.low, shown.high), f"{which}label": label})
    few_ticks(getattr(ax, f"{which}axis"), overhang=0.3)
    if not label:
        ax.tick_params(axis=which, labelbottom=False, labelleft=False)  # type: ignore[arg-type]


def _settle(figure: Figure, grid: np.ndarray) -> None:
    """Lay the panels out; numbers that do not fit side by side are turned."""
    figure.align_labels()
    figure.draw_without_rendering()
    if any(len(ax.get_xticks()) < 2 for ax in grid[-1]):
        for ax in grid[-1]:
            few_ticks(ax.xaxis, overhang=0.3, upright=True)
    settle(figure)


def _table(
    figure: Figure,
    columns: list[Column],
    intervals: list[list[Interval | None]],
    truth: list[float | None],
    names: tuple[str, str] | None,
    probability: float,
) -> None:
    """Medians and intervals at the upper right: as many columns and notes as have room."""
    size = font_points("legend.fontsize")
    line, gap, margin = 1.35 * size * POINT_MM, 2.0, 2.0
    width, height = (side / MM for side in figure.get_size_inches())

    def room(rows: float) -> float:
        """Width at the right edge that no panel covers down to so many rows, mm."""
        depth = margin + rows * line
        above = [p for ax in figure.axes if (1.0 - (p := ax.get_position()).y1) * height < depth]
        return (1.0 - max((p.x1 for p in above), default=0.0)) * width - 2.0 * margin

    def write(x: float, row: float, text: str, hue: str) -> None:
        place = 1.0 - (margin + x) / width, 1.0 - (margin + row * line) / height
        figure.text(*place, text, fontsize=size, color=hue, ha="right", va="baseline")

    # in the order in which they are left out: the last first
    table: list[tuple[list[str], str]] = [(["", *(c.quantity.label for c in columns)], "black")]
    for run in range(len(intervals[0])):
        blank = ["", ""]
        cells = [
            blank if (v := row[run]) is None else v.cells(log=column.axis.log)
            for row, column in zip(intervals, columns, strict=True)
        ]
        hue = colour(RUNS[run])
        table.append(([f"{100 * probability:g} %", *(c[1] for c in cells)], hue))
        table.append((["median", *(c[0] for c in cells)], hue))
    if any(v is not None for v in truth):
        told = ["" if v is None else f"{v:.5g}" for v in truth]
        table.insert(3, (["truth", *told], "black"))
    widths = [max(text_mm(t, size) for t in texts) + gap for texts, _ in table]
    while len(table) > 1 and sum(widths[: len(table)]) > room(len(columns) + 1):
        table.pop()
    down = 1.0
    if len(table) > 1:
        right = 0.0
        for k in reversed([0, *sorted(range(1, len(table)), key=lambda k: k - 2 * (k % 2 == 0))]):
            for row, text in enumerate(table[k][0]):
                write(right, row + 1.0, text, table[k][1])
            right += widths[k]
        down += len(columns) + 1.4
    for note, hue in _notes(columns, names, any(v is not None for v in truth)):
        if text_mm(note, size) <= room(down + 0.2):
            write(0.0, down, note, hue)
            down += 1.0


def _notes(
    columns: list[Column], names: tuple[str, str] | None, truth: bool
) -> list[tuple[str, str]]:
    """What the regions and lines are, each with its colour."""
    notes = [(f"regions: {', '.join(f'{100 * c:g}' for c in CONTENTS)} % of the draws", "0.3")]
    if names is not None:
        size = font_points("legend.fontsize")
        notes = [(shortened(names[0], 32.0, size), colour(RUNS[0])), *notes]
        notes.append((f"outlines, 90 %: {shortened(names[1], 24.0, size)}", colour(RUNS[1])))
    if any(c.name in mounting_names("stretch") for c in columns):
        notes.append(("all within the law", "0.3"))
    if truth:
        notes.append(("dashed: truth", "0.3"))
    if any(MEAN in c.quantity.symbol for c in columns):
        notes.append(("bar: mean over protocols", "0.3"))
    return notes


def _legend(figure: Figure, labels: Sequence[str]) -> None:
    from matplotlib.patches import Patch

    hues = [colour(RUNS[run]) for run in range(len(labels))]
    figure.legend(
        [Patch(facecolor=(hue, FILL), edgecolor=hue, linewidth=0.9) for hue in hues],
        [plain(label, 24) for label in labels],
        loc="upper right",
        title="filled 50 %, outline 90 % of the draws, within the law",
        alignment="left",
    )
