"""The joint posterior at a glance: every pair of quantities, every quantity alone.

Drawn here rather than with the corner package: that smooths over the physical edges of kappa and
alpha, where these posteriors like to pile up, and importing it imports all of ArviZ.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.findings.bands import evenly_chosen
from biaxbayes.findings.bounded_density import (
    Span,
    at_edges,
    curve,
    interval,
    span,
    surface,
)
from biaxbayes.output.figures.corner_layout import NARROW_MM, Entry, Grid, Heading, write_table
from biaxbayes.output.figures.lettering import shortened
from biaxbayes.output.figures.numbers import number, range_text
from biaxbayes.output.figures.quantities import MEAN, Quantity, corner_columns
from biaxbayes.output.figures.regions import CONTENTS, regions
from biaxbayes.output.style import PAGE_MM, colour, font_points, print_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["corner_figure"]

ROLES = ("run", "other")
VISIBLE = 40_000
"""Draws that are looked at; more would change nothing that an eye can see."""
WIDE_SPREAD = 8.0
"""Ratio of the 99.5 % to the 0.5 % point from which a scale gets a logarithmic axis."""


class Column(NamedTuple):
    """One quantity of the figure: its axis and, run by run, its draws (None: not varied)."""

    quantity: Quantity
    axis: Span
    draws: list[np.ndarray | None]
    fixed: list[float | None]
    truth: float | None


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


def corner_figure(
    draws: pd.DataFrame,
    *,
    truth: Mapping[str, float] | None = None,
    compare: pd.DataFrame | None = None,
    names: tuple[str, str] = ("this run", "compared"),
    probability: float = 0.9,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
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
    probability : float
        Content of the shaded interval of each quantity: central, or one-sided where the draws
        pile up at a physical edge.
    width_mm : float
        Width in print.
    style : mapping, optional
        From :func:`biaxbayes.output.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If nothing varies.
    """
    columns = _columns(draws, truth or {}, compare)
    if not columns:
        raise InputError("no parameter of this run varies, so there is nothing to draw")
    with print_style(style):
        labels = [(c.quantity.symbol, c.quantity.unit) for c in columns]
        grid = Grid([c.axis for c in columns], labels, width_mm)
        rows = []
        for i, column in enumerate(columns):
            rows.append(_marginal(grid.axes[i][i], column, probability))
            for j in range(i):
                _joint(grid.axes[i][j], columns[j], column)
        grid.finish()
        _tabulate(grid, columns, rows, names if compare is not None else None, probability)
    return grid.figure


def _columns(
    draws: pd.DataFrame, truth: Mapping[str, float], compare: pd.DataFrame | None
) -> list[Column]:
    runs = [draws] if compare is None else [draws, compare]
    picked = [corner_columns(run.iloc[evenly_chosen(len(run), VISIBLE)]) for run in runs]
    out = []
    for name, (q, values) in picked[0].items():
        drawn = [values, *(other[name][1] if name in other else None for other in picked[1:])]
        present = [d for d in drawn if d is not None]
        fixed = [_constant(run, name) for run in runs]
        known = truth.get(name)
        seen = [float(v) for v in (known, *fixed) if v is not None and np.isfinite(v)]
        log = q.scale and _spread(present) > WIDE_SPREAD
        axis = span(*present, edges=q.edges, log=log, include=tuple(seen))
        shown = None if known is None or not np.isfinite(known) else float(known)
        out.append(Column(q, axis, drawn, fixed, shown))
    return out


def _constant(run: pd.DataFrame, name: str) -> float | None:
    """The value of a column that does not vary."""
    if name not in run or np.ptp(run[name].to_numpy()) > 0.0:
        return None
    return float(run[name].iloc[0])


def _spread(columns: list[np.ndarray]) -> float:
    low, high = np.quantile(np.concatenate(columns), [0.005, 0.995])
    return float(high / low) if low > 0.0 else np.inf


def _marginal(ax: Axes, column: Column, probability: float) -> list[Found | None]:
    """Draw one quantity alone; median and interval of each run."""
    out: list[Found | None] = []
    top = 0.0
    for run, values in enumerate(column.draws):
        hue = colour(ROLES[run])
        fixed = column.fixed[run]
        if fixed is not None:
            ax.axvline(fixed, color=hue, linewidth=0.9)
            out.append(Found(fixed, fixed, fixed, (False, False)))
            continue
        if values is None:
            out.append(None)
            continue
        x, density = curve(values, column.axis)
        piled = at_edges(density, column.axis)
        low, high = interval(values, piled, probability)
        ax.plot(x, density, color=hue, linewidth=0.9)
        if run == 0:
            inside = list((x >= low) & (x <= high))
            ax.fill_between(x, density, where=inside, color=hue, alpha=0.3, linewidth=0.0)
        top = max(top, float(density.max()))
        out.append(Found(float(np.median(values)), low, high, piled))
    if column.truth is not None:
        ax.axvline(column.truth, color="black", linewidth=0.8, linestyle=(0, (3, 2)))
    ax.set_ylim(0.0, 1.08 * top)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    return out


def _joint(ax: Axes, across: Column, up: Column) -> None:
    """Draw a pair as regions; of a compared run the outline of the one that holds 90 %."""
    for run, (first, second) in enumerate(zip(across.draws, up.draws, strict=True)):
        if first is not None and second is not None:
            x, y, density = surface(first, second, (across.axis, up.axis))
            regions(ax, x, y, density, colour(ROLES[run]), filled=run == 0)
    for value, line in ((across.truth, ax.axvline), (up.truth, ax.axhline)):
        if value is not None:
            line(value, color="black", linewidth=0.6, linestyle=(0, (3, 2)))


def _tabulate(
    grid: Grid,
    columns: list[Column],
    rows: list[list[Found | None]],
    names: tuple[str, str] | None,
    probability: float,
) -> None:
    """Medians and intervals in the free corner; its headings are the legend."""
    wide = grid.width_mm >= NARROW_MM
    content = f"{100 * probability:g} %"
    headings = []
    for run in range(len(columns[0].draws)):
        hue = colour(ROLES[run])
        head = content if not wide else f"{content} interval"
        head = (
            head if names is None else shortened(names[run], 32.0, font_points("legend.fontsize"))
        )
        headings += [Heading("median", 3 * run + 1, hue), Heading(head, 3 * run, hue)]
    known = any(c.truth is not None for c in columns)
    if known:
        headings.append(Heading("truth", 2))
    entries = []
    for column, runs in zip(columns, rows, strict=True):
        cells: list[str] = []
        for found in runs:
            cells += ["", ""] if found is None else found.cells(log=column.axis.log)
        if known:
            cells.append("" if column.truth is None else f"{column.truth:.5g}")
        q = column.quantity
        entries.append(Entry(q.label if wide else q.symbol, tuple(cells)))
    contents = ", ".join(f"{100 * c:g}" for c in CONTENTS)
    notes = [(f"regions: {contents} % of the draws", "0.3")]
    if names is not None:
        notes.insert(0, (f"{content} intervals", "0.3"))
        size = font_points("legend.fontsize")
        other = shortened(names[1], 32.0 if wide else 22.0, size)
        notes.append((f"outlines: {other}, 90 %" if wide else other, colour(ROLES[1])))
    if known:
        notes.append(("dashed: truth", "0.3"))
    if any(MEAN in c.quantity.symbol for c in columns):
        notes.append(("bar: mean over protocols" if wide else "bar: mean", "0.3"))
    write_table(grid, headings, entries, notes)
