"""Simulated tests: ranks of the true values in a calibration, and what to measure next."""

from __future__ import annotations

import textwrap

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from biaxbayes.calibration.ranks import count_band, rank_counts, uniformity_p_value
from biaxbayes.figures import style
from biaxbayes.figures.panels import PANELS_PER_LINE, draw_cells
from biaxbayes.figures.quantities import quantity
from biaxbayes.optimal_design.design import Design


@style.print_style()
def rank_figure(ranks: pd.DataFrame, draws: int) -> Figure:
    """Draw the empirical distribution of the ranks less the uniform one, a panel per quantity."""
    groups = list(ranks.groupby("parameter", sort=False))
    rows = -(-len(groups) // PANELS_PER_LINE)
    z = np.arange(1, draws + 1) / (draws + 1)
    figure = style.blank_figure(style.PAGE_MM, 36.0 * rows + 12.0)
    axes = figure.subplots(rows, PANELS_PER_LINE, sharex=True, sharey=True, squeeze=False)
    for ax in axes.flat[len(groups) :]:
        ax.remove()
    for ax, (name, group) in zip(axes.flat, groups, strict=False):
        values, unit = group["rank"].to_numpy(dtype=int), str(group["unit"].iloc[0])
        low, high = (count / values.size - z for count in count_band(values.size, draws))
        # difference of the empirical and the uniform distribution: F_n(z) - z
        difference = rank_counts(values, draws) / values.size - z
        outside = bool(np.any((difference < low - 1e-12) | (difference > high + 1e-12)))
        ax.fill_between(z, low, high, color="0.85", linewidth=0.0, step="mid")
        ax.axhline(0.0, color="0.5", linewidth=0.5)
        ax.step(z, difference, where="mid", color=style.colour("y" if outside else "x"))
        ax.set_xlim(0.0, 1.0)
        ax.set_xticks([0.0, 0.5, 1.0], ["0", "0.5", "1"])
        ax.tick_params(labelbottom=True)
        symbol = quantity(str(name), "" if unit == "-" else unit).symbol
        ax.set_title(f"{symbol}  ($p$ = {uniformity_p_value(values, draws):.2g})")
    figure.supxlabel("rank of the true value among the posterior draws, relative")
    figure.supylabel("distribution of the ranks\nless the uniform one")
    return figure


ROW_MM, NOTE_MM, LETTER_MM = 6.5, 3.6, 1.35
"""Height of a candidate and of a line of the notes, and mean width of a letter."""
DARKEST_REDUCTION = 0.8
"""Reduction from which a cell has the darkest shade."""
CAUTION = "\N{DOUBLE DAGGER}"
"""Marks candidates that come with a caution."""


@style.print_style()
def design_figure(design: Design) -> Figure:
    """Expected reduction of every quantity's standard deviation, and the information gain."""
    cautions, expected = design.cautions(), design.expected
    # Mounted states of single protocols are left to the table.
    states = {q.name for q in design.known.values() if q.state}
    shown = [i for i, name in enumerate(design.quantities) if name not in states]
    reduction = np.array([e.reduction[shown] for e in expected])
    faces = colormaps["Blues"](np.clip(reduction / DARKEST_REDUCTION, 0.0, 1.0) / 1.35)
    notes = ["expected reduction of the sd, per cent at least; below a symbol: total stretch"]
    for name, words in cautions.items():
        notes += textwrap.wrap(f"{CAUTION} {name} {words}", int(style.PAGE_MM / LETTER_MM))
    figure = style.blank_figure(style.PAGE_MM, 20.0 + ROW_MM * len(expected) + NOTE_MM * len(notes))
    cells, bars = figure.subplots(1, 2, width_ratios=(0.78, 0.22), sharey=True)
    draw_cells(
        cells,
        [[f"{100.0 * max(v, 0.0):.0f}" for v in row] for row in reduction],
        [[to_hex(face) for face in row] for row in faces],
        rows=[(f"{CAUTION} " if e.name in cautions else "") + e.name for e in expected],
        columns=[quantity(design.quantities[i]).symbol.replace(" at ", "\n") for i in shown],
    )
    bars.barh(range(len(expected)), [e.gain for e in expected], height=0.6, color=style.colour(0))
    bars.tick_params(axis="y", labelleft=False, which="both", length=0.0)
    bars.set_xlim(left=0.0)
    bars.set_xlabel("information gain (nats)")
    style.add_note(figure, "\n".join(notes))
    return figure
