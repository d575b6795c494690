"""The mounted state and its force as inferred from a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from biaxbayes.errors import InputError
from biaxbayes.figures.quantities import number, plain, quantity
from biaxbayes.figures.run.regions import CONTENTS, regions
from biaxbayes.figures.style import (
    FINER_UNIT,
    PAGE_MM,
    RUNS,
    SIDE_BY_SIDE_MM,
    Style,
    blank_figure,
    colour,
    few_ticks,
    print_style,
    small_text,
)
from biaxbayes.identifiability.bounded_density import span
from biaxbayes.options import CONTENT
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.draws import mounting_labels
from biaxbayes.specimens.specimen import Specimen

MAX_STATES = 12
ROW_MM = 9.0


@dataclass(frozen=True)
class MountedState:
    """Draws of the stretches and forces of a mounted state, shape (n, 2), reading and truth."""

    label: str
    colour: str
    stretch: np.ndarray
    force: np.ndarray
    reading: np.ndarray
    reading_sd: np.ndarray
    true_stretch: tuple[float, float] | None
    true_force: tuple[float, float] | None


def mounting_figure(
    specimen: Specimen,
    draws: pd.DataFrame,
    *,
    truth: Mapping[str, float] | None = None,
    probability: float = CONTENT,
    width_mm: float = PAGE_MM,
    style: Style = None,
) -> Figure:
    """Draw the mounting stretches, and the posterior of the mounting force with its reading."""
    if not mounting_labels(draws, specimen):
        raise InputError(
            "this run does not infer the mounting stretch",
            remedy="sample with `mounting` noisy, exact or free",
        )
    with print_style(style):
        states = _states(specimen, draws, dict(truth or {}))
        bars = 2 * len(states) * ROW_MM
        if width_mm >= SIDE_BY_SIDE_MM:
            figure = blank_figure(width_mm, max(0.4 * width_mm, bars + 17.0))
            left, right = figure.subplots(1, 2, width_ratios=(0.42, 0.58))
        else:
            side = width_mm - 22.0
            figure = blank_figure(width_mm, side + bars + 34.0)
            left, right = figure.subplots(2, 1, height_ratios=(side, bars))
        _draw_stretches(left, states)
        _draw_forces(right, states, specimen.unit, probability)
    return figure


def _states(
    specimen: Specimen, draws: pd.DataFrame, truth: Mapping[str, float]
) -> list[MountedState]:
    labels = mounting_labels(draws, specimen)[:MAX_STATES]
    shared = labels == ("",)
    readings, sds = specimen.mounting_readings(shared=shared)
    rows = {p.name: i for i, p in enumerate(specimen.protocols)}

    def true_value(kind: str, label: str) -> tuple[float, float] | None:
        """True stretches or forces of a state, if given for it or for all states."""
        for key in (label, ""):
            x, y = (truth.get(name) for name in mounting_names(kind, key))
            if x is not None and y is not None:
                return x, y
        return None

    return [
        MountedState(
            plain(label, 16),
            colour(RUNS[i % len(RUNS)]),
            draws[list(mounting_names("stretch", label))].to_numpy(dtype=float),
            draws[list(mounting_names("force", label))].to_numpy(dtype=float),
            readings[0 if shared else rows[label]],
            sds[0 if shared else rows[label]],
            true_value("stretch", label),
            true_value("force", label),
        )
        for i, label in enumerate(labels)
    ]


def _draw_stretches(ax: Axes, states: list[MountedState]) -> None:
    """Regions of the joint posterior of the mounting stretches."""
    true_values = [s.true_stretch for s in states if s.true_stretch is not None]
    axes = [
        span(*(s.stretch[:, k] for s in states), include=tuple(v[k] for v in true_values))
        for k in range(2)
    ]
    single = len(states) == 1
    for state in states:
        median = np.median(state.stretch, axis=0)
        if (np.ptp(state.stretch, axis=0) == 0.0).any():
            ax.plot(*median, marker="+", color=state.colour)
        else:
            regions(ax, list(state.stretch.T), axes, state.colour, filled=single)
        if not single:
            ax.plot(*median, marker=".", ms=4.0, color=state.colour)
    for value in true_values:
        ax.plot(*value, marker="x", ms=5.0, color="black", linestyle="none")
    ax.axvline(1.0, color="0.6", linewidth=0.6, linestyle=":", zorder=0.5)
    ax.axhline(1.0, color="0.6", linewidth=0.6, linestyle=":", zorder=0.5)
    ax.set(
        xlim=(axes[0].low, axes[0].high),
        ylim=(axes[1].low, axes[1].high),
        xlabel=f"mounting stretch {quantity('mounting_stretch_x').symbol}",
        ylabel=f"mounting stretch {quantity('mounting_stretch_y').symbol}",
    )
    few_ticks(ax.xaxis, 5)
    few_ticks(ax.yaxis, 5)
    contents = ", ".join(f"{100 * c:g}" for c in (CONTENTS if single else (0.9,)))
    note = f"within the law, regions: {contents} %"
    _set_head(ax, note + (r";  $\times$ truth" if true_values else ""))


def _draw_forces(ax: Axes, states: list[MountedState], unit: str, probability: float) -> None:
    """Intervals of the mounting force and of its reading, both about the reading."""
    tail = 0.5 * (1.0 - probability)
    rows = [(state, k) for state in states for k in (0, 1)]
    about = [s.force[:, k] - s.reading[k] for s, k in rows]
    quantiles = np.array([np.quantile(d, [tail, 0.5, 1.0 - tail]) for d in about])
    # half the interval of a normally distributed reading: z sd
    half = norm.ppf(1.0 - tail) * np.array([s.reading_sd[k] for s, k in rows])
    small = max(np.abs(quantiles).max(), half.max()) < 0.5
    scale, shown_unit = (1000.0, FINER_UNIT[unit]) if small else (1.0, unit)
    names = []
    for row, (state, k) in enumerate(rows):
        hue = state.colour if len(states) > 1 else colour("xy"[k])
        low, median, high = scale * quantiles[row]
        width = scale * half[row]
        ax.plot([-width, width], [row + 0.17] * 2, color="0.45", linewidth=1.0)
        ax.plot(0.0, row + 0.17, marker="|", ms=6.0, color="0.45")
        ax.plot([low, high], [row - 0.17] * 2, color=hue, linewidth=2.2, solid_capstyle="butt")
        ax.plot(median, row - 0.17, marker="o", ms=3.2, mfc="white", mec=hue, mew=0.8)
        if state.true_force is not None:
            true = scale * (state.true_force[k] - state.reading[k])
            ax.plot(true, row - 0.17, marker="x", ms=4.5, color="black", zorder=4)
        value = number(state.reading[k], 0.0, max(2.0 * half[row], abs(state.reading[k]) / 50.0))
        names.append(f"{state.label} {'xy'[k]}\n{value} {unit}".strip())
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    reach = 1.05 * (float(np.abs(ax.dataLim.intervalx).max()) or 1e-3)
    ax.set_xlim(-reach, reach)
    few_ticks(ax.xaxis, 5)
    ax.axvline(0.0, color="0.6", linewidth=0.6, linestyle=":", zorder=0.5)
    ax.set_xlabel(f"mounting force less its reading ({shown_unit})")
    content = f"{100 * probability:g} %"
    _set_head(ax, f"grey: reading, {content};  colour: posterior, {content}")


def _set_head(ax: Axes, text: str) -> None:
    ax.set_title(text, loc="right", **small_text(color="0.3"))
