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
from biaxbayes.identifiability.identify import ParameterVerdict
from biaxbayes.identifiability.mounting_stretch.stated import Stated
from biaxbayes.identifiability.verdict_names import COMBINATION, FIXED
from biaxbayes.parameters import Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHORT = {COMBINATION: "in combination", FIXED: "fixed"}
ROW_MM, FOREST_ROW_MM = 9.5, 4.2
TISSUE_OFFSET = 0.3
"""Rows by which the interval of the tissue stands below that within the law."""


def matrix_figure(
    comparison: Comparison, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Verdict and contraction of every parameter of every run.

    Parameters
    ----------
    comparison : Comparison
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    verdicts = [{p.name: p for p in run.parameters} for run in comparison.verdicts]
    quantities = _judged(comparison)
    names = [name for name in quantities if any(name in run for run in verdicts)]
    note = "per cent: contraction of the variance from prior to posterior"
    if any(m.stated for m in comparison.members):
        note += "; below: what is stated of the tissue, whatever its law"
    with print_style(style):
        figure = blank_figure(width_mm, 15.0 + ROW_MM * len(verdicts))
        draw_cells(
            figure.subplots(),
            [[_cell_text(run.get(name)) for name in names] for run in verdicts],
            [
                [VERDICT_COLOURS[run[name].verdict] if name in run else "white" for name in names]
                for run in verdicts
            ],
            rows=[plain(label, 20) for label in comparison.labels],
            columns=[axis_text(quantities[name]).label for name in names],
        )
        add_note(figure, note)
    return figure


def _judged(comparison: Comparison) -> dict[str, Quantity]:
    """Material parameters and mounting stretches of a shared state, of all runs."""
    judged = (q for m in comparison.members for q in m.posterior.quantities.judged())
    return {q.name: q for q in judged if not q.state}


def _cell_text(verdict: ParameterVerdict | None) -> str:
    """Verdict, contraction and, of a mounting stretch, the interval of the tissue."""
    if verdict is None:
        return ""
    lines = [SHORT.get(verdict.verdict, verdict.verdict)]
    if verdict.evidence is not None:
        share = 100.0 * max(verdict.evidence.contraction, 0.0)
        lines.append(f"{min(share, 99.9):.1f} %" if share > 99.0 else f"{share:.0f} %")
        if verdict.stated is not None:
            words = verdict.stated.in_words(verdict.scale.parameter).replace(" to ", "–")
            lines.append(words.replace("above", ">").replace("nothing", "–"))
    return "\n".join(lines)


class Row(NamedTuple):
    """A quantity of the forest: its label, and of each run the draws and what is known of it."""

    label: str
    edges: tuple[float, float]
    log: bool
    draws: list[np.ndarray | None]
    determined: list[bool]
    tissue: list[Stated | None]


def forest_figure(
    comparison: Comparison, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians with intervals of 50 and 90 % of every run, one panel per quantity.

    Open symbols stand for what a run does not determine.

    Parameters
    ----------
    comparison : Comparison
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    rows = [*_parameter_rows(comparison), *_derived_rows(comparison)]
    note = "filled: determined in that run; open: not determined, no difference of tissue"
    if any(m.stated for m in comparison.members):
        note += (
            "\nmounting stretches: within the law; below in grey what is stated of the tissue, "
            "whatever its law (arrow: above)"
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
            determined = [d.get(name, False) for d in comparison.determined]
            tissue = [m.stated.get(name) for m in comparison.members]
            rows.append(Row(q.label, q.edges, q.scale, draws, determined, tissue))
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
        determined = [d[first.key] for d in comparison.determined]
        draws: list[np.ndarray | None] = [q.values for q in quantities]
        rows.append(Row(label, edges, scale, draws, determined, [None] * len(draws)))
    return rows


def _draw_panel(ax: Axes, row: Row) -> None:
    axis = _axis(row)
    for i, (values, determined) in enumerate(zip(row.draws, row.determined, strict=True)):
        if values is None:
            continue
        hue = group_colour(i)
        if np.ptp(values) > 0.0:
            piled = at_edges(curve(values, axis)[1], axis)
            # One-sided where the draws pile up at a physical edge; the middle half is central.
            ax.plot(interval(values, piled, 0.9), [i, i], color=hue, linewidth=0.9)
            ax.plot(interval(values, (False, False), 0.5), [i, i], color=hue, linewidth=2.2)
        face = hue if determined else "white"
        ax.plot(np.median(values), i, "o", color=hue, mfc=face, ms=3.6, mew=0.9)
    for i, tissue in enumerate(row.tissue):
        if tissue is not None and np.isfinite(tissue.low):
            _draw_tissue(ax, tissue, i + TISSUE_OFFSET, axis.high)
    ax.set(ylim=(len(row.draws) - 0.4, -0.6), xscale="log" if axis.log else "linear")
    ax.set(xlim=(axis.low, axis.high), xlabel=row.label)
    few_ticks(ax.xaxis)


def _draw_tissue(ax: Axes, tissue: Stated, y: float, end: float) -> None:
    """The interval of the tissue, or its lower bound and an arrow."""
    grey: dict[str, Any] = {"color": "0.45", "linewidth": 0.9, "markersize": 3.0}
    high = tissue.high if tissue.is_value else end
    ax.plot([tissue.low, high], [y, y], solid_capstyle="butt", **grey)
    ax.plot(tissue.low, y, "|", **grey)
    ax.plot(high, y, "|" if tissue.is_value else ">", clip_on=tissue.is_value, **grey)


def _axis(row: Row) -> Span:
    draws = [d for d in row.draws if d is not None]
    low, high = np.quantile(np.concatenate(draws), [0.005, 0.995])
    log = bool(row.log and low > 0.0 and high > LOG_SPREAD * low)
    ends = [v for t in row.tissue if t is not None for v in (t.low, t.high) if np.isfinite(v)]
    return span(*draws, edges=row.edges, log=log, include=tuple(ends))
