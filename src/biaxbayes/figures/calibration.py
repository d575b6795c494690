"""Ranks of the true values in a calibration study, against uniformity."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.calibration.ranks import count_band, rank_counts, uniformity_p_value
from biaxbayes.figures.quantities import quantity
from biaxbayes.figures.style import PAGE_MM, blank_figure, colour, print_style

COLUMNS = 4


def rank_figure(ranks: pd.DataFrame, draws: int) -> Figure:
    """Draw the empirical distribution of the ranks less the uniform one, a panel per quantity."""
    groups = list(ranks.groupby("parameter", sort=False))
    rows = -(-len(groups) // COLUMNS)
    with print_style():
        figure = blank_figure(PAGE_MM, 36.0 * rows + 12.0)
        axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for ax in axes.flat[len(groups) :]:
            ax.remove()
        for ax, (name, group) in zip(axes.flat, groups, strict=False):
            values, unit = group["rank"].to_numpy(dtype=int), str(group["unit"].iloc[0])
            _draw_ranks(ax, values, draws)
            ax.tick_params(labelbottom=True)
            symbol = quantity(str(name), "" if unit == "-" else unit).symbol
            ax.set_title(f"{symbol}  ($p$ = {uniformity_p_value(values, draws):.2g})")
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
