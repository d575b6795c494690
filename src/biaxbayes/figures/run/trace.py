"""How the sampler went: whether its ensembles agree, and how true values rank among draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.calibration.ranks import count_band, rank_counts, uniformity_p_value
from biaxbayes.errors import InputError
from biaxbayes.figures.labels import few_ticks
from biaxbayes.figures.quantities import AxisText, known_or_default, quantity
from biaxbayes.figures.style import (
    MM,
    PAGE_MM,
    RUNS,
    blank_figure,
    colour,
    font_points,
    layout,
    print_style,
    settle,
)
from biaxbayes.parameters import MATERIAL, NOISE_SD, STRETCH, Parameter, Quantities

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STEPS = 200
"""Steps that are drawn; more would not be told apart."""
LEVELS = (0.05, 0.5, 0.95)
"""Quantiles of the walkers of an ensemble that are drawn, step by step."""
MIDDLE, ENDS = 0.8, 0.3
"""Widths of their lines, points."""
RANK_BINS = 20
ROW_MM, GAP_MM, HEAD_MM, FOOT_MM = 15.0, 2.2, 9.0, 9.0
NARROW_MM = 120.0
WIDE_SPREAD = 20.0


def trace_figure(
    chains: Mapping[str, np.ndarray],
    *,
    names: Sequence[str] | None = None,
    unit: str = "",
    rhat: Mapping[str, float] | None = None,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
    known: Quantities | None = None,
) -> Figure:
    """Traces of the ensembles, and the ranks of each ensemble's draws among all.

    Left: median and 5 % to 95 % range over the walkers of each ensemble, step by step. Right: how
    the draws of each ensemble spread over the ranks of all draws; ensembles that sample the same
    distribution run along 1.

    Parameters
    ----------
    chains : mapping of str to ndarray, shape (ensembles, steps, walkers)
    names : sequence of str, optional
        Rows; by default the material parameters, the first mounted state, the noise and the log
        density, as far as they vary.
    unit : str
        Unit of the specimen's loads.
    rhat : mapping, optional
        Split R-hat by name, printed in the rows.
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
        If nothing varies, or a name is not there.
    """
    everything = known_or_default(known, unit)
    rows = _rows(chains, names, everything)
    rank = 0.33 if width_mm >= NARROW_MM else 0.4
    height = HEAD_MM + FOOT_MM + len(rows) * (ROW_MM + GAP_MM)
    with print_style(style):
        room = layout(across_mm=0.8, down_mm=0.5 * GAP_MM)
        figure = blank_figure(width_mm * MM, height * MM, room)
        panels = figure.subplots(
            len(rows), 2, squeeze=False, sharex="col", width_ratios=(1.0 - rank, rank)
        )
        for (left, right), name in zip(panels, rows, strict=True):
            _trace(left, chains[name], quantity(name, unit, everything))
            _ranks(right, chains[name])
            if rhat is not None and np.isfinite(rhat.get(name, np.nan)):
                text = rf"$\hat R$ = {rhat[name]:.3f}"
                size = font_points("legend.fontsize")
                right.text(0.98, 0.06, text, transform=right.transAxes, ha="right", size=size)
        panels[-1, 0].set_xlabel("kept step")
        few = width_mm < NARROW_MM
        panels[-1, 1].set_xlabel("rank among all" if few else "rank among all draws")
        figure.align_labels()
        _legend(figure, len(next(iter(chains.values()))))
        settle(figure)
    return figure


def _rows(
    chains: Mapping[str, np.ndarray], names: Sequence[str] | None, known: Quantities
) -> list[str]:
    if names is not None:
        for name in names:
            if name not in chains:
                raise InputError(
                    f"no quantity {name!r} in this run", remedy=f"it has {', '.join(chains)}"
                )
        return list(names)
    first: dict[Parameter, str] = {}
    for q in known.of_kind(MATERIAL, STRETCH):
        if q.name in chains:
            first.setdefault(q.parameter, q.name)
    drawn = [*first.values(), *(n for n in (NOISE_SD.name, "lp") if n in chains)]
    rows = [n for n in drawn if np.ptp(chains[n]) > 0.0]
    if not rows:
        raise InputError("no quantity of this run varies, so there is nothing to draw")
    return rows


def _trace(ax: Axes, values: np.ndarray, q: AxisText) -> None:
    steps = np.unique(np.linspace(0, values.shape[1] - 1, STEPS).round().astype(int))
    low, middle, high = np.quantile(values[:, steps], LEVELS, axis=2)
    for i in range(len(values)):
        hue = colour(RUNS[i % len(RUNS)])
        ax.plot(steps + 1, middle[i], color=hue, linewidth=MIDDLE)
        for edge in (low[i], high[i]):
            ax.plot(steps + 1, edge, color=hue, linewidth=ENDS)
    first, final = float(low.min()), float(high.max())
    log = q.scale and first > 0.0 and final > WIDE_SPREAD * first
    if log:
        ax.set_yscale("log")
        ax.set_ylim(first / 1.1, final * 1.1)
    else:
        margin = 0.06 * (final - first) or max(abs(final), 1e-9)
        ax.set_ylim(max(first - margin, q.edges[0]), min(final + margin, q.edges[1]))
    ax.set_xlim(1.0, max(float(values.shape[1]), 2.0))
    few_ticks(ax.yaxis, overhang=0.8)
    few_ticks(ax.xaxis, most=6, overhang=2.0)
    ax.set_ylabel(q.label.replace(" (", "\n("), linespacing=1.1)


def _ranks(ax: Axes, values: np.ndarray) -> None:
    flat = values.reshape(len(values), -1)
    order = flat.ravel().argsort(kind="stable")
    rank = np.empty(order.size)
    rank[order] = (np.arange(order.size) + 0.5) / order.size
    for i, own in enumerate(rank.reshape(flat.shape)):
        counts, edges = np.histogram(own, RANK_BINS, (0.0, 1.0))
        # density of the ranks: 1 where the ensemble holds its share of the draws
        share = counts * RANK_BINS / own.size
        hue = colour(RUNS[i % len(RUNS)])
        ax.stairs(share, edges, baseline=None, color=hue, linewidth=0.7)
    ax.axhline(1.0, color="0.6", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.5)
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.05 * max(ax.dataLim.y1, 1.5)))
    few_ticks(ax.yaxis, overhang=0.8)
    few_ticks(ax.xaxis, most=6, overhang=2.0)


def _legend(figure: Figure, ensembles: int) -> None:
    from matplotlib.lines import Line2D

    shown = min(ensembles, len(RUNS))
    handles = [
        Line2D([], [], color=colour(RUNS[i]), linewidth=1.2, label=f"{i + 1}") for i in range(shown)
    ]
    first, last = (f"{100.0 * q:g}" for q in (LEVELS[0], LEVELS[-1]))
    figure.legend(
        handles=[Line2D([], [], linestyle="none", label="ensemble"), *handles],
        title=f"thick: median, thin: {first} and {last} % of the walkers of an ensemble",
        alignment="left",
        loc="outside upper left",
        ncols=shown + 1,
        borderaxespad=0.2,
        handlelength=1.2,
        columnspacing=0.9,
    )


# --- ranks of true values in a calibration study, against uniformity -----------------------------


COLUMNS = 4
RANK_ROW_MM, RANK_FOOT_MM = 36.0, 12.0


def rank_figure(ranks: pd.DataFrame, draws: int, style: Mapping[str, Any] | None = None) -> Figure:
    """One panel a quantity: the empirical distribution of the ranks less the uniform one.

    Parameters
    ----------
    ranks : DataFrame
        One row a replication and quantity, with ``parameter``, ``unit`` and ``rank``.
    draws : int
        Draws that a true value was ranked among.
    style : mapping, optional
        From :func:`~biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
        The grey band holds all of a uniform study's curve with probability 0.95.
    """
    names = list(dict.fromkeys(ranks["parameter"]))
    rows = -(-len(names) // COLUMNS)
    with print_style(style):
        height = rows * RANK_ROW_MM + RANK_FOOT_MM
        figure = blank_figure(PAGE_MM * MM, height * MM, "constrained")
        axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axis, name in zip(axes.flat, names, strict=False):
            group = ranks[ranks["parameter"] == name]
            _calibration(axis, group["rank"].to_numpy(dtype=int), draws)
            unit = "" if group["unit"].iloc[0] == "-" else str(group["unit"].iloc[0])
            p = uniformity_p_value(group["rank"].to_numpy(dtype=int), draws)
            axis.set_title(f"{_symbol(name, unit)}  ($p$ = {p:.2g})", pad=3.0)
        for axis in axes.flat[len(names) :]:
            axis.set_visible(False)
        for column in range(COLUMNS):
            shown = [r for r in range(rows) if r * COLUMNS + column < len(names)]
            if shown:
                axes[shown[-1], column].tick_params(labelbottom=True)
        figure.supxlabel("rank of the true value among the posterior draws, relative")
        figure.supylabel("distribution of the ranks\nless the uniform one")
        settle(figure)
    return figure


def _calibration(axis: Axes, ranks: np.ndarray, draws: int) -> None:
    n = ranks.size
    z = np.arange(1, draws + 1) / (draws + 1)
    low, high = count_band(n, draws)
    difference = rank_counts(ranks, draws) / n - z
    outside = bool(np.any((difference < low / n - z - 1e-12) | (difference > high / n - z + 1e-12)))
    axis.fill_between(z, low / n - z, high / n - z, color="0.85", linewidth=0.0, step="mid")
    axis.axhline(0.0, color="0.5", linewidth=0.5)
    axis.step(z, difference, where="mid", color=colour("y" if outside else "x"))
    axis.set_xlim(0.0, 1.0)
    axis.set_xticks([0.0, 0.5, 1.0], ["0", "0.5", "1"])


def _symbol(name: str, unit: str) -> str:
    if name == "log_likelihood":
        return "log likelihood"
    return quantity(name, unit).symbol
