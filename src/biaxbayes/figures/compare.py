"""Runs side by side: the matrix of verdicts and the forest of intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from biaxbayes.comparison.compare import Comparison
from biaxbayes.figures.cells import draw_cells
from biaxbayes.figures.forest import LOG_SPREAD, group_colour, panel_rows
from biaxbayes.figures.quantities import axis_text
from biaxbayes.figures.run.identifiability import VERDICT_COLOURS
from biaxbayes.figures.style import (
    PAGE_MM,
    add_note,
    blank_figure,
    few_ticks,
    plain,
    print_style,
)
from biaxbayes.identifiability.bounded_density import Span, at_edges, curve, interval, span
from biaxbayes.identifiability.determined import STRESS
from biaxbayes.identifiability.report_table import ReportRow, report_rows
from biaxbayes.identifiability.reported import Reported
from biaxbayes.identifiability.verdict_names import COMBINATION
from biaxbayes.parameters import Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHORT = {COMBINATION: "in combination"}
ROW_MM, FOREST_ROW_MM = 9.5, 4.2
REPORTED_OFFSET = 0.3
"""Rows by which the reported interval stands below the posterior."""


def matrix_figure(
    comparison: Comparison, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Verdict and reported interval of every parameter of every run.

    Parameters
    ----------
    comparison : Comparison
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    runs = [
        {row.name: row for row in report_rows(reported, member.posterior.quantities)}
        for member, reported in zip(comparison.members, comparison.reported, strict=True)
    ]
    quantities = _judged(comparison)
    names = [name for name in quantities if any(name in run for run in runs)]
    with print_style(style):
        figure = blank_figure(width_mm, 15.0 + ROW_MM * len(runs))
        draw_cells(
            figure.subplots(),
            [[_cell_text(run.get(name)) for name in names] for run in runs],
            [
                [VERDICT_COLOURS[run[name].verdict] if name in run else "white" for name in names]
                for run in runs
            ],
            rows=[plain(label, 20) for label in comparison.labels],
            columns=[axis_text(quantities[name]).label for name in names],
        )
        add_note(figure, "below the verdict: reported 90 % interval or 95 % bound")
    return figure


def _judged(comparison: Comparison) -> dict[str, Quantity]:
    """Material parameters and mounting stretches of a shared state, of all runs."""
    judged = (q for m in comparison.members for q in m.posterior.quantities.judged())
    return {q.name: q for q in judged if not q.state}


def _cell_text(row: ReportRow | None) -> str:
    """Verdict and reported interval."""
    return "" if row is None else f"{SHORT.get(row.verdict, row.verdict)}\n{row.interval}"


class Row(NamedTuple):
    """A quantity of the forest: its label, and of each run the draws and what is known of it."""

    label: str
    edges: tuple[float, float]
    log: bool
    draws: list[np.ndarray | None]
    identified: list[bool]
    reported: list[Reported | None]


def forest_figure(
    comparison: Comparison, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians with intervals of 50 and 90 % of every run, one panel per quantity.

    Open symbols stand for what a run does not identify.

    Parameters
    ----------
    comparison : Comparison
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    rows = [*_parameter_rows(comparison), *_derived_rows(comparison)]
    note = (
        "coloured: posterior within the law; below in grey: the reported interval (arrow: bound)\n"
        "filled: identified or bounded in that run; open: not, no difference of tissue"
    )
    labels = [plain(label, 16) for label in comparison.labels]
    with print_style(style):
        tall = FOREST_ROW_MM * len(labels) + 1.0
        figure, axes = panel_rows(len(rows), tall, range(len(labels)), labels, width_mm, note)
        for ax, row in zip(axes, rows, strict=True):
            _draw_panel(ax, row)
    return figure


def _parameter_rows(comparison: Comparison) -> list[Row]:
    rows = []
    for name, known in _judged(comparison).items():
        q = axis_text(known)
        draws = [
            m.draws[name].to_numpy(dtype=float) if name in m.draws else None
            for m in comparison.members
        ]
        if any(d is not None for d in draws):
            identified = [d.get(name, False) for d in comparison.identified]
            reported = [
                next((r for r in of_run if r.name == name), None) for of_run in comparison.reported
            ]
            rows.append(Row(q.label, q.edges, q.scale, draws, identified, reported))
    return rows


def _derived_rows(comparison: Comparison) -> list[Row]:
    """Structure tensor, stiffness and the stresses at the largest common stretch."""
    rows = []
    for quantities in zip(*comparison.derived, strict=True):
        first = quantities[0]
        if first.kind == STRESS and first.stretch != comparison.stretches[-1]:
            continue
        axis, scale = first.name[-1], first.stretch is not None
        symbol = {"H": f"$H_{axis}$", "s": f"$c_{{{axis}{axis}}}$", "c": rf"$\sigma_{axis}$"}
        label = symbol[first.name[0]] + (f" at {first.stretch:.4g} (kPa)" if scale else "")
        edges = (0.0, np.inf if scale else 1.0)
        identified = [d[first.key] for d in comparison.identified]
        draws: list[np.ndarray | None] = [q.values for q in quantities]
        rows.append(Row(label, edges, scale, draws, identified, [None] * len(draws)))
    return rows


def _draw_panel(ax: Axes, row: Row) -> None:
    axis = _axis(row)
    for i, (values, identified) in enumerate(zip(row.draws, row.identified, strict=True)):
        if values is None:
            continue
        hue = group_colour(i)
        if np.ptp(values) > 0.0:
            piled = at_edges(curve(values, axis)[1], axis)
            # One-sided where the draws pile up at a physical edge; the middle half is central.
            ax.plot(interval(values, piled, 0.9), [i, i], color=hue, linewidth=0.9)
            ax.plot(interval(values, (False, False), 0.5), [i, i], color=hue, linewidth=2.2)
        face = hue if identified else "white"
        ax.plot(np.median(values), i, "o", color=hue, mfc=face, ms=3.6, mew=0.9)
    for i, reported in enumerate(row.reported):
        if reported is not None and np.isfinite([reported.low, reported.high]).any():
            _draw_reported(ax, reported, i + REPORTED_OFFSET, (axis.low, axis.high))
    ax.set(ylim=(len(row.draws) - 0.4, -0.6), xscale="log" if axis.log else "linear")
    ax.set(xlim=(axis.low, axis.high), xlabel=row.label)
    few_ticks(ax.xaxis)


def _draw_reported(ax: Axes, row: Reported, y: float, limits: tuple[float, float]) -> None:
    """The reported interval, or its bound and an arrow."""
    grey: dict[str, Any] = {"color": "0.45", "linewidth": 0.9, "markersize": 3.0}
    bounds = (row.low, row.high)
    ends = [b if np.isfinite(b) else end for b, end in zip(bounds, limits, strict=True)]
    ax.plot(ends, [y, y], solid_capstyle="butt", **grey)
    for bound, at, arrow in zip(bounds, ends, "<>", strict=True):
        known = bool(np.isfinite(bound))
        ax.plot(at, y, "|" if known else arrow, clip_on=known, **grey)


def _axis(row: Row) -> Span:
    draws = [d for d in row.draws if d is not None]
    low, high = np.quantile(np.concatenate(draws), [0.005, 0.995])
    log = bool(row.log and low > 0.0 and high > LOG_SPREAD * low)
    ends = [v for r in row.reported if r is not None for v in (r.low, r.high) if np.isfinite(v)]
    return span(*draws, edges=row.edges, log=log, include=tuple(ends))
