"""How the sampler went: the ensembles step by step, and whether they agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.findings.bounded_density import Span
from biaxbayes.output.figures.quantities import quantity
from biaxbayes.output.figures.ticks import choose_ticks, set_ticks
from biaxbayes.output.style import MM, PAGE_MM, colour, font_points, print_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["trace_figure"]

DEFAULT = (
    "C1",
    "k1",
    "k2",
    "alpha",
    "kappa",
    "mounting_stretch_x",
    "mounting_stretch_y",
    "noise_sd",
    "lp",
)
ROLES = ("run", "other", "third", "fourth", "fifth", "sixth")
STEPS = 200
"""Steps that are drawn; more would not be told apart."""
RANK_BINS = 20
ROW_MM, GAP_MM = 15.0, 2.2
WIDE_SPREAD = 20.0


def trace_figure(
    chains: Mapping[str, np.ndarray],
    *,
    names: Sequence[str] | None = None,
    unit: str = "",
    rhat: Mapping[str, float] | None = None,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
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
        From :func:`biaxbayes.output.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If nothing varies, or a name is not there.
    """
    from matplotlib.figure import Figure

    rows = _rows(chains, names)
    wide = width_mm >= 120.0
    left, top, bottom = (20.0, 6.5, 10.0)
    rank = 0.3 * width_mm if wide else 0.28 * width_mm
    trace = width_mm - left - rank - (13.0 if wide else 10.0)
    height = top + bottom + len(rows) * ROW_MM + (len(rows) - 1) * GAP_MM
    with print_style(style):
        figure = Figure((width_mm * MM, height * MM))
        for i, name in enumerate(rows):
            y = (height - top - (i + 1) * ROW_MM - i * GAP_MM) / height
            last = i == len(rows) - 1
            place = (left / width_mm, y, trace / width_mm, ROW_MM / height)
            _trace(figure.add_axes(place), chains[name], name, unit, trace, last=last)
            place = (1.0 - (rank + 2.0) / width_mm, y, rank / width_mm, ROW_MM / height)
            ax = figure.add_axes(place)
            _ranks(ax, chains[name], rank, last=last)
            if rhat is not None and np.isfinite(rhat.get(name, np.nan)):
                text = rf"$\hat R$ = {rhat[name]:.3f}"
                size = font_points("legend.fontsize")
                ax.text(0.98, 0.06, text, transform=ax.transAxes, ha="right", size=size)
        _legend(figure, len(next(iter(chains.values()))), left / width_mm)
    return figure


def _rows(chains: Mapping[str, np.ndarray], names: Sequence[str] | None) -> list[str]:
    if names is not None:
        for name in names:
            if name not in chains:
                raise InputError(
                    f"no quantity {name!r} in this run", remedy=f"it has {', '.join(chains)}"
                )
        return list(names)
    rows = []
    for stem in DEFAULT:
        own = [n for n in chains if n == stem or n.startswith(f"{stem}[")][:1]
        rows += [n for n in own if np.ptp(chains[n]) > 0.0]
    if not rows:
        raise InputError("no quantity of this run varies, so there is nothing to draw")
    return rows


def _trace(
    ax: Axes, values: np.ndarray, name: str, unit: str, length: float, *, last: bool
) -> None:
    q = quantity(name, unit)
    steps = np.unique(np.linspace(0, values.shape[1] - 1, STEPS).round().astype(int))
    low, middle, high = np.quantile(values[:, steps], [0.05, 0.5, 0.95], axis=2)
    for i in range(len(values)):
        hue = colour(ROLES[i % len(ROLES)])
        ax.plot(steps + 1, middle[i], color=hue, linewidth=0.7)
        for edge in (low[i], high[i]):
            ax.plot(steps + 1, edge, color=hue, linewidth=0.35)
    first, final = float(low.min()), float(high.max())
    log = q.scale and first > 0.0 and final > WIDE_SPREAD * first
    if log:
        ax.set_yscale("log")
        shown = Span(first / 1.1, final * 1.1, log=True)
    else:
        margin = 0.06 * (final - first) or max(abs(final), 1e-9)
        shown = Span(max(first - margin, q.edges[0]), min(final + margin, q.edges[1]))
    _axis(ax, shown, "y", ROW_MM, labels=True)
    across = Span(1.0, max(float(values.shape[1]), 2.0))
    _axis(ax, across, "x", length, labels=last)
    if last:
        ax.set_xlabel("kept step")
    ax.set_ylabel(q.label.replace(" (", "\n("), linespacing=1.1)
    ax.yaxis.set_label_coords(-12.5 / length, 0.5)


def _ranks(ax: Axes, values: np.ndarray, length: float, *, last: bool) -> None:
    flat = values.reshape(len(values), -1)
    order = flat.ravel().argsort(kind="stable")
    rank = np.empty(order.size)
    rank[order] = (np.arange(order.size) + 0.5) / order.size
    for i, own in enumerate(rank.reshape(flat.shape)):
        counts, edges = np.histogram(own, RANK_BINS, (0.0, 1.0))
        # density of the ranks: 1 where the ensemble holds its share of the draws
        share = counts * RANK_BINS / own.size
        hue = colour(ROLES[i % len(ROLES)])
        ax.stairs(share, edges, baseline=None, color=hue, linewidth=0.7)
    ax.axhline(1.0, color="0.6", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.5)
    top = max(ax.dataLim.y1, 1.5)
    _axis(ax, Span(0.0, 1.05 * top), "y", ROW_MM, labels=True)
    _axis(ax, Span(0.0, 1.0), "x", length, labels=last)
    if last:
        ax.set_xlabel("rank among all" if length < 40.0 else "rank among all draws")


def _axis(ax: Axes, shown: Span, which: str, side: float, *, labels: bool) -> None:
    ax.set(**{f"{which}lim": (shown.low, shown.high)})
    across = which == "x"
    ticks = choose_ticks(
        shown,
        side,
        font_points(f"{which}tick.labelsize"),
        horizontal=across,
        overhang=2.0 if across else 0.8,
        most=6 if across else 3,
    )
    set_ticks(ax.xaxis if across else ax.yaxis, ticks, labels=labels)


def _legend(figure: Figure, ensembles: int, left: float) -> None:
    from matplotlib.lines import Line2D

    shown = min(ensembles, len(ROLES))
    handles = [
        Line2D([], [], color=colour(ROLES[i]), linewidth=1.2, label=f"{i + 1}")
        for i in range(shown)
    ]
    figure.legend(
        handles=[Line2D([], [], linestyle="none", label="ensemble"), *handles],
        loc="upper left",
        bbox_to_anchor=(left, 1.0),
        ncols=shown + 1,
        borderaxespad=0.2,
        handlelength=1.2,
        columnspacing=0.9,
    )
