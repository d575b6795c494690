"""Ranks against uniformity: how far their distribution function is off, with bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.findings.rank_bands import count_band, rank_counts, uniformity_p_value
from biaxbayes.output.figures.quantities import quantity
from biaxbayes.output.style import MM, PAGE_MM, colour, print_style

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["rank_figure"]

COLUMNS = 4
ROW_MM = 36.0
FOOT_MM = 12.0


def rank_figure(ranks: pd.DataFrame, draws: int, style: Mapping[str, Any] | None = None) -> Figure:
    """One panel a quantity: the empirical distribution of the ranks less the uniform one.

    Parameters
    ----------
    ranks : DataFrame
        One row a replication and quantity, with ``parameter``, ``unit`` and ``rank``.
    draws : int
        Draws that a true value was ranked among.
    style : mapping, optional
        From :func:`~biaxbayes.output.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
        The grey band holds all of a uniform study's curve with probability 0.95.
    """
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(ranks["parameter"]))
    rows = -(-len(names) // COLUMNS)
    with print_style(style):
        height = rows * ROW_MM + FOOT_MM
        figure = Figure(figsize=(PAGE_MM * MM, height * MM), layout="constrained")
        axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axis, name in zip(axes.flat, names, strict=False):
            group = ranks[ranks["parameter"] == name]
            _panel(axis, group["rank"].to_numpy(dtype=int), draws)
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
    return figure


def _panel(axis: Axes, ranks: np.ndarray, draws: int) -> None:
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
