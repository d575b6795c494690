"""Runs side by side: the matrix of verdicts and the forest of intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from biaxbayes.findings.bounded_density import at_edges, curve, interval, span
from biaxbayes.findings.compare import Comparison
from biaxbayes.findings.derived import STRESS
from biaxbayes.findings.identifiability import ParameterVerdict
from biaxbayes.findings.verdict import COMBINATION, FIXED, IDENTIFIED, NO_VERDICT, PRIOR
from biaxbayes.output.figures.identifiability import VERDICT_COLOURS
from biaxbayes.output.figures.quantities import quantity
from biaxbayes.output.figures.ticks import choose_ticks, set_ticks
from biaxbayes.output.style import MM, PAGE_MM, colour, plain, print_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from biaxbayes.findings.bounded_density import Span

__all__ = ["ROLES", "forest_figure", "matrix_figure"]

ROLES = ("run", "other", "third", "fourth", "fifth", "sixth")
COLUMNS = ("C1", "k1", "k2", "alpha", "kappa", "mounting_stretch_x", "mounting_stretch_y")
LABEL_MM, ROW_MM, HEAD_MM, FOOT_MM = 27.0, 9.5, 8.0, 7.0
SHORT = {COMBINATION: "in combination", FIXED: "fixed"}
FOREST_COLUMNS = 4
PANEL_MM, GAP_MM = 4.2, 12.0
TAIL_STRETCH = 8.0
"""Ratio of quantiles from which a positive scale gets a logarithmic axis."""


def matrix_figure(
    found: Comparison, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Verdict and contraction of every parameter of every run.

    Parameters
    ----------
    found : Comparison
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.output.style.read_style`.
    """
    from matplotlib.figure import Figure

    names = [n for n in COLUMNS if any(_verdict(v.parameters, n) for v in found.verdicts)]
    rows = len(found.members)
    height = HEAD_MM + ROW_MM * rows + FOOT_MM
    with print_style(style):
        figure = Figure((width_mm * MM, height * MM))
        ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        ax.set_axis_off()
        ax.set(xlim=(0.0, width_mm), ylim=(height, 0.0))
        cell = (width_mm - LABEL_MM - 1.0) / len(names)
        for j, name in enumerate(names):
            x = LABEL_MM + (j + 0.5) * cell
            ax.text(x, 0.55 * HEAD_MM, quantity(name).label, ha="center", va="center")
        for i, verdicts in enumerate(found.verdicts):
            y = HEAD_MM + ROW_MM * i
            label = plain(found.labels[i], 20)
            ax.text(LABEL_MM - 2.0, y + 0.5 * ROW_MM, label, ha="right", va="center")
            for j, name in enumerate(names):
                verdict = _verdict(verdicts.parameters, name)
                if verdict is not None:
                    _cell(ax, (LABEL_MM + j * cell, y), (cell, ROW_MM), verdict)
        ax.text(
            LABEL_MM,
            height - 0.4 * FOOT_MM,
            "per cent: contraction of the variance from prior to posterior",
            va="center",
            color="0.35",
            fontsize=7.0,
        )
    return figure


def _verdict(parameters: tuple[ParameterVerdict, ...], name: str) -> ParameterVerdict | None:
    return next((p for p in parameters if p.name == name), None)


def _cell(
    ax: Axes, corner: tuple[float, float], size: tuple[float, float], found: ParameterVerdict
) -> None:
    from matplotlib.patches import Rectangle

    face = VERDICT_COLOURS[found.verdict]
    (x, y), (width, height) = corner, size
    ax.add_patch(
        Rectangle((x + 0.4, y + 0.4), width - 0.8, height - 0.8, facecolor=face, linewidth=0.0)
    )
    hue = "white" if found.verdict in (IDENTIFIED, PRIOR, NO_VERDICT) else "black"
    text = SHORT.get(found.verdict, found.verdict)
    if found.evidence is not None:
        share = 100.0 * max(found.evidence.contraction, 0.0)
        text += f"\n{min(share, 99.9):.1f} %" if share > 99.0 else f"\n{share:.0f} %"
    centre = (x + 0.5 * width, y + 0.5 * height)
    ax.text(*centre, text, ha="center", va="center", color=hue, fontsize=6.5, linespacing=1.15)


class _Row(NamedTuple):
    """A quantity of the forest: its label, its draws run by run and whether each is determined."""

    label: str
    edges: tuple[float, float]
    log: bool
    draws: list[np.ndarray | None]
    determined: list[bool]


def forest_figure(
    found: Comparison, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians with intervals of 50 and 90 % of every run, a panel a quantity.

    Open symbols stand for what a run does not determine.

    Parameters
    ----------
    found : Comparison
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.output.style.read_style`.
    """
    from matplotlib.figure import Figure

    panels = _parameters(found) + _derived(found)
    lines = -(-len(panels) // FOREST_COLUMNS)
    tall = PANEL_MM * len(found.members) + 1.0
    label_mm = 4.0 + 1.45 * max(len(plain(label, 16)) for label in found.labels)
    wide = (width_mm - label_mm - 3.0) / FOREST_COLUMNS
    height = lines * (tall + GAP_MM) + 6.0
    with print_style(style):
        figure = Figure((width_mm * MM, height * MM))
        for k, row in enumerate(panels):
            i, j = divmod(k, FOREST_COLUMNS)
            bottom = height - (i + 1) * tall - i * GAP_MM - 2.0
            place = (label_mm + j * wide, bottom, wide - 5.0, tall)
            ax = figure.add_axes(
                (place[0] / width_mm, place[1] / height, place[2] / width_mm, place[3] / height)
            )
            _panel(ax, row, found.labels if j == 0 else [], place[2])
        note = "filled: determined in that run; open: not determined, no difference of tissue"
        figure.text(0.995, 1.2 / height, note, ha="right", color="0.35", fontsize=7.0)
    return figure


def _parameters(found: Comparison) -> list[_Row]:
    out = []
    for name in COLUMNS:
        q = quantity(name)
        draws = [
            m.draws[name].to_numpy(dtype=float) if name in m.draws else None for m in found.members
        ]
        if any(d is not None for d in draws):
            known = [d.get(name, False) for d in found.determined]
            out.append(_Row(q.label, q.edges, q.scale, draws, known))
    return out


def _derived(found: Comparison) -> list[_Row]:
    """Structure tensor, stiffness and the stresses at the largest common stretch."""
    out = []
    for quantities in zip(*found.derived, strict=True):
        first = quantities[0]
        if first.kind == STRESS and first.stretch != found.stretches[-1]:
            continue
        axis = first.name[-1]
        symbol = {"H": f"$H_{axis}$", "s": f"$c_{{{axis}{axis}}}$", "c": rf"$\sigma_{axis}$"}
        label = symbol[first.name[0]]
        if first.stretch is not None:
            label += f" at {first.stretch:.4g} (kPa)"
        edges = (0.0, 1.0) if first.stretch is None else (0.0, np.inf)
        known = [d[first.key] for d in found.determined]
        log = first.stretch is not None
        out.append(_Row(label, edges, log, [q.values for q in quantities], known))
    return out


def _panel(ax: Axes, row: _Row, labels: list[str], width_mm: float) -> None:
    axis = _axis(row)
    for i, (values, known) in enumerate(zip(row.draws, row.determined, strict=True)):
        if values is None:
            continue
        hue = colour(ROLES[i % len(ROLES)])
        median = float(np.median(values))
        if np.ptp(values) > 0.0:
            _, density = curve(values, axis)
            piled = at_edges(density, axis)
            # One-sided where the draws pile up at a physical edge; the middle half is central.
            for content, ends, line in ((0.9, piled, 0.9), (0.5, (False, False), 2.2)):
                ax.plot(interval(values, ends, content), [i, i], color=hue, linewidth=line)
        face = hue if known else "white"
        ax.plot(
            median, i, "o", color=hue, markerfacecolor=face, markersize=3.6, markeredgewidth=0.9
        )
    ax.set_ylim(len(row.draws) - 0.4, -0.6)
    if axis.log:
        ax.set_xscale("log")
    ax.set_xlim(axis.low, axis.high)
    set_ticks(
        ax.xaxis,
        choose_ticks(axis, width_mm, 7.0, horizontal=True, overhang=2.0, most=4),
        labels=True,
    )
    ax.set_yticks(range(len(labels)), [plain(label, 16) for label in labels])
    ax.tick_params(axis="y", length=0.0)
    ax.spines["left"].set_visible(False)
    ax.set_xlabel(row.label, labelpad=2.0)


def _axis(row: _Row) -> Span:
    draws = [d for d in row.draws if d is not None]
    low, high = np.quantile(np.concatenate(draws), [0.005, 0.995])
    log = row.log and low > 0.0 and high > TAIL_STRETCH * low
    return span(*draws, edges=row.edges, log=bool(log))
