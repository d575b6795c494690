"""Runs side by side: the matrix of verdicts and the forest of intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.comparison.compare import Comparison
from biaxbayes.figures.panels import draw_cells, group_colour, row_panels
from biaxbayes.figures.quantities import AxisText, axis_span, axis_text, plain, quantity
from biaxbayes.figures.run.identifiability import VERDICT_COLOURS
from biaxbayes.figures.style import PAGE_MM, add_note, blank_figure, few_ticks, print_style
from biaxbayes.identifiability.bounded_density import at_edges, curve, interval
from biaxbayes.identifiability.determined import STRESS
from biaxbayes.identifiability.reported import Reported, report_rows
from biaxbayes.identifiability.verdict import COMBINATION
from biaxbayes.parameters import Quantity

SHORT = {COMBINATION: "in combination"}
ROW_MM, FOREST_ROW_MM = 9.5, 4.2
REPORTED_OFFSET = 0.3
"""Offset of the reported interval below the posterior, in rows."""
NOTE = (
    "coloured: posterior within the law; below in grey: the reported interval (arrow: bound)\n"
    "filled: identified or bounded in that run; open: not, so differences are not of the tissue"
)


def matrix_figure(comparison: Comparison) -> Figure:
    """Verdict and reported interval of every parameter of every run."""
    runs = [
        {row.name: row for row in report_rows(reported, member.posterior.quantities)}
        for member, reported in zip(comparison.members, comparison.reported, strict=True)
    ]
    quantities = _judged(comparison)
    names = [name for name in quantities if any(name in run for run in runs)]
    texts, faces = [], []
    for run in runs:
        rows = [run.get(name) for name in names]
        texts.append(
            [f"{SHORT.get(r.verdict, r.verdict)}\n{r.interval}" if r else "" for r in rows]
        )
        faces.append([VERDICT_COLOURS[row.verdict] if row else "white" for row in rows])
    with print_style():
        figure = blank_figure(PAGE_MM, 15.0 + ROW_MM * len(runs))
        draw_cells(
            figure.subplots(),
            texts,
            faces,
            rows=[plain(label, 20) for label in comparison.labels],
            columns=[axis_text(quantities[name]).label for name in names],
        )
        add_note(figure, "below the verdict: reported 90 % interval or 95 % bound")
    return figure


def _judged(comparison: Comparison) -> dict[str, Quantity]:
    """Material parameters and mounting stretches of a shared state, of all runs."""
    judged = (q for m in comparison.members for q in m.posterior.quantities.assessed())
    return {q.name: q for q in judged if not q.state}


@dataclass(frozen=True)
class Row:
    """A quantity of the forest with, for each run, draws, verdict and reported interval."""

    quantity: AxisText
    draws: list[np.ndarray | None]
    identified: list[bool]
    reported: list[Reported | None]


def forest_figure(comparison: Comparison) -> Figure:
    """Draw medians with 50 and 90 % intervals of every run; open symbols are not identified."""
    rows = [*_parameter_rows(comparison), *_derived_rows(comparison)]
    labels = [plain(label, 16) for label in comparison.labels]
    with print_style():
        tall = FOREST_ROW_MM * len(labels) + 1.0
        figure, axes = row_panels(len(rows), tall, range(len(labels)), labels, NOTE)
        for ax, row in zip(axes, rows, strict=True):
            _draw_panel(ax, row)
    return figure


def _parameter_rows(comparison: Comparison) -> list[Row]:
    rows = []
    for name, known in _judged(comparison).items():
        draws = [
            m.draws[name].to_numpy(dtype=float) if name in m.draws else None
            for m in comparison.members
        ]
        if any(d is not None for d in draws):
            identified = [d.get(name, False) for d in comparison.identified]
            reported = [
                next((r for r in rows_of_run if r.name == name), None)
                for rows_of_run in comparison.reported
            ]
            rows.append(Row(axis_text(known), draws, identified, reported))
    return rows


def _derived_rows(comparison: Comparison) -> list[Row]:
    """Structure tensor, stiffness, and stresses at the largest common stretch."""
    rows = []
    for derived in zip(*comparison.derived, strict=True):
        first = derived[0]
        if first.kind == STRESS and first.stretch != comparison.stretches[-1]:
            continue
        at = "" if first.stretch is None else f" at {first.stretch:.4g}"
        identified = [d[first.key] for d in comparison.identified]
        draws: list[np.ndarray | None] = [q.values for q in derived]
        rows.append(Row(quantity(first.name + at), draws, identified, [None] * len(draws)))
    return rows


def _draw_panel(ax: Axes, row: Row) -> None:
    draws = [d for d in row.draws if d is not None]
    ends = [v for r in row.reported if r for v in (r.low, r.high) if np.isfinite(v)]
    axis = axis_span(row.quantity, *draws, include=tuple(ends))
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
    ax.set(xlim=(axis.low, axis.high), xlabel=row.quantity.label)
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
