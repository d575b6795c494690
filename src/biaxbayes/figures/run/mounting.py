"""The mounted state and its force as inferred, and what ignoring the mounting stretch costs."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtri

from biaxbayes.comparison.mounting_bias import TREATMENTS, Ledger
from biaxbayes.errors import InputError
from biaxbayes.figures.labels import few_ticks, shortened
from biaxbayes.figures.quantities import number, quantity
from biaxbayes.figures.run.regions import CONTENTS, moved, regions
from biaxbayes.figures.style import (
    MM,
    PAGE_MM,
    RUNS,
    blank_figure,
    colour,
    font_points,
    layout,
    plain,
    print_style,
    settle,
)
from biaxbayes.identifiability.bounded_density import span
from biaxbayes.options import CONTENT
from biaxbayes.parameters import Quantities, Quantity, mounting_names
from biaxbayes.prediction.bands import evenly_chosen
from biaxbayes.prediction.draws import mounting_labels
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

VISIBLE = 20_000
MAX_STATES = 12
ROW_MM = 9.0
NOTE = 7.0
FINER = {"N": "mN", "kPa": "Pa"}


class State(NamedTuple):
    """One mounted state: draws of its stretches and forces (n, 2), and its reading."""

    key: str
    label: str
    colour: str
    stretch: np.ndarray
    force: np.ndarray
    reading: np.ndarray
    reading_sd: np.ndarray

    def known(self, truth: Mapping[str, float], kind: str) -> tuple[float, float] | None:
        """Its true stretches or forces, where they are stated for it or for all states."""
        for key in (self.key, ""):
            x, y = (truth.get(name) for name in mounting_names(kind, key))
            if x is not None and y is not None:
                return x, y
        return None


def mounting_figure(
    specimen: Specimen,
    draws: pd.DataFrame,
    *,
    truth: Mapping[str, float] | None = None,
    probability: float = CONTENT,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Joint posterior of the mounting stretches; posterior of the mounting force and its reading.

    Parameters
    ----------
    specimen : Specimen
    draws : DataFrame
        One row a draw, columns as in ``summary.csv``.
    truth : mapping, optional
        Known values by the same names.
    probability : float
        Content of the intervals.
    width_mm : float
        Width in print. From 120 mm the panels stand side by side.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If the run did not infer the mounted state.
    """
    if not mounting_labels(draws, specimen):
        raise InputError(
            "this run does not infer the mounting stretch, so there is no mounted state to draw",
            remedy="sample with `mounting` noisy, exact or free",
        )
    with print_style(style):
        states = _states(specimen, draws.iloc[evenly_chosen(len(draws), VISIBLE)])
        figure, first, second = _panels(states, width_mm)
        _stretches(first, states, dict(truth or {}))
        _forces(second, states, specimen.unit, dict(truth or {}), probability)
        settle(figure)
    return figure


def _panels(states: list[State], width_mm: float) -> tuple[Figure, Axes, Axes]:
    """The figure, a square panel and one with a row for each force."""
    if width_mm >= 120.0:
        tall = max(0.4 * width_mm, ROW_MM * 2 * len(states) + 13.0)
        figure = blank_figure(width_mm * MM, tall * MM, layout(across_mm=1.5, down_mm=1.2))
        first, second = figure.subplots(1, 2, width_ratios=(0.42, 0.58))
        return figure, first, second
    side, bars = width_mm - 22.0, 2 * len(states) * ROW_MM
    room = layout(across_mm=1.5, down_mm=1.2)
    figure = blank_figure(width_mm * MM, (side + bars + 26.0) * MM, room)
    first, second = figure.subplots(2, 1, height_ratios=(side, bars))
    return figure, first, second


def _states(specimen: Specimen, draws: pd.DataFrame) -> list[State]:
    labels = mounting_labels(draws, specimen)[:MAX_STATES]
    shared = labels == ("",)
    readings, sds = specimen.mounting_readings(shared=shared)
    rows = {p.name: i for i, p in enumerate(specimen.protocols)}
    out = []
    for i, label in enumerate(labels):
        row = 0 if shared else rows[label]
        stretch, force = (
            draws[list(mounting_names(kind, label))].to_numpy(dtype=float)
            for kind in ("stretch", "force")
        )
        hue = colour(RUNS[i % len(RUNS)])
        out.append(
            State(
                label,
                shortened(label, 28.0, font_points("ytick.labelsize")),
                hue,
                stretch,
                force,
                readings[row],
                sds[row],
            )
        )
    return out


def _stretches(ax: Axes, states: list[State], truth: Mapping[str, float]) -> None:
    """Regions of the joint posterior of the mounting stretches."""
    known = [s.known(truth, "stretch") for s in states]
    axes = []
    for k in range(2):
        include = tuple(v[k] for v in known if v is not None)
        axes.append(span(*(s.stretch[:, k] for s in states), include=include))
    for state, value in zip(states, known, strict=True):
        fixed = np.ptp(state.stretch, axis=0) == 0.0
        if fixed.any():
            ax.plot(*np.median(state.stretch, axis=0), marker="+", color=state.colour)
        else:
            filled = len(states) == 1
            pair = [moved(*one) for one in zip(state.stretch.T, axes, strict=True)]
            regions(ax, pair, state.colour, filled=filled)
        if len(states) > 1:
            ax.plot(*np.median(state.stretch, axis=0), marker=".", ms=4.0, color=state.colour)
        if value is not None:
            ax.plot(*value, marker="x", ms=5.0, color="black", linestyle="none", label="truth")
    for axis in "xy":
        name = quantity(f"mounting_stretch_{axis}").symbol
        few_ticks(getattr(ax, f"{axis}axis"), most=5, overhang=1.0)
        ax.set(**{f"{axis}label": f"mounting stretch {name}"})
    for line in (ax.axvline, ax.axhline):
        line(1.0, color="0.6", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.5)
    ax.set(xlim=(axes[0].low, axes[0].high), ylim=(axes[1].low, axes[1].high))
    contents = ", ".join(f"{100 * c:g}" for c in CONTENTS) if len(states) == 1 else "90"
    note = f"within the law, regions: {contents} %" + (";  $\\times$ truth" if any(known) else "")
    ax.text(0.98, 0.98, note, transform=ax.transAxes, ha="right", va="top", color="0.3", size=NOTE)


def _forces(
    ax: Axes,
    states: list[State],
    unit: str,
    truth: Mapping[str, float],
    probability: float,
) -> None:
    """Interval of the mounting force about its reading, beside the interval of the reading."""
    tail = 0.5 * (1.0 - probability)
    bars = []
    for state, k in product(states, (0, 1)):
        about = state.force[:, k] - state.reading[k]
        low, middle, high = (float(v) for v in np.quantile(about, [tail, 0.5, 1.0 - tail]))
        bars.append(_Bar(low, middle, high, -float(ndtri(tail)) * float(state.reading_sd[k])))
    reach = max(max(-b.low, b.high, b.half) for b in bars)
    scale, finer = (1000.0, FINER[unit]) if reach < 0.5 else (1.0, unit)
    names = []
    for row, bar in enumerate(bars):
        state, k = states[row // 2], row % 2
        hue = state.colour if len(states) > 1 else colour("xy"[k])
        bar.draw(ax, row, scale, hue)
        known = state.known(truth, "force")
        if known is not None:
            about = scale * (known[k] - state.reading[k])
            ax.plot(about, row - 0.17, marker="x", ms=4.5, color="black", zorder=4)
            reach = max(reach, abs(about) / scale)
        value = number(state.reading[k], 0.0, max(2.0 * bar.half, abs(state.reading[k]) / 50.0))
        names.append(f"{state.label} {'xy'[k]}\n{value} {unit}".strip())
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -1.1)
    reach = 1.05 * scale * (reach or 1e-3)
    ax.set_xlim(-reach, reach)
    few_ticks(ax.xaxis, most=5, overhang=2.0)
    ax.axvline(0.0, color="0.6", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.5)
    ax.set_xlabel(f"mounting force less its reading ({finer})")
    content = f"{100 * probability:g} %"
    note = f"grey: reading, {content};  colour: posterior, {content}"
    how: Any = {"ha": "center", "va": "center", "color": "0.3", "size": NOTE}
    ax.text(0.5, -0.95, note, transform=ax.get_yaxis_transform(), **how)


class _Bar(NamedTuple):
    """Posterior interval of a force about its reading, and half that of the reading."""

    low: float
    middle: float
    high: float
    half: float

    def draw(self, ax: Axes, row: int, scale: float, hue: str) -> None:
        half = scale * self.half
        ax.plot([-half, half], [row + 0.17] * 2, color="0.45", linewidth=1.0)
        ax.plot(0.0, row + 0.17, marker="|", ms=6.0, color="0.45")
        ends = [scale * self.low, scale * self.high]
        ax.plot(ends, [row - 0.17] * 2, color=hue, linewidth=2.2, solid_capstyle="butt")
        ax.plot(scale * self.middle, row - 0.17, marker="o", ms=3.2, mfc="white", mec=hue, mew=0.8)


# --- what ignoring the mounting stretch costs ----------------------------------------------------


TREATED = dict(zip(TREATMENTS, ("run", "other", "third"), strict=True))
MARKERS = dict(zip(TREATMENTS, ("o", "s", "^"), strict=True))
LEDGER_ROW_MM = 8.5
OFFSETS = (0.25, 0.0, -0.25)
LARGEST_LINEAR, LINEAR = 15.0, 2.0
"""Up to the first shift the axis is linear; else up to the second, and logarithmic beyond."""
LABELS = (
    "mounting stretch inferred, within the law",
    "ignored",
    "ignored, forces zeroed (medians, 90 %)",
)


def ledger_figure(
    found: Ledger, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians and 90 % intervals of the three treatments.

    Left the parameters, in standard deviations of the inferred posterior; right the stresses,
    relative to the inferred median.

    Parameters
    ----------
    found : Ledger
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    parameters, stresses = found.parameters, found.stresses
    tall = LEDGER_ROW_MM * len(parameters), LEDGER_ROW_MM * len(stresses)
    with print_style(style):
        figure = blank_figure(width_mm * MM, (max(tall) + 20.0) * MM, layout(across_mm=1.5))
        left, right = figure.subplots(1, 2, width_ratios=(0.46, 0.54))
        _parameters(left, parameters, found.known)
        _stresses(right, stresses)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(
            handles,
            labels,
            loc="outside upper center",
            ncols=3,
            columnspacing=2.5,
        )
        settle(figure)
    return figure


def _parameters(ax: Axes, table: Any, known: Quantities) -> None:
    largest = 3.0
    for i, (_, row) in enumerate(table.iterrows()):
        for name, offset in zip(TREATMENTS, OFFSETS, strict=True):
            shifts = [_shift(row, name, level) for level in ("q05", "median", "q95")]
            largest = max(largest, *(abs(s) for s in shifts if np.isfinite(s)))
            _draw(ax, shifts, i - offset, name, first=i == 0)
    broken = _shift_axis(ax, (1.6 if largest > LARGEST_LINEAR else 1.1) * largest)
    labels = [_symbol(known[str(name)]) for name in table["quantity"]]
    title = "shift (standard deviations of the inferred posterior"
    if broken:
        title += f";\nlogarithmic beyond the dotted lines at \u00b1{LINEAR:g})"
    _rows(ax, labels, title if broken else f"{title})")


def _symbol(q: Quantity) -> str:
    """Symbol of a quantity; the protocol of its own mounted state on a second line."""
    p = q.parameter
    symbol = f"${p.symbol}$"
    return f"{symbol}\n{plain(q.state, 8)}" if q.state else symbol


def _shift(row: Any, name: str, level: str) -> float:
    """A quantile of a treatment, in standard deviations from the inferred median."""
    move = np.log if str(row["scale"]).startswith("ln ") else float
    # (q - median inferred) / sd inferred, on the scale of the comparison
    moved = move(row[f"{name}_{level}"]) - move(row["inferred_median"])
    return float(moved / row["inferred_sd"]) if row["inferred_sd"] > 0.0 else np.nan


def _shift_axis(ax: Axes, limit: float) -> bool:
    """To scale where that can be read, else in logs beyond two standard deviations, as marked."""
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

    broken = limit > LARGEST_LINEAR
    if broken:
        ax.set_xscale("symlog", linthresh=LINEAR, linscale=1.0)
        positive = [LINEAR, *(10.0**k for k in range(1, 9) if 10.0**k < limit)]
        values = [-v for v in reversed(positive)] + [0.0, *positive]
        texts = [f"{v:g}".replace("-", "\N{MINUS SIGN}") for v in values]
        ax.xaxis.set_major_locator(FixedLocator(values))
        ax.xaxis.set_major_formatter(FixedFormatter(texts))
        ax.xaxis.set_minor_locator(NullLocator())
        for end in (-LINEAR, LINEAR):
            ax.axvline(end, color="0.4", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.5)
    ax.set_xlim(-limit, limit)
    return broken


def _stresses(ax: Axes, table: Any) -> None:
    labels = []
    for i, (_, row) in enumerate(table.iterrows()):
        centre = row["inferred_median"]
        for name, offset in zip(TREATMENTS, OFFSETS, strict=True):
            # 100 (s / median inferred - 1)
            values = [100.0 * (row[f"{name}_{q}"] / centre - 1.0) for q in ("q05", "median", "q95")]
            _draw(ax, values, i - offset, name, first=False)
        axis = str(row["quantity"])[-1]
        value = number(centre, row["inferred_q05"], row["inferred_q95"])
        labels.append(rf"$\sigma_{axis}$ at {row['total_stretch']:.4g}" + f"\n({value} kPa)")
    _rows(ax, labels, "stress relative to the inferred median (%)")


def _draw(ax: Axes, values: list[float], y: float, name: str, *, first: bool) -> None:
    hue = colour(TREATED[name])
    low, median, high = values
    ax.plot([low, high], [y, y], color=hue, linewidth=1.4, solid_capstyle="butt")
    label = LABELS[TREATMENTS.index(name)] if first else None
    ax.plot(median, y, MARKERS[name], color=hue, markersize=3.2, label=label)


def _rows(ax: Axes, labels: list[str], title: str) -> None:
    ax.axvline(0.0, color="0.6", linewidth=0.6, zorder=0)
    for i in range(len(labels)):
        if i % 2:
            ax.axhspan(i - 0.5, i + 0.5, color="0.95", linewidth=0.0, zorder=-1)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_yticks(range(len(labels)), labels, linespacing=1.0)
    ax.tick_params(axis="y", length=0.0)
    ax.spines["left"].set_visible(False)
    ax.set_xlabel(title)
