"""What to measure next, at a glance: candidates by rank, quantities side by side."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.figures.quantities import quantity
from biaxbayes.figures.style import MM, PAGE_MM, blank_figure, colour, print_style
from biaxbayes.optimal_design.design import Design
from biaxbayes.optimal_design.information_gain import Expected

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LABEL_MM, BAR_MM, ROW_MM, HEAD_MM, FOOT_MM = 35.0, 32.0, 6.5, 11.0, 11.0
LARGEST = 0.8
"""Reduction from which a cell has the darkest shade."""
NOTE_MM, LETTER_MM = 3.6, 1.35
"""Height of a line of the notes, and mean width of a letter."""
CAUTION = "\N{DOUBLE DAGGER}"
"""Marks candidates that come with a caution."""


def design_figure(
    found: Design, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Expected reduction of every quantity's standard deviation, and the information gain.

    Parameters
    ----------
    found : Design
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    rows = len(found.expected)
    notes = ["expected reduction of the sd, per cent; below a symbol: total stretch"]
    if not all(e.trusted for e in found.expected):
        notes.append("* too few effective draws: a rough number, see at_least in design.csv")
    cautions = [f"{CAUTION} {name} {words}" for name, words in found.cautions().items()]
    notes += [line for text in cautions for line in textwrap.wrap(text, int(width_mm / LETTER_MM))]
    foot = FOOT_MM + NOTE_MM * (len(notes) - 1)
    height = HEAD_MM + ROW_MM * rows + foot
    with print_style(style):
        figure = blank_figure(width_mm * MM, height * MM)
        bottom, share = foot / height, ROW_MM * rows / height
        table = (width_mm - LABEL_MM - BAR_MM - 7.0) / width_mm
        cells = figure.add_axes((LABEL_MM / width_mm, bottom, table, share))
        bars = figure.add_axes(
            (1.0 - (BAR_MM + 3.0) / width_mm, bottom, BAR_MM / width_mm, share), sharey=cells
        )
        _cells(cells, found)
        _bars(bars, found.expected)
        for k, note in enumerate(notes):
            said = note.startswith(CAUTION) or (k and notes[k - 1].startswith(CAUTION))
            figure.text(
                (LABEL_MM if k == 0 else 2.0) / width_mm,
                (foot - 4.5 - NOTE_MM * k) / height,
                note,
                va="center",
                color="black" if said else "0.35",
                fontsize=7.0,
            )
    return figure


def _cells(ax: Axes, found: Design) -> None:
    # Where each protocol has a mounted state of its own, these are left to the table.
    own = {q.name for q in found.known.values() if q.state}
    shown = [i for i, name in enumerate(found.quantities) if name not in own]
    values = np.array([e.reduction[shown] for e in found.expected])
    shade = np.clip(values / LARGEST, 0.0, 1.0)
    ax.imshow(shade, cmap="Blues", vmin=0.0, vmax=1.35, aspect="auto", interpolation="nearest")
    for (i, j), value in np.ndenumerate(values):
        hue = "white" if shade[i, j] > 0.75 else "black"
        text = f"{100.0 * max(value, 0.0):.0f}"
        ax.text(j, i, text, ha="center", va="center", fontsize=7.0, color=hue)
    marks = {True: f"{CAUTION} ", False: ""}
    cautions = found.cautions()
    names = [
        marks[e.name in cautions] + e.name + ("" if e.trusted else " *") for e in found.expected
    ]
    ax.set_yticks(range(len(names)), names)
    ax.set_xticks(range(len(shown)), [_symbol(found.quantities[i]) for i in shown])
    ax.xaxis.tick_top()
    ax.tick_params(axis="x", labelsize=7.0)
    ax.tick_params(length=0.0)
    for edge in range(1, len(shown)):
        ax.axvline(edge - 0.5, color="white", linewidth=0.8)
    for edge in range(1, len(names)):
        ax.axhline(edge - 0.5, color="white", linewidth=0.8)
    for spine in ax.spines.values():
        spine.set_visible(False)


def _bars(ax: Axes, expected: tuple[Expected, ...]) -> None:
    gains = [max(e.gain, 0.0) for e in expected]
    errors = [e.gain_error for e in expected]
    ax.barh(
        range(len(gains)),
        gains,
        xerr=errors,
        height=0.6,
        color=colour("run"),
        error_kw={"linewidth": 0.8},
    )
    ax.tick_params(axis="y", labelleft=False, length=0.0)
    ax.set_xlim(left=0.0)
    ax.set_xlabel("information gain (nats)", labelpad=1.5)


def _symbol(name: str) -> str:
    """Symbol of a quantity; derived ones with their stretch on a second line."""
    stem, _, at = name.partition(" at ")
    axis = stem[-1]
    known = {"stiffness": f"$c_{{{axis}{axis}}}$", "cauchy": rf"$\sigma_{axis}$"}
    symbol = known.get(stem[:-2])
    if symbol is None:
        symbol = f"$H_{axis}$" if stem in ("Hx", "Hy") else quantity(stem).symbol
    return f"{symbol}\n{at}" if at else symbol
