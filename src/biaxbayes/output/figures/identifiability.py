"""Which parameters the data determine, at a glance: prior, posterior and verdict, row by row."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.findings.identifiability import Identifiability, ParameterVerdict
from biaxbayes.findings.sampling_scale import prior_values
from biaxbayes.findings.verdict import (
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    ONE_SIDED,
    PRIOR,
)
from biaxbayes.findings.verdict_words import number
from biaxbayes.inference.priors import Prior
from biaxbayes.output.figures.quantities import quantity
from biaxbayes.output.style import MM, PAGE_MM, plain, print_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["VERDICT_COLOURS", "identifiability_figure"]

# Okabe and Ito, from known to unknown; the word stands in the box, colour is only an aid.
VERDICT_COLOURS = {
    IDENTIFIED: "#009E73",
    ONE_SIDED: "#56B4E9",
    COMBINATION: "#E69F00",
    PRIOR: "#D55E00",
    NO_VERDICT: "#999999",
    FIXED: "#DDDDDD",
}
ROW_MM, HEAD_MM, FOOT_MM = 11.5, 7.0, 2.0
PRIOR_GREY, POSTERIOR = "0.82", "#0072B2"
EDGES = (0.0, 0.125, 0.42, 0.57, 1.0)  # of the columns, as shares of the width
MOST_ROWS = 16


def identifiability_figure(
    found: Identifiability,
    *,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Prior and posterior of every parameter, how much the data tell, and the verdict.

    Parameters
    ----------
    found : Identifiability
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.output.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
        The first 16 parameters.
    """
    from matplotlib.figure import Figure

    rows = found.parameters[:MOST_ROWS]
    with print_style(style):
        height = HEAD_MM + ROW_MM * len(rows) + FOOT_MM
        figure = Figure((width_mm * MM, height * MM))
        _heads(figure, height)
        for i, row in enumerate(rows):
            bottom = (FOOT_MM + ROW_MM * (len(rows) - 1 - i)) / height
            _row(figure, row, bottom, ROW_MM / height)
    return figure


def _heads(figure: Figure, height: float) -> None:
    y = 1.0 - 0.45 * HEAD_MM / height
    heads = ("parameter", "prior (grey), posterior (blue)", "contraction", "verdict, 90 % interval")
    for x, text, shift in zip(EDGES, heads, (0.01, 0.01, 0.02, 0.02), strict=False):
        figure.text(x + shift, y, text, va="center", ha="left", fontsize=7.0, color="0.35")


def _row(figure: Figure, row: ParameterVerdict, bottom: float, height: float) -> None:
    q = quantity(row.name)
    middle = bottom + 0.55 * height
    figure.text(0.01, middle, q.label, va="center", ha="left", fontsize=8.0)
    if row.evidence is not None:
        x0, x1 = EDGES[1] + 0.01, EDGES[2] - 0.015
        ax = figure.add_axes((x0, bottom + 0.36 * height, x1 - x0, 0.58 * height))
        _densities(ax, row)
        x0, x1 = EDGES[2] + 0.02, EDGES[3] - 0.05
        bar = figure.add_axes((x0, bottom + 0.45 * height, x1 - x0, 0.22 * height))
        _contraction(bar, row.evidence.contraction)
    colour = VERDICT_COLOURS[row.verdict]
    dark = row.verdict in (IDENTIFIED, PRIOR, NO_VERDICT)
    figure.text(
        EDGES[3] + 0.025,
        middle,
        row.verdict,
        va="center",
        ha="left",
        fontsize=7.0,
        color="white" if dark else "black",
        bbox={"boxstyle": "round,pad=0.35", "facecolor": colour, "edgecolor": "none"},
    )
    figure.text(EDGES[3] + 0.2, middle, _aside(row), va="center", ha="left", fontsize=7.0)


def _densities(ax: Axes, row: ParameterVerdict) -> None:
    assert row.prior and row.posterior and isinstance(row.scale.prior, Prior)
    low, high = _range(row)
    for density, face, line in ((row.prior, PRIOR_GREY, "0.6"), (row.posterior, POSTERIOR, None)):
        height = density.height / density.peak
        ax.fill_between(density.x, height, color=face, alpha=1.0 if line else 0.75, linewidth=0.0)
        ax.plot(density.x, height, color=line or face, linewidth=0.5)
    ax.set_xlim(low, high)
    ax.set_ylim(0.0, 1.08)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ticks = _ticks(row, low, high)
    ax.set_xticks([t for t, _ in ticks], [text for _, text in ticks], fontsize=6.0)
    ax.tick_params(axis="x", length=2.0, pad=1.0)


def _range(row: ParameterVerdict) -> tuple[float, float]:
    """The prior's middle 98 %, widened to hold the posterior."""
    prior, posterior = row.scale.prior, row.posterior
    assert isinstance(prior, Prior) and posterior is not None
    ends = row.scale.of(prior_values(prior, np.array([0.01, 0.99])))
    walls = row.scale.walls
    if np.isfinite(walls[1]):
        low, high = (float(v) for v in row.scale.of(np.array(walls)))
        if np.isfinite(low):
            return low, high
    return min(float(ends[0]), posterior.x[0]), max(float(ends[1]), posterior.x[-1])


def _ticks(row: ParameterVerdict, low: float, high: float) -> list[tuple[float, str]]:
    """Round natural values within the range, few enough to read."""
    if row.scale.logarithmic:
        powers = range(int(np.ceil(low / np.log(10.0))), int(np.floor(high / np.log(10.0))) + 1)
        step = max(1, len(powers) // 4)
        return [(p * np.log(10.0), f"{10.0**p:g}") for p in powers[::step]]
    if row.scale.kind == "kappa":
        return [(v, t) for v, t in ((0.0, "0"), (1 / 6, "1/6"), (1 / 3, "1/3")) if low <= v <= high]
    if row.scale.kind == "alpha":
        return [(v, f"{v:g}") for v in (0.0, 30.0, 60.0, 90.0) if low <= v <= high]
    from matplotlib.ticker import MaxNLocator

    return [(float(v), f"{v:g}") for v in MaxNLocator(3).tick_values(low, high) if low <= v <= high]


def _contraction(ax: Axes, contraction: float) -> None:
    share = max(contraction, 0.0)
    ax.barh(0.0, 1.0, color="0.92", height=1.0)
    ax.barh(0.0, share, color="0.35", height=1.0)
    ax.set_xlim(0.0, 1.0)
    ax.set_axis_off()
    text = f"{100.0 * min(share, 0.999):.1f} %" if share > 0.99 else f"{100.0 * share:.0f} %"
    ax.text(1.06, 0.0, text, va="center", ha="left", fontsize=6.5, transform=ax.transData)


def _aside(row: ParameterVerdict) -> str:
    """What stands beside the verdict: the number a reader wants, or the partners."""
    e = row.evidence
    if e is None or row.verdict == NO_VERDICT:
        return "" if e is None else "the chains are not reliable"
    unit = row.scale.unit.replace("deg", "°")
    unit = f" {unit}" if unit == "kPa" else unit
    interval = f"{number(e.low, e.kind)} to {number(e.high, e.kind)}{unit}"
    if row.verdict == COMBINATION:
        names = ", ".join(_symbol(name) for name in row.partners)
        return f"with {names}\n(alone {interval})"
    if row.verdict == ONE_SIDED:
        low_open = e.edges[0].support >= e.edges[-1].support
        value = number(e.high if low_open else e.low, e.kind)
        return f"{'below' if low_open else 'above'} {value}{unit} (95 %)"
    return interval


def _symbol(name: str) -> str:
    return quantity(name).symbol if "[" not in name else plain(name, 24)
