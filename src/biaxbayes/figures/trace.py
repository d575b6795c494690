"""Traces of the ensembles of a run, and the ranks of each ensemble's draws among all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from biaxbayes.errors import InputError
from biaxbayes.evenly import evenly_chosen
from biaxbayes.figures import style
from biaxbayes.figures.quantities import AxisText, known_or_default, quantity
from biaxbayes.parameters import MATERIAL, NOISE_SD, STRETCH, Parameter, Quantities
from biaxbayes.prediction.percentiles import QUANTILES

DRAWN_STEPS = 200
"""Steps that are drawn; more could not be distinguished in print."""
RANK_BINS = 20
ROW_MM = 17.2


@style.print_style()
def trace_figure(
    chains: Mapping[str, np.ndarray],
    *,
    names: Sequence[str] | None = None,
    unit: str = "",
    rhat: Mapping[str, float] | None = None,
    width_mm: float = style.PAGE_MM,
    known: Quantities | None = None,
) -> Figure:
    """Draw traces of chains (ensembles, steps, walkers) by name, and the ranks of their draws."""
    quantities = known_or_default(known, unit)
    if names is None:
        # material parameters, first mounted state, noise and log density, as far as they vary
        first_of: dict[Parameter, str] = {}
        for q in quantities.of_kind(MATERIAL, STRETCH):
            if q.name in chains:
                first_of.setdefault(q.parameter, q.name)
        listed = [*first_of.values(), NOISE_SD.name, "lp"]
        names = [n for n in listed if n in chains and np.ptp(chains[n]) > 0.0]
        if not names:
            raise InputError("no quantity of this run varies, so there is nothing to draw")
    for name in names:
        if name not in chains:
            raise InputError(
                f"unknown quantity {name!r}", remedy=f"the run has {', '.join(chains)}"
            )
    narrow = width_mm < style.SIDE_BY_SIDE_MM
    figure = style.blank_figure(width_mm, 18.0 + ROW_MM * len(names))
    widths = (1.5, 1.0) if narrow else (2, 1)
    panels = figure.subplots(len(names), 2, squeeze=False, sharex="col", width_ratios=widths)
    for (left, right), name in zip(panels, names, strict=True):
        _draw_trace(left, chains[name], quantity(name, unit, quantities))
        _draw_ranks(right, chains[name])
        if rhat is not None and np.isfinite(rhat.get(name, np.nan)):
            text, where = rf"$\hat R$ = {rhat[name]:.3f}", right.transAxes
            right.text(0.98, 0.06, text, transform=where, ha="right", **style.small_text())
    panels[-1, 0].set_xlabel("stored step")
    panels[-1, 1].set_xlabel("rank among all" if narrow else "rank among all draws")
    figure.align_ylabels()
    handles = [Line2D([], [], linestyle="none", label="ensemble")]
    for i in range(len(chains[names[0]])):
        handles.append(Line2D([], [], color=style.colour(i), label=i + 1))
    first, _, last = (f"{100.0 * q:g}" for q in QUANTILES.values())
    figure.legend(
        handles=handles,
        title=f"thick: median, thin: {first} and {last} % of the walkers of an ensemble",
        alignment="left",
        loc="outside upper left",
        ncols=len(handles),
        handlelength=1.2,
        columnspacing=0.9,
    )
    return figure


def _draw_trace(ax: Axes, values: np.ndarray, q: AxisText) -> None:
    steps = evenly_chosen(values.shape[1], DRAWN_STEPS)
    quantiles = np.quantile(values[:, steps], list(QUANTILES.values()), axis=2)
    for i in range(len(values)):
        for level, width in zip(quantiles[:, i], (0.3, 0.8, 0.3), strict=True):
            ax.plot(steps + 1, level, color=style.colour(i), linewidth=width)
    low, high = float(quantiles.min()), float(quantiles.max())
    if q.is_log(low, high):
        ax.set_yscale("log")
    ax.margins(x=0.0, y=0.06)
    style.limit_ticks(ax.yaxis, 3)
    ax.set_ylabel(q.label.replace(" (", "\n("), linespacing=1.1)


def _draw_ranks(ax: Axes, values: np.ndarray) -> None:
    """Density of the ranks; 1 where an ensemble has its share of the draws."""
    ranks = (values.ravel().argsort(kind="stable").argsort() + 0.5) / values.size
    for i, counts in enumerate(ranks.reshape(len(values), -1)):
        density, bin_edges = np.histogram(counts, RANK_BINS, (0.0, 1.0), density=True)
        ax.stairs(density, bin_edges, baseline=None, color=style.colour(i), linewidth=0.7)
    ax.axhline(1.0, **style.REFERENCE)
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.05 * max(ax.dataLim.y1, 1.5)))
    style.limit_ticks(ax.yaxis, 3)
