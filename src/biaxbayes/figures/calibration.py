"""Ranks of the true values in a calibration study, against uniformity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.calibration.ranks import count_band, rank_counts, uniformity_p_value
from biaxbayes.figures.quantities import quantity
from biaxbayes.figures.style import PAGE_MM, blank_figure, colour, print_style

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 4


def rank_figure(ranks: pd.DataFrame, draws: int, style: Mapping[str, Any] | None = None) -> Figure:
    """One panel per quantity: the empirical distribution of the ranks less the uniform one.

    Parameters
    ----------
    ranks : DataFrame
        One row per replication and quantity, with ``parameter``, ``unit`` and ``rank``.
    draws : int
        Draws that a true value was ranked among.
    style : mapping, optional
        From :func:`~biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
        The grey band holds all of a uniform study's curve with probability 0.95.
    """
    groups = list(ranks.groupby("parameter", sort=False))
    rows = -(-len(groups) // COLUMNS)
    with print_style(style):
        figure = blank_figure(PAGE_MM, 36.0 * rows + 12.0)
        axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for ax, (name, group) in zip(axes.flat, groups, strict=False):
            values, unit = group["rank"].to_numpy(dtype=int), str(group["unit"].iloc[0])
            _draw_ranks(ax, values, draws)
            p = uniformity_p_value(values, draws)
            symbol = quantity(str(name), "" if unit == "-" else unit).symbol
            ax.set_title(f"{symbol}  ($p$ = {p:.2g})")
        for ax in axes.flat[len(groups) :]:
            ax.remove()
        for ax in axes.flat[max(len(groups) - COLUMNS, 0) : len(groups)]:
            ax.tick_params(labelbottom=True)
        figure.supxlabel("rank of the true value among the posterior draws, relative")
        figure.supylabel("distribution of the ranks\nless the uniform one")
    return figure


def _draw_ranks(ax: Axes, ranks: np.ndarray, draws: int) -> None:
    n = ranks.size
    z = np.arange(1, draws + 1) / (draws + 1)
    low, high = (count / n - z for count in count_band(n, draws))
    # difference of the empirical and the uniform distribution: F_n(z) - z
    difference = rank_counts(ranks, draws) / n - z
    outside = bool(np.any((difference < low - 1e-12) | (difference > high + 1e-12)))
    ax.fill_between(z, low, high, color="0.85", linewidth=0.0, step="mid")
    ax.axhline(0.0, color="0.5", linewidth=0.5)
    ax.step(z, difference, where="mid", color=colour("y" if outside else "x"))
    ax.set_xlim(0.0, 1.0)
    ax.set_xticks([0.0, 0.5, 1.0], ["0", "0.5", "1"])
