"""A whole record over its rows: those of each protocol, and those left out with the reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from biaxbayes.evenly import evenly_chosen
from biaxbayes.figures.bands import load_panels
from biaxbayes.figures.quantities import plain
from biaxbayes.figures.style import PAGE_MM, blank_figure, colour, print_style
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tables.table import in_lines

if TYPE_CHECKING:
    from biaxbayes.machines.outcome import Conversion

POINTS = 4_000
"""Rows of a protocol, or of a reason, that are drawn."""
LETTERS = 75
"""Letters that fit above the record."""
NAMED = 12
"""Protocols and reasons that the legend names."""
GREYS = ("x", "+", "1", "|", "d", "2", "*", "3")
"""Markers of the reasons for which rows were left out."""


@dataclass
class Rows:
    """Readings of all rows, and what became of them."""

    stretch: np.ndarray  # (n, 2)
    load: np.ndarray  # (n, 2)
    kept: dict[str, np.ndarray] = field(default_factory=dict)  # rows by protocol
    left: dict[str, np.ndarray] = field(default_factory=dict)  # rows by reason
    reference: list[int] = field(default_factory=list)  # rows at rest
    parts: dict[str, int] = field(default_factory=dict)  # first row by file, sheet or set
    lines: np.ndarray | None = None  # of the file, where it is a single one


def conversion_figure(conversion: Conversion) -> Figure:
    """Draw all rows of the files that were converted."""
    records = conversion.records
    ends = np.cumsum([r.lines.size for r in records]).tolist()
    first = {id(r): end - r.lines.size for r, end in zip(records, ends, strict=True)}
    rows = Rows(
        np.concatenate([r.stretch for r in records]), np.concatenate([r.load for r in records])
    )
    left = np.concatenate([r.reasons for r in records])
    for r, p in zip(conversion.recordings, conversion.specimen.protocols, strict=True):
        at = first[id(r.record)] + r.rows
        rows.kept[p.name] = at
        rows.reference += at[: p.rest_rows].tolist()
        left[at] = ""
    rows.left = {k: np.flatnonzero(left == k) for k in dict.fromkeys(left.tolist()) if k}
    if len(records) > 1:
        rows.parts = {r.source: first[id(r)] for r in records}
    else:
        rows.lines = records[0].lines
    return _figure(rows, conversion.specimen)


def protocols_figure(specimen: Specimen) -> Figure:
    """Draw all rows of a specimen file."""
    rows = Rows(
        np.concatenate([p.stretch * p.reference for p in specimen.protocols]),
        np.concatenate([p.recorded_load for p in specimen.protocols]),
    )
    first = 0
    for p in specimen.protocols:
        rows.kept[p.name] = np.arange(first, first + p.rows)
        rows.reference += range(first, first + p.rest_rows)
        first += p.rows
    return _figure(rows, specimen)


@print_style()
def _figure(rows: Rows, specimen: Specimen) -> Figure:
    """Stretches, and loads in a panel for each unit."""
    loads = load_panels(specimen)
    measured = [k for k in (0, 1) if np.isfinite(specimen.protocols[0].stretch[0, k])]
    figure = blank_figure(PAGE_MM, 65.0 * (1 + len(loads)))
    axes = figure.subplots(1 + len(loads), 1, sharex=True)
    _draw(axes[0], rows.stretch, measured, rows)
    axes[0].set_ylabel("stretch as measured")
    for ax, (label, directions) in zip(axes[1:], loads, strict=True):
        _draw(ax, rows.load, directions, rows)
        ax.set_ylabel(label)
    ends = [*rows.parts.values(), len(rows.stretch)][1:]
    for (name, first), end in zip(rows.parts.items(), ends, strict=True):
        letters = int(LETTERS * (end - first) / len(rows.stretch))
        if letters > 3:
            place = (first + 1, 1.0)
            axes[0].annotate(plain(name, letters), place, xycoords=("data", "axes fraction"))
    axes[-1].set_xlabel("row" if rows.lines is None else "line of the file")
    figure.legend(handles=_handles(rows, specimen), loc="outside upper center", ncols=3)
    return figure


def _draw(ax: Axes, curves: np.ndarray, directions: list[int], rows: Rows) -> None:
    """Directions of stretch or load over the rows."""
    x = np.arange(1, len(curves) + 1) if rows.lines is None else rows.lines
    for k in directions:
        curve = curves[:, k]
        for i, at in enumerate(map(_thinned, rows.left.values())):
            ax.plot(x[at], curve[at], GREYS[i % len(GREYS)], color="0.6", ms=3.0, mew=0.5)
        for i, at in enumerate(map(_thinned, rows.kept.values())):
            face = "none" if k else colour(i)
            ax.plot(x[at], curve[at], "os"[k], color=colour(i), mfc=face, ms=2.5, mew=0.5)
        reference = np.array(rows.reference, dtype=int)
        ax.plot(x[reference], curve[reference], "+", color="black", ms=4.5, mew=0.6, zorder=3)
    for first in rows.parts.values():
        ax.axvline(first + 0.5, color="0.75", linewidth=0.5, zorder=0)
    ax.margins(x=0.01)


def _thinned(at: np.ndarray) -> np.ndarray:
    return np.sort(at)[evenly_chosen(at.size, POINTS)]


def _handles(rows: Rows, specimen: Specimen) -> list[Line2D]:
    """Entries of the legend: marker, colour, size and label."""
    drawn = np.isfinite(specimen.protocols[0].stretch[0])
    drawn[list(specimen.experiment.axes)] = True
    looks: list[tuple[str, str, float, str]] = [
        ("os"[k], "0.2", 3.0, "xy"[k]) for k in np.flatnonzero(drawn)
    ]
    if specimen.experiment.is_mounted:
        looks.append(("+", "black", 6.0, "reference (at rest)"))
    for k, (name, at) in enumerate(list(rows.kept.items())[:NAMED]):
        lines = "" if rows.lines is None else f", lines {in_lines(rows.lines[at], shown=2)}"
        looks.append(("o", colour(k), 3.0, f"{plain(name, 34)}: {at.size} rows{lines}"))
    if len(rows.kept) > NAMED:
        looks.append(("", "0.2", 3.0, f"and {len(rows.kept) - NAMED} more"))
    for k, (reason, at) in enumerate(list(rows.left.items())[:NAMED]):
        label = f"left out, {plain(reason, 40)}: {at.size}"
        looks.append((GREYS[k % len(GREYS)], "0.6", 3.5, label))
    return [
        Line2D([], [], ls="", marker=m, color=c, mfc="none" if m == "s" else c, ms=ms, label=label)
        for m, c, ms, label in looks
    ]
