"""The mounted specimen: hooks and their effect on the loads; the mounted state that a run infers.

The effect of hooks is a sketch to scale, and the force on hooks over that of a uniform test.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from scipy.stats import norm

from biaxbayes.errors import InputError
from biaxbayes.fem.sheet_tester import GAUGE
from biaxbayes.figures import style
from biaxbayes.figures.corner import CONTENTS, draw_regions
from biaxbayes.figures.quantities import plain, quantity
from biaxbayes.grips.hooks import edges_mm, stated_hooks
from biaxbayes.identifiability.bounded_density import span
from biaxbayes.options import CONTENT
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.draws import mounting_labels
from biaxbayes.prediction.percentiles import tails
from biaxbayes.report_table import MINUS, number
from biaxbayes.specimens.specimen import Specimen

# --- hooks ---------------------------------------------------------------------------------------

MAX_DRAWN_PROTOCOLS, HEIGHT_MM = 6, 55.0


@style.print_style()
def grips_figure(specimen: Specimen, ratios: pd.DataFrame) -> Figure:
    """Sketch the sheet and its hooks; draw the hook load over the uniform one, with two sd."""
    names = ratios["protocol"].drop_duplicates().to_list()[:MAX_DRAWN_PROTOCOLS]
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure = style.blank_figure(style.PAGE_MM, HEIGHT_MM * rows)
    widths = (1.0, 0.75 + columns)
    ((left, right),) = figure.subfigures(1, 2, squeeze=False, width_ratios=widths)
    _draw_sketch(left.subplots(), specimen)
    axes = right.subplots(rows, columns, squeeze=False, sharey=True)
    for ax in axes.flat[len(names) :]:
        ax.set_visible(False)
    for ax, name in zip(axes.flat, names, strict=False):
        table = ratios[ratios["protocol"] == name]
        for axis, line in (("x", "-"), ("y", "--")):
            hue, stretch = style.colour(axis), table[f"stretch_{axis}"]
            ratio = table[f"force_ratio_{axis}"]
            two_sd = 2.0 * ratio * table[f"sd_log_force_ratio_{axis}"]
            ax.plot(stretch, ratio, line, color=hue, label=axis)
            band = ratio - two_sd, ratio + two_sd
            ax.fill_between(stretch, *band, color=hue, alpha=style.BAND_OPACITY["credible"], lw=0)
        ax.set_xlabel("stretch")
        style.limit_ticks(ax.xaxis, 4)
        if len(names) > 1:
            ax.set_title(plain(str(name), 30))
    axes[0, 0].set_ylabel("force on hooks /\nforce of a uniform test")
    axes[0, 0].legend()
    return figure


@style.print_style()
def sketch_figure(specimen: Specimen) -> Figure:
    """Sketch of the unloaded sheet, its hooks and the markers, to scale."""
    a, b = edges_mm(specimen)
    figure = style.blank_figure(style.COLUMN_MM, style.COLUMN_MM * max(b / a, 0.5))
    ax = figure.subplots()
    _draw_sketch(ax, specimen)
    ax.set_anchor("N")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _draw_sketch(ax: Axes, specimen: Specimen) -> None:
    """The whole sheet in mm: patches that the hooks of x and y move, and the markers."""
    hooks, (a, b) = stated_hooks(specimen), edges_mm(specimen)
    ax.add_patch(Rectangle((-a / 2.0, -b / 2.0), a, b, fill=False, color="0.3"))
    for axis, (across, along) in zip("xy", ((a, b), (b, a)), strict=True):
        offsets = (np.arange(hooks.count) - 0.5 * (hooks.count - 1.0)) * hooks.spacing(along)
        for side in (-1.0, 1.0):
            for offset in offsets:
                position = (side * (across / 2.0 - hooks.inset_mm), float(offset))
                centre = position if axis == "x" else position[::-1]
                label = f"hooks in {axis}" if side > 0.0 and offset == offsets[0] else None
                look: dict[str, Any] = {"color": style.colour(axis), "alpha": 0.6, "lw": 0}
                ax.add_patch(Circle(centre, hooks.radius_mm, label=label, **look))
    if specimen.metadata.get("stretch_from", "markers") == "markers":
        x, y = 0.5 * GAUGE * a, 0.5 * GAUGE * b
        ax.plot([x, x, -x, -x], [y, -y, y, -y], "s", color="0.3", ms=2.0, label="markers")
    ax.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
    ax.autoscale_view()


# --- the mounted state ---------------------------------------------------------------------------

MAX_STATES = 12
ROW_MM = 9.0


class DrawnState(NamedTuple):
    """A mounted state: draws (n, 2) of its stretch and force, reading, and truth (NaN: unknown)."""

    label: str
    colour: str
    stretch: np.ndarray
    force: np.ndarray
    reading: np.ndarray
    reading_sd: np.ndarray
    true_stretch: list[float]
    true_force: list[float]


@style.print_style()
def mounting_figure(
    specimen: Specimen,
    draws: pd.DataFrame,
    *,
    truth: Mapping[str, float] | None = None,
    width_mm: float = style.PAGE_MM,
) -> Figure:
    """Draw the mounting stretches, and the posterior of the mounting force with its reading."""
    if not specimen.experiment.is_biaxial:
        raise InputError(
            "the mounting figure is that of a biaxial test, x against y",
            remedy="draw the figure corner",
        )
    if not mounting_labels(draws, specimen):
        raise InputError(
            "this run does not infer the mounting stretch",
            remedy="sample with `mounting` noisy, exact or free",
        )
    states = _states(specimen, draws, dict(truth or {}))
    bars = 2 * len(states) * ROW_MM
    if width_mm >= style.SIDE_BY_SIDE_MM:
        figure = style.blank_figure(width_mm, max(0.4 * width_mm, bars + 17.0))
        left, right = figure.subplots(1, 2, width_ratios=(0.42, 0.58))
    else:
        side = width_mm - 22.0
        figure = style.blank_figure(width_mm, side + bars + 34.0)
        left, right = figure.subplots(2, 1, height_ratios=(side, bars))
    _draw_stretches(left, states)
    _draw_forces(right, states, specimen.unit)
    return figure


def _states(
    specimen: Specimen, draws: pd.DataFrame, truth: Mapping[str, float]
) -> list[DrawnState]:
    labels = mounting_labels(draws, specimen)[:MAX_STATES]
    readings, sds = specimen.mounting_readings(shared=labels == ("",))
    rows = {"": 0} | {p.name: i for i, p in enumerate(specimen.protocols)}
    states = []
    for i, label in enumerate(labels):
        values, true = [], []
        for kind in ("stretch", "force"):
            names = mounting_names(kind, label)
            values.append(draws[list(names)].to_numpy(dtype=float))
            own = zip(names, mounting_names(kind), strict=True)
            true.append([truth.get(name, truth.get(common, np.nan)) for name, common in own])
        reading, sd = readings[rows[label]], sds[rows[label]]
        look = plain(label, 16), style.colour(i)
        states.append(DrawnState(*look, values[0], values[1], reading, sd, true[0], true[1]))
    return states


def _draw_stretches(ax: Axes, states: list[DrawnState]) -> None:
    """Regions of the joint posterior of the mounting stretches."""
    true_values = [s.true_stretch for s in states if np.isfinite(s.true_stretch).all()]
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
            draw_regions(ax, list(state.stretch.T), axes, state.colour, filled=single)
        if not single:
            ax.plot(*median, marker=".", ms=4.0, color=state.colour)
    for value in true_values:
        ax.plot(*value, marker="x", ms=5.0, color="black", linestyle="none")
    ax.axvline(1.0, **style.REFERENCE)
    ax.axhline(1.0, **style.REFERENCE)
    ax.set(
        xlim=(axes[0].low, axes[0].high),
        ylim=(axes[1].low, axes[1].high),
        xlabel=f"mounting stretch {quantity('mounting_stretch_x').symbol}",
        ylabel=f"mounting stretch {quantity('mounting_stretch_y').symbol}",
    )
    for axis in (ax.xaxis, ax.yaxis):
        style.limit_ticks(axis, 5)
    contents = ", ".join(f"{100 * c:g}" for c in (CONTENTS if single else (0.9,)))
    title = f"regions: {contents} %" + (r";  $\times$ truth" if true_values else "")
    ax.set_title(title, loc="right", **style.small_text(color="0.3"))


def _draw_forces(ax: Axes, states: list[DrawnState], unit: str) -> None:
    """Intervals of the mounting force and of its reading, both about the reading."""
    low_tail, high_tail = tails(CONTENT)
    rows = [(state, k) for state in states for k in (0, 1)]
    about = [s.force[:, k] - s.reading[k] for s, k in rows]
    quantiles = np.array([np.quantile(d, [low_tail, 0.5, high_tail]) for d in about])
    # half the interval of a normally distributed reading: z sd
    half = norm.ppf(high_tail) * np.array([s.reading_sd[k] for s, k in rows])
    small = max(np.abs(quantiles).max(), half.max()) < 0.5
    scale, shown_unit = (1000.0, style.FINER_UNIT[unit]) if small else (1.0, unit)
    names = []
    for row, (state, k) in enumerate(rows):
        hue = state.colour if len(states) > 1 else style.colour("xy"[k])
        low, median, high = scale * quantiles[row]
        width = scale * half[row]
        ax.plot([-width, width], [row + 0.17] * 2, color="0.45", linewidth=1.0)
        ax.plot(0.0, row + 0.17, marker="|", ms=6.0, color="0.45")
        ax.plot([low, high], [row - 0.17] * 2, color=hue, linewidth=2.2, solid_capstyle="butt")
        ax.plot(median, row - 0.17, marker="o", ms=3.2, mfc="white", mec=hue, mew=0.8)
        true = scale * (state.true_force[k] - state.reading[k])
        ax.plot(true, row - 0.17, marker="x", ms=4.5, color="black", zorder=4)
        value = number(state.reading[k], 0.0, max(2.0 * half[row], abs(state.reading[k]) / 50.0))
        value = MINUS.sub("\N{MINUS SIGN}", value)
        names.append(f"{state.label} {'xy'[k]}\n{value} {unit}".strip())
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    reach = 1.05 * (float(np.abs(ax.dataLim.intervalx).max()) or 1e-3)
    ax.set_xlim(-reach, reach)
    style.limit_ticks(ax.xaxis, 5)
    ax.axvline(0.0, **style.REFERENCE)
    ax.set_xlabel(f"mounting force less its reading ({shown_unit})")
    content = f"{100 * CONTENT:g} %"
    title = f"grey: reading, {content};  colour: posterior, {content}"
    ax.set_title(title, loc="right", **style.small_text(color="0.3"))
