"""The mounted state: how far the specimen was stretched, and the force that holds it there."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtri

from biaxbayes.errors import InputError
from biaxbayes.findings.bands import evenly_chosen
from biaxbayes.findings.bounded_density import Span, span, surface
from biaxbayes.findings.material_draws import mounting_labels
from biaxbayes.inference.assemble import mounting_names
from biaxbayes.output.figures.lettering import shortened, text_width
from biaxbayes.output.figures.numbers import number
from biaxbayes.output.figures.quantities import quantity
from biaxbayes.output.figures.regions import CONTENTS, regions
from biaxbayes.output.figures.ticks import choose_ticks, set_ticks
from biaxbayes.output.style import MM, PAGE_MM, colour, font_points, print_style
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["mounting_figure"]

VISIBLE = 20_000
MAX_STATES = 12
ROLES = ("run", "other", "third", "fourth", "fifth", "sixth")
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
    probability: float = 0.9,
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
        From :func:`biaxbayes.output.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If the run did not infer the mounted state.
    """
    if not mounting_labels(draws):
        raise InputError(
            "this run does not infer the mounting stretch, so there is no mounted state to draw",
            remedy="sample with --mounting noisy, exact or free",
        )
    with print_style(style):
        states = _states(specimen, draws.iloc[evenly_chosen(len(draws), VISIBLE)])
        figure, (first, side), (second, length) = _panels(states, width_mm)
        _stretches(first, states, dict(truth or {}), side)
        _forces(second, states, specimen.unit, dict(truth or {}), probability, length)
    return figure


def _panels(
    states: list[State], width_mm: float
) -> tuple[Figure, tuple[Axes, float], tuple[Axes, float]]:
    """The figure and its two panels with their widths in mm."""
    from matplotlib.figure import Figure

    wide = width_mm >= 120.0
    side = 56.0 if wide else width_mm - 22.0
    bars = 2 * len(states) * (ROW_MM if len(states) > 1 or not wide else 1.6 * ROW_MM)
    size = font_points("ytick.labelsize")
    names = max(14.0, *(text_width(f"{s.label} x", size) for s in states)) + 4.0
    if wide:
        height = max(side, bars) + 16.0
        left, length = side + 26.0 + names, width_mm - side - 29.0 - names
        corners = (18.0, height - 3.0 - side), (left, height - 3.0 - bars)
    else:
        height, length = side + bars + 32.0, width_mm - 4.0 - names
        corners = (18.0, bars + 29.0), (names, 13.0)
    figure = Figure((width_mm * MM, height * MM))
    panels = []
    for (x, y), across, up in zip(corners, (side, length), (side, bars), strict=True):
        place = (x / width_mm, y / height, across / width_mm, up / height)
        panels.append((figure.add_axes(place), across))
    return figure, panels[0], panels[1]


def _states(specimen: Specimen, draws: pd.DataFrame) -> list[State]:
    labels = mounting_labels(draws)[:MAX_STATES]
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
        hue = colour(ROLES[i % len(ROLES)])
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


def _stretches(ax: Axes, states: list[State], truth: Mapping[str, float], side: float) -> None:
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
            x, y, density = surface(state.stretch[:, 0], state.stretch[:, 1], (axes[0], axes[1]))
            regions(ax, x, y, density, state.colour, filled=len(states) == 1)
        if len(states) > 1:
            ax.plot(*np.median(state.stretch, axis=0), marker=".", ms=4.0, color=state.colour)
        if value is not None:
            ax.plot(*value, marker="x", ms=5.0, color="black", linestyle="none", label="truth")
    for k, axis in enumerate("xy"):
        shown, name = axes[k], quantity(f"mounting_stretch_{axis}").symbol
        size = font_points(f"{axis}tick.labelsize")
        ticks = choose_ticks(shown, side, size, horizontal=axis == "x", overhang=1.0, most=5)
        set_ticks(ax.xaxis if axis == "x" else ax.yaxis, ticks, labels=True)
        ax.set(
            **{f"{axis}lim": (shown.low, shown.high), f"{axis}label": f"mounting stretch {name}"}
        )
    ax.yaxis.set_label_coords(-14.0 / side, 0.5)
    for line in (ax.axvline, ax.axhline):
        line(1.0, color="0.6", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.5)
    ax.set(xlim=(axes[0].low, axes[0].high), ylim=(axes[1].low, axes[1].high))
    contents = ", ".join(f"{100 * c:g}" for c in CONTENTS) if len(states) == 1 else "90"
    note = f"regions: {contents} %" + (";  $\\times$ truth" if any(known) else "")
    ax.text(0.98, 0.98, note, transform=ax.transAxes, ha="right", va="top", color="0.3", size=NOTE)


def _forces(
    ax: Axes,
    states: list[State],
    unit: str,
    truth: Mapping[str, float],
    probability: float,
    length: float,
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
    shown = Span(-reach, reach)
    ax.set_xlim(shown.low, shown.high)
    size = font_points("xtick.labelsize")
    ticks = choose_ticks(shown, length, size, horizontal=True, overhang=2.0, most=5)
    set_ticks(ax.xaxis, ticks, labels=True)
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
