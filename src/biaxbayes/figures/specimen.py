"""A specimen as recorded: protocol by protocol, with deterministic fits, and the whole record.

Of a protocol loads in x and y are drawn over their stretches, of a whole record over its rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from biaxbayes.evenly import evenly_chosen
from biaxbayes.figures import style
from biaxbayes.figures.bands import curve_names, load_panels
from biaxbayes.figures.quantities import plain
from biaxbayes.fitting.fit_result import FitResult
from biaxbayes.options import FIT_METHODS
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tables.table import in_lines

if TYPE_CHECKING:
    from biaxbayes.machines.outcome import Conversion

POINTS, REST_POINTS = 300, 50
"""Rows of a curve, and rows at rest, that are drawn."""
FIXED = 0.05
"""Extent of a stretch over that of the other direction, up to which it is fixed."""
PANEL_MM = (56.0, 48.0)
MAX_PANELS = 24


@style.print_style()
def specimen_figure(specimen: Specimen) -> Figure:
    """Draw the first 24 protocols, at most 300 rows each; the rows at rest in black."""
    protocols, panels = specimen.protocols[:MAX_PANELS], load_panels(specimen)
    columns = 2 if len(protocols) == 4 else min(3, len(protocols))
    rows = math.ceil(len(protocols) / columns) * len(panels)
    width = max(columns * PANEL_MM[0], style.COLUMN_MM)
    figure = style.blank_figure(width, rows * PANEL_MM[1] + 14.0)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for ax in grid[-len(panels) :, (len(protocols) - 1) % columns + 1 :].flat:
        ax.remove()
    for k, protocol in enumerate(protocols):
        down, across = len(panels) * (k // columns), k % columns
        for i, (label, directions) in enumerate(panels):
            ax = grid[down + i, across]
            if k:
                ax.sharey(grid[i, 0])
            _draw_protocol(ax, protocol, directions)
            ax.tick_params(labelbottom=True, labelleft=across == 0)
            if across == 0:
                ax.set_ylabel(label)
        if len(specimen.protocols) > 1:
            grid[down, across].set_title(plain(protocol.name, 34))
    figure.supxlabel("measured stretch")
    names, handles = curve_names(specimen, 24), []
    for k in specimen.experiment.axes:
        handles.append(Line2D([], [], ms=2.0, lw=0.5, label=names[k], **_look("xy"[k])))
    if specimen.experiment.is_mounted:
        cross: dict[str, Any] = {"color": "black", "marker": "+", "linestyle": ""}
        handles.append(Line2D([], [], ms=6.0, label="rows at rest", **cross))
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _over(protocol: Protocol, axis: int) -> np.ndarray:
    """The stretch that a load is drawn over: its own, or the other one where that is fixed."""
    extent = np.ptp(protocol.known_stretch, axis=0)
    return protocol.stretch[:, axis if extent[axis] > FIXED * extent[1 - axis] else 1 - axis]


def _look(axis: str) -> dict[str, Any]:
    return {"color": style.colour(axis), "marker": style.AXIS_MARKERS[axis]}


def _draw_protocol(ax: Axes, protocol: Protocol, directions: Sequence[int]) -> None:
    shown = evenly_chosen(protocol.rows, POINTS)
    rest = slice(0, protocol.rest_rows, max(1, protocol.rest_rows // REST_POINTS))
    for k in directions:
        stretch, load = _over(protocol, k), protocol.recorded_load[:, k]
        ax.plot(stretch[shown], load[shown], ms=2.0, mew=0.0, lw=0.5, **_look("xy"[k]))
        ax.plot(stretch[rest], load[rest], "+", ms=6.0, mew=0.8, color="black", zorder=2.1)
    ax.axhline(0.0, color="0.75", linewidth=0.5, zorder=0)
    ax.margins(x=0.04, y=0.06)
    ax.locator_params(axis="x", nbins=5)


# --- deterministic fits --------------------------------------------------------------------------

MAX_DRAWN_PROTOCOLS, DATA_POINTS = 6, 40
AXIS_DASHES = {"x": "-", "y": "--"}
# Fits often coincide: the first are wide, and the last lie narrow on top of them.
WIDTHS = np.linspace(2.6, 0.5, len(FIT_METHODS))
LOOKS: dict[str, dict[str, Any]] = {
    method: {"color": f"C{k}", "linewidth": WIDTHS[k]} for k, method in enumerate(FIT_METHODS)
}
DATA: dict[str, Any] = {"color": "0.3", "mfc": "none", "mew": 0.5, "ms": 2.5}


@style.print_style()
def fits_figure(specimen: Specimen, fits: Sequence[FitResult]) -> Figure:
    """Draw measured and fitted loads, and residuals, of the first six protocols of all pieces."""
    tested = [(piece, p) for piece in specimen.pieces for p in piece.protocols]
    count = min(len(tested), MAX_DRAWN_PROTOCOLS)
    columns = min(3, count)
    blocks = -(-count // columns)
    units = max(len(load_panels(piece)) for piece, _ in tested[:count])
    width = style.COLUMN_MM if columns == 1 else style.PAGE_MM
    figure = style.blank_figure(width, 78.0 * blocks * units + 18.0)
    heights = (3.0, 1.4) * (blocks * units)
    grid = figure.subplots(
        len(heights), columns, squeeze=False, height_ratios=heights, sharex="col"
    )
    drawn = []
    for k, (piece, protocol) in enumerate(tested[:count]):
        column = grid[2 * units * (k // columns) :, k % columns]
        for i, (label, directions) in enumerate(load_panels(piece)):
            upper, lower = column[2 * i : 2 * i + 2]
            _draw_fits(upper, lower, piece, protocol, directions, fits, k)
            if k % columns == 0 or piece.test != specimen.test:
                upper.set_ylabel(label)
                lower.set_ylabel(f"data − fit ({piece.units[directions[0]]})")
            drawn += [upper, lower]
        if len(tested) > 1:
            own = "" if piece.name == specimen.name else f"{piece.name}: "
            column[0].set_title(plain(own + protocol.name, 30))
    for ax in set(grid.flat) - set(drawn):
        ax.remove()
    handles = []
    for k in sorted({k for piece in specimen.pieces for k in piece.experiment.axes}):
        marker, dashes = style.AXIS_MARKERS["xy"[k]], AXIS_DASHES["xy"[k]]
        look: dict[str, Any] = {"marker": marker, "linestyle": dashes, **DATA}
        handles.append(Line2D([], [], label=curve_names(specimen, 20)[k], **look))
    handles += [Line2D([], [], label=fit.method, **LOOKS[fit.method]) for fit in fits]
    ncols = 3 if columns == 1 else len(handles)
    figure.legend(handles=handles, loc="outside upper center", ncols=ncols)
    left = len(tested) - count
    more = f" ({left} more protocols not drawn)" if left else ""
    figure.supxlabel("measured stretch" + more)
    return figure


def _draw_fits(
    upper: Axes,
    lower: Axes,
    piece: Specimen,
    protocol: Protocol,
    directions: Sequence[int],
    fits: Sequence[FitResult],
    k: int,
) -> None:
    """Loads of protocol k with the fitted ones, and measured minus fitted loads."""
    load, moving = piece.load(protocol), slice(protocol.rest_rows, None)
    points = evenly_chosen(protocol.rows, DATA_POINTS)
    for axis in directions:
        name, stretch = "xy"[axis], _over(protocol, axis)
        upper.plot(stretch[points], load[points, axis], style.AXIS_MARKERS[name], **DATA)
        for fit in fits:
            residual = fit.residuals[k][:, axis] * piece.load_scale[axis]
            look = {"linestyle": AXIS_DASHES[name], **LOOKS[fit.method]}
            upper.plot(stretch[moving], load[moving, axis] - residual, **look)
            lower.plot(stretch[moving], residual, **look)
    lower.axhline(0.0, color="0.6", linewidth=0.5, zorder=0)
    lower.tick_params(labelbottom=True)
    style.limit_ticks(lower.xaxis, 5)


# --- the whole record: rows of each protocol, and those left out with the reason ----------------

RECORD_POINTS = 4_000
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
    return _record_figure(rows, conversion.specimen)


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
    return _record_figure(rows, specimen)


@style.print_style()
def _record_figure(rows: Rows, specimen: Specimen) -> Figure:
    """Stretches, and loads in a panel for each unit."""
    loads = load_panels(specimen)
    measured = [k for k in (0, 1) if np.isfinite(specimen.protocols[0].stretch[0, k])]
    figure = style.blank_figure(style.PAGE_MM, 65.0 * (1 + len(loads)))
    axes = figure.subplots(1 + len(loads), 1, sharex=True)
    _draw_rows(axes[0], rows.stretch, measured, rows)
    axes[0].set_ylabel("stretch as measured")
    for ax, (label, directions) in zip(axes[1:], loads, strict=True):
        _draw_rows(ax, rows.load, directions, rows)
        ax.set_ylabel(label)
    ends = [*rows.parts.values(), len(rows.stretch)][1:]
    for (name, first), end in zip(rows.parts.items(), ends, strict=True):
        letters = int(LETTERS * (end - first) / len(rows.stretch))
        if letters > 3:
            place = (first + 1, 1.0)
            axes[0].annotate(plain(name, letters), place, xycoords=("data", "axes fraction"))
    axes[-1].set_xlabel("row" if rows.lines is None else "line of the file")
    figure.legend(handles=_record_handles(rows, specimen), loc="outside upper center", ncols=3)
    return figure


def _draw_rows(ax: Axes, curves: np.ndarray, directions: list[int], rows: Rows) -> None:
    """Directions of stretch or load over the rows."""
    x = np.arange(1, len(curves) + 1) if rows.lines is None else rows.lines

    def thinned(at: np.ndarray) -> np.ndarray:
        return np.sort(at)[evenly_chosen(at.size, RECORD_POINTS)]

    for k in directions:
        curve = curves[:, k]
        for i, at in enumerate(map(thinned, rows.left.values())):
            ax.plot(x[at], curve[at], GREYS[i % len(GREYS)], color="0.6", ms=3.0, mew=0.5)
        for i, at in enumerate(map(thinned, rows.kept.values())):
            face = "none" if k else style.colour(i)
            ax.plot(x[at], curve[at], "os"[k], color=style.colour(i), mfc=face, ms=2.5, mew=0.5)
        reference = np.array(rows.reference, dtype=int)
        ax.plot(x[reference], curve[reference], "+", color="black", ms=4.5, mew=0.6, zorder=3)
    for first in rows.parts.values():
        ax.axvline(first + 0.5, color="0.75", linewidth=0.5, zorder=0)
    ax.margins(x=0.01)


def _record_handles(rows: Rows, specimen: Specimen) -> list[Line2D]:
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
        looks.append(("o", style.colour(k), 3.0, f"{plain(name, 34)}: {at.size} rows{lines}"))
    if len(rows.kept) > NAMED:
        looks.append(("", "0.2", 3.0, f"and {len(rows.kept) - NAMED} more"))
    for k, (reason, at) in enumerate(list(rows.left.items())[:NAMED]):
        label = f"left out, {plain(reason, 40)}: {at.size}"
        looks.append((GREYS[k % len(GREYS)], "0.6", 3.5, label))
    return [
        Line2D([], [], ls="", marker=m, color=c, mfc="none" if m == "s" else c, ms=ms, label=label)
        for m, c, ms, label in looks
    ]
