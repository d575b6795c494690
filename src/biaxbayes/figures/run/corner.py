"""The joint posterior of every pair of quantities and the density of each, of one or more runs.

Regions are drawn by the corner package (:mod:`.regions`); ranges end at physical edges.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.integrate import trapezoid

from biaxbayes.errors import InputError
from biaxbayes.figures.quantities import MEAN, AxisText, corner_columns, number, range_text
from biaxbayes.figures.run.regions import CONTENTS, FILL, project, regions
from biaxbayes.figures.style import (
    MM,
    PAGE_MM,
    RUNS,
    blank_figure,
    colour,
    few_ticks,
    font_points,
    plain,
    print_style,
    shortened,
    text_width_mm,
)
from biaxbayes.identifiability.bounded_density import Span, at_edges, curve, interval, span
from biaxbayes.options import CONTENT
from biaxbayes.parameters import Quantities

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOG_SPREAD = 8.0
"""Ratio of the 99.5 % to the 0.5 % point above which a positive scale gets a logarithmic axis."""
PANEL_MM, LEAST_PANEL_MM, TURNED_MM = 46.0, 8.0, 20.0
"""Largest height and smallest width of a panel; width below which tick labels are turned."""
MARGIN_MM, NARROW_MM = 16.0, 120.0
"""Space for the labels; width below which symbol and unit stand one above the other."""
DASHES = (0, (3, 2))
SMALL = "legend.fontsize"


class Column(NamedTuple):
    """A quantity of the figure: its axis, and of each run the draws (None: not varied) and axis."""

    name: str
    quantity: AxisText
    axis: Span
    draws: list[np.ndarray | None]
    own: list[Span | None]


class Interval(NamedTuple):
    """Median and interval of a quantity in a run; ``piled`` at its low or high end."""

    median: float
    low: float
    high: float
    piled: tuple[bool, bool] = (False, False)

    def texts(self, *, log: bool) -> tuple[str, str]:
        """Median and interval as in the table."""
        if self.low == self.high:
            return f"{self.median:.4g}", "fixed"
        median = number(self.median, self.low, self.high, log=log)
        return median, range_text(self.low, self.high, self.piled, log=log)


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
    law: str = "",
) -> Figure:
    """Pairwise and marginal posterior of the material parameters and mounting stretches.

    Parameters
    ----------
    draws : DataFrame
        One row per draw, columns as in ``summary.csv``. Constant columns are left out.
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
    law : str
        Name of the law of the run, for the legend.

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
    columns = _columns(runs, parameters, include=[truth, *fixed], known=known)
    # What the run itself does not vary is no quantity of its figure.
    columns = [c for c in columns if c.draws[0] is not None]
    if not columns:
        raise InputError("no parameter of this run varies, so there is nothing to draw")
    with print_style(style):
        figure, grid = _panels(columns, width_mm)
        for run in range(len(runs)):
            _draw_pairs(grid, columns, run, filled=run == 0)
        intervals = [
            _draw_marginal(grid[i, i], column, fixed, probability)
            for i, column in enumerate(columns)
        ]
        _set_ticks(grid, width_mm)
        true = {i: truth[c.name] for i, c in enumerate(columns) if c.name in truth}
        for i, value in true.items():
            for ax in grid[i:, i]:
                ax.axvline(value, color="black", linewidth=0.7, linestyle=DASHES)
            for ax in grid[i, :i]:
                ax.axhline(value, color="black", linewidth=0.7, linestyle=DASHES)
        notes = _notes(columns, names if compare is not None else None, truth=bool(true), law=law)
        _add_table(figure, columns, intervals, true, notes, probability)
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
    from matplotlib.patches import Patch

    if len(runs) > len(RUNS):
        raise InputError(f"an overlay of {len(runs)} runs cannot be read; give six or fewer")
    columns = _columns(runs, known=known)
    if not columns:
        raise InputError("no parameter of these runs varies, so there is nothing to draw")
    with print_style(style):
        figure, grid = _panels(columns, width_mm)
        handles = []
        for run, label in enumerate(labels):
            hue = colour(RUNS[run])
            _draw_pairs(grid, columns, run, filled=None)
            for ax, column in zip(grid.diagonal(), columns, strict=True):
                values, axis = column.draws[run], column.own[run]
                if values is None or axis is None:
                    continue
                # Every density has the same height, since widths are compared.
                x, density = curve(values, axis)
                ax.plot(x, density / density.max(), color=hue, linewidth=0.9)
                ax.fill_between(x, density / density.max(), color=hue, alpha=FILL, lw=0.0)
                ax.set_ylim(0.0, 1.08)
            face = (hue, FILL)
            handles.append(Patch(fc=face, ec=hue, linewidth=0.9, label=plain(label, 24)))
        _set_ticks(grid, width_mm)
        legend = figure.legend(
            handles=handles,
            loc="upper right",
            title="filled 50 %, outline 90 % of the draws, within the law",
            alignment="left",
        )
        legend.set_in_layout(False)
    return figure


def _columns(
    runs: Sequence[pd.DataFrame],
    parameters: Sequence[str] | None = None,
    *,
    include: Sequence[Mapping[str, float]] = (),
    known: Quantities | None = None,
) -> list[Column]:
    """The quantities in the order of the first run that has them; values to include in view."""
    by_run = [corner_columns(run, known) for run in runs]
    names = list(dict.fromkeys(name for columns in by_run for name in columns))
    for name in parameters or ():
        if name not in names:
            raise InputError(
                f"no quantity {name[:40]!r} varies in this run",
                remedy=f"choose from {', '.join(names)}",
            )
    result = []
    for name in names if parameters is None else [n for n in names if n in parameters]:
        q = next(columns[name][0] for columns in by_run if name in columns)
        draws = [columns[name][1] if name in columns else None for columns in by_run]
        values = tuple(v[name] for v in include if name in v)
        axis = axis_span(q, *(d for d in draws if d is not None), include=values)
        own = [None if d is None else span(d, edges=q.edges, log=axis.log) for d in draws]
        result.append(Column(name, q, axis, draws, own))
    return result


def axis_span(q: AxisText, *draws: np.ndarray, include: tuple[float, ...] = ()) -> Span:
    """Axis of a quantity: logarithmic where a scale spreads widely.

    Parameters
    ----------
    q : AxisText
    *draws : ndarray, shape (n,)
        Draws of one or more runs.
    include : tuple of float
        Values that must be visible.
    """
    low, high = np.quantile(np.concatenate(draws), [0.005, 0.995])
    log = bool(q.scale and low > 0.0 and high > LOG_SPREAD * low)
    return span(*draws, edges=q.edges, log=log, include=include)


def _panels(columns: list[Column], width_mm: float) -> tuple[Figure, np.ndarray]:
    """Panels of a lower triangle with their ranges and labels."""
    count = len(columns)
    panel_mm = (width_mm - MARGIN_MM) / count
    if panel_mm < LEAST_PANEL_MM:
        raise InputError(
            f"{count} quantities do not fit a width of {width_mm:g} mm",
            remedy="name fewer with `parameters`, or choose `width_mm=180`",
        )
    figure = blank_figure(width_mm, min(width_mm, count * PANEL_MM + MARGIN_MM))
    figure.get_layout_engine().set(w_pad=0.5 * MM, h_pad=0.5 * MM)  # type: ignore[union-attr,call-arg]
    places = figure.add_gridspec(count, count)
    grid = np.full((count, count), None, dtype=object)
    for i, j in np.argwhere(np.tri(count)).tolist():
        grid[i, j] = ax = figure.add_subplot(places[i, j])
        _set_axis(ax, "x", columns[j], width_mm, labelled=i == count - 1)
        if i == j:
            ax.set_yticks([])
            ax.spines["left"].set_visible(False)
        else:
            _set_axis(ax, "y", columns[i], width_mm, labelled=j == 0)
    figure.align_labels()
    return figure, grid


def _set_axis(ax: Axes, which: str, column: Column, width_mm: float, *, labelled: bool) -> None:
    """Range and ticks of an axis; numbers and a label at the outer panels only."""
    axis = column.axis
    ax.set(**{f"{which}scale": "log" if axis.log else "linear"})
    ax.set(**{f"{which}lim": (axis.low, axis.high)})
    if labelled:
        label = column.quantity.label
        text = label.replace(" (", "\n(") if width_mm < NARROW_MM else label
        ax.set(**{f"{which}label": text})
    else:
        ax.tick_params(axis=which, labelbottom=False, labelleft=False)  # type: ignore[arg-type]


def _draw_pairs(grid: np.ndarray, columns: list[Column], run: int, *, filled: bool | None) -> None:
    """Regions of a run in the panels of the pairs that it varies."""
    varied = {
        i: project(draws, axis)
        for i, column in enumerate(columns)
        if (draws := column.draws[run]) is not None and (axis := column.own[run]) is not None
    }
    for i, down in varied.items():
        for j, across in varied.items():
            if j < i:
                regions(grid[i, j], (across, down), colour(RUNS[run]), filled=filled)


def _set_ticks(grid: np.ndarray, width_mm: float) -> None:
    """Few ticks, after the corner package has set its own; first and last in narrow panels."""
    narrow = (width_mm - MARGIN_MM) / len(grid) < TURNED_MM
    for i, j in np.argwhere(np.tri(len(grid))).tolist():
        ax = grid[i, j]
        for axis in (ax.xaxis,) if i == j else (ax.xaxis, ax.yaxis):
            few_ticks(axis, 3)
            if narrow:
                low, high = axis.get_view_interval()
                ticks = [t for t in axis.get_majorticklocs() if low <= t <= high]
                axis.set_ticks([ticks[0], ticks[-1]])
        ax.tick_params(axis="x", labelrotation=90.0 if narrow else 0.0)


def _draw_marginal(
    ax: Axes, column: Column, fixed: Sequence[Mapping[str, float]], probability: float
) -> list[Interval | None]:
    """Density of every run, with the interval of the first shaded; medians and intervals."""
    intervals: list[Interval | None] = []
    top = 0.0
    for run, (values, axis) in enumerate(zip(column.draws, column.own, strict=True)):
        hue = colour(RUNS[run])
        if values is None or axis is None:
            value = fixed[run].get(column.name)
            if value is not None:
                ax.axvline(value, color=hue, linewidth=0.9)
            intervals.append(None if value is None else Interval(value, value, value))
            continue
        x, density = curve(values, axis)
        piled = at_edges(density, axis)
        low, high = interval(values, piled, probability)
        density = density / trapezoid(density, column.axis.forward(x))
        ax.plot(x, density, color=hue, linewidth=0.9)
        if run == 0:
            inside = list((x >= low) & (x <= high))
            ax.fill_between(x, density, where=inside, color=hue, alpha=0.3, linewidth=0.0)
        top = max(top, float(density.max()))
        intervals.append(Interval(float(np.median(values)), low, high, piled))
    ax.set_ylim(0.0, 1.08 * top)
    return intervals


def _notes(
    columns: list[Column], names: tuple[str, str] | None, *, truth: bool, law: str
) -> list[tuple[str, str]]:
    """What the regions and lines are, each with its colour."""
    notes = [(f"regions: {', '.join(f'{100 * c:g}' for c in CONTENTS)} % of the draws", "0.3")]
    if names is not None:
        first, second = (shortened(name, 28.0, "legend.fontsize") for name in names)
        notes.insert(0, (first, colour(RUNS[0])))
        notes.append((f"outlines, 90 %: {second}", colour(RUNS[1])))
    notes.insert(0, (f"posterior within {law or 'the law'}", "0.3"))
    if truth:
        notes.append(("dashed: truth", "0.3"))
    if any(MEAN in c.quantity.symbol for c in columns):
        notes.append(("bar: mean over protocols", "0.3"))
    return notes


def _add_table(
    figure: Figure,
    columns: list[Column],
    intervals: list[list[Interval | None]],
    truth: Mapping[int, float],
    notes: list[tuple[str, str]],
    probability: float,
) -> None:
    """Medians, intervals and notes at the upper right, as many as the panels leave space for."""
    line_mm = 1.35 * font_points(SMALL) / 72.0 / MM
    count = len(columns)
    width, height = (side / MM for side in figure.get_size_inches())
    pitch = (width - MARGIN_MM) / count, (height - MARGIN_MM) / count

    def free_mm(lines: float) -> float:
        """Width that is free of panels down to so many lines."""
        rows = math.ceil((lines * line_mm + 1.0) / pitch[1])
        return (count - rows) * pitch[0] - 2.0

    def write(x_mm: float, line: float, text: str, hue: str) -> None:
        figure.text(
            1.0 - (x_mm + 2.0) / width,
            1.0 - ((line + 1.0) * line_mm - 0.5) / height,
            text,
            fontsize=font_points(SMALL),
            color=hue,
            ha="right",
        )

    # position from the left, texts and colour, in the order in which they are given space
    candidates = [(0, ["", *(c.quantity.label for c in columns)], "black")]
    for run in range(len(intervals[0])):
        of_run = [row[run] for row in intervals]
        cells = [
            ("", "") if v is None else v.texts(log=c.axis.log)
            for v, c in zip(of_run, columns, strict=True)
        ]
        hue = colour(RUNS[run])
        candidates.append((2 * run + 2, [f"{100 * probability:g} %", *(c[1] for c in cells)], hue))
        candidates.append((2 * run + 1, ["median", *(c[0] for c in cells)], hue))
    if truth:
        values = (f"{truth[i]:.5g}" if i in truth else "" for i in range(count))
        candidates.insert(3, (9, ["truth", *values], "black"))
    widths = [max(text_width_mm(t, SMALL) for t in texts) + 2.0 for _, texts, _ in candidates]
    fitting = int((np.cumsum(widths) <= free_mm(count + 1)).sum())
    line = 0.0
    if fitting > 1:
        x = 0.0
        for width_of, (_, texts, hue) in sorted(
            zip(widths[:fitting], candidates[:fitting], strict=True), key=lambda c: -c[1][0]
        ):
            for row, text in enumerate(texts):
                write(x, row, text, hue)
            x += width_of
        line = count + 1.4
    for text, hue in notes:
        if text_width_mm(text, SMALL) <= free_mm(line + 1.0):
            write(0.0, line, text, hue)
            line += 1.0
