"""The joint posterior of every pair of quantities and the density of each, of one or more runs.

The corner package draws the regions of a density of ours. Ranges end at physical limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.integrate import trapezoid
from scipy.ndimage import gaussian_filter

from biaxbayes.errors import InputError
from biaxbayes.evenly import evenly_chosen
from biaxbayes.figures import style
from biaxbayes.figures.quantities import MEAN, AxisText, axis_span, corner_columns, plain
from biaxbayes.identifiability.bounded_density import Span, curve, robust_sd, span
from biaxbayes.identifiability.reported import Reported
from biaxbayes.identifiability.verdict import NOT_IDENTIFIED
from biaxbayes.options import CONTENT
from biaxbayes.parameters import Quantities
from biaxbayes.prediction.percentiles import tails
from biaxbayes.report_table import interval_texts

MAX_PANEL_MM, MIN_PANEL_MM, TURNED_MM = 46.0, 8.0, 20.0
"""Largest height and smallest width of a panel; width below which tick labels are turned."""
MARGIN_MM, LEGEND_LINE_MM = 16.0, 3.4
"""Space for the labels; height of a line of the legend."""


@dataclass(frozen=True)
class CornerAxis:
    """A quantity of the figure: its axis, and by run the draws with theirs (None: not varied)."""

    name: str
    quantity: AxisText
    axis: Span
    runs: list[tuple[np.ndarray, Span] | None]


@style.print_style()
def corner_figure(
    draws: pd.DataFrame,
    *,
    truth: Mapping[str, float] | None = None,
    compare: pd.DataFrame | None = None,
    names: tuple[str, str] = ("this run", "compared"),
    parameters: Sequence[str] | None = None,
    width_mm: float = style.PAGE_MM,
    known: Quantities | None = None,
    law: str = "",
    reported: Sequence[Sequence[Reported]] = (),
) -> Figure:
    """Draw the pairwise and marginal posterior; truth dashed, `compare` outlined.

    ``reported``: what is reported of each of the runs, for their legends.
    """
    runs = [draws] if compare is None else [draws, compare]
    truth = {k: float(v) for k, v in (truth or {}).items() if np.isfinite(v)}
    fixed = [
        {str(n): float(run[n].iloc[0]) for n in run.select_dtypes("number") if not np.ptp(run[n])}
        for run in runs
    ]
    columns = _columns(runs, parameters, include=[truth, *fixed], known=known)
    columns = [c for c in columns if c.runs[0]]
    if not columns:
        raise InputError("no parameter of this run varies, so there is nothing to draw")
    figure, grid = _panels(columns, width_mm)
    for run in range(len(runs)):
        _draw_pairs(grid, columns, run, filled=run == 0)
    rows = [{row.name: row for row in of_run} for of_run in (*reported, (), ())]
    texts = [_draw_marginal(grid[i, i], column, fixed, rows) for i, column in enumerate(columns)]
    _set_axes(grid, columns, width_mm)
    line: dict[str, Any] = {"color": "black", "linewidth": 0.7, "linestyle": style.DASHES}
    known_truth = {i: truth[c.name] for i, c in enumerate(columns) if c.name in truth}
    for i, value in known_truth.items():
        for ax in grid[i:, i]:
            ax.axvline(value, **line)
        for ax in grid[i, :i]:
            ax.axhline(value, **line)
    contents = ", ".join(f"{100 * c:g}" for c in CONTENTS)
    title = f"posterior{f', {law}' if law else ''}\n"
    bounded = any(row.bound for of_run in reported for row in of_run)
    bound = f" or {50 + 50 * CONTENT:g} % bound" if bounded else ""
    title += f"median ({100 * CONTENT:g} %{bound}); regions: {contents} %"
    if any(MEAN in c.quantity.symbol for c in columns):
        title += "\nbar: mean over protocols"
    handles: list[Any] = [Line2D([], [], alpha=0.0, label=row[0]) for row in texts]
    if known_truth:
        handles.append(Line2D([], [], label="truth", **line))
    if compare is not None:
        handles.insert(0, Patch(color=style.colour(0), label=plain(names[0], 20)))
        outline = f"{plain(names[1], 20)} (90 %)"
        handles.append(Patch(fc="none", ec=style.colour(1), label=outline))
        handles += [Line2D([], [], alpha=0.0, label=row[1]) for row in texts]
    _add_legend(figure, handles, title, 1 if compare is None else 2)
    return figure


@style.print_style()
def overlay_figure(
    runs: Sequence[pd.DataFrame],
    labels: Sequence[str],
    *,
    points: Sequence[Mapping[str, np.ndarray]] = (),
    title: str = "filled 50 %, outline 90 % of the draws",
    known: Quantities | None = None,
) -> Figure:
    """Draw the posteriors of several runs: 50 % filled, 90 % outlined; `points` over the pairs."""
    columns = _columns(runs, known=known, include=points)
    if not columns:
        raise InputError("no parameter of these runs varies, so there is nothing to draw")
    figure, grid = _panels(columns, style.PAGE_MM)
    handles = []
    for run, label in enumerate(labels):
        hue = style.colour(run)
        _draw_pairs(grid, columns, run, filled=None)
        for ax, column in zip(grid.diagonal(), columns, strict=True):
            drawn = column.runs[run]
            if drawn is None:
                continue
            # Every density has the same height, since widths are compared.
            x, density = curve(*drawn)
            ax.plot(x, density / density.max(), color=hue, linewidth=0.9)
            ax.fill_between(x, density / density.max(), color=hue, alpha=REGION_OPACITY, lw=0.0)
            ax.set_ylim(0.0, 1.08)
        for i, j in np.argwhere(np.tri(len(columns), k=-1)) if len(points) else ():
            x, y = (points[run][columns[k].name] for k in (j, i))
            grid[i, j].plot(x, y, "o", color=hue, markersize=2.6)
        handles.append(
            Patch(fc=(hue, REGION_OPACITY), ec=hue, linewidth=0.9, label=plain(label, 24))
        )
    _set_axes(grid, columns, style.PAGE_MM)
    _add_legend(figure, handles, title)
    return figure


def _columns(
    runs: Sequence[pd.DataFrame],
    parameters: Sequence[str] | None = None,
    *,
    include: Sequence[Mapping[str, Any]] = (),
    known: Quantities | None = None,
) -> list[CornerAxis]:
    """Quantities in the order of the first run that has them; axes contain `include`."""
    by_run = [corner_columns(run, known) for run in runs]
    names = list(dict.fromkeys(name for columns in by_run for name in columns))
    for name in parameters or ():
        if name not in names:
            raise InputError(
                f"{name[:40]!r} does not vary in this run", remedy=f"one of {', '.join(names)}"
            )
    result = []
    for name in names if parameters is None else [n for n in names if n in parameters]:
        q = next(columns[name][0] for columns in by_run if name in columns)
        draws = [columns[name][1] if name in columns else None for columns in by_run]
        values = tuple(
            float(v) for given in include if name in given for v in np.ravel(given[name])
        )
        axis = axis_span(q, *(d for d in draws if d is not None), include=values)
        own = [None if d is None else (d, span(d, limits=q.limits, log=axis.log)) for d in draws]
        result.append(CornerAxis(name, q, axis, own))
    return result


def _panels(columns: list[CornerAxis], width_mm: float) -> tuple[Figure, np.ndarray]:
    """Panels of a lower triangle; labels at the outer ones only."""
    count = len(columns)
    if (width_mm - MARGIN_MM) / count < MIN_PANEL_MM:
        raise InputError(
            f"{count} quantities do not fit a width of {width_mm:g} mm",
            remedy="name fewer with `parameters`, or choose `width_mm=180`",
        )
    figure = style.blank_figure(width_mm, min(width_mm, count * MAX_PANEL_MM + MARGIN_MM))
    figure.get_layout_engine().set(w_pad=0.9 * style.MM, h_pad=0.5 * style.MM)  # type: ignore[union-attr,call-arg]
    grid_spec = figure.add_gridspec(count, count)
    grid = np.full((count, count), None, dtype=object)
    unit_separator = " (" if width_mm >= style.SIDE_BY_SIDE_MM else "\n("
    labels = [column.quantity.label.replace(" (", unit_separator) for column in columns]
    for i, j in np.argwhere(np.tri(count)).tolist():
        grid[i, j] = ax = figure.add_subplot(grid_spec[i, j])
        ax.tick_params(labelbottom=i == count - 1, labelleft=j == 0)
        if i == count - 1:
            ax.set_xlabel(labels[j])
        if j == 0 < i:
            ax.set_ylabel(labels[i])
    figure.align_labels()
    return figure, grid


def _set_axes(grid: np.ndarray, columns: list[CornerAxis], width_mm: float) -> None:
    """Ranges and few ticks, after the corner package has set its own."""
    narrow = (width_mm - MARGIN_MM) / len(grid) < TURNED_MM
    for i, j in np.argwhere(np.tri(len(grid))).tolist():
        ax = grid[i, j]
        for axis, column in ((ax.xaxis, columns[j]), (ax.yaxis, columns[i])):
            if axis is ax.yaxis and i == j:
                ax.set_yticks([])
                ax.spines["left"].set_visible(False)
                continue
            name, span_of = axis.axis_name, column.axis
            ax.set(**{f"{name}scale": "log" if span_of.log else "linear"})
            ax.set(**{f"{name}lim": (span_of.low, span_of.high)})
            style.limit_ticks(axis, 2)
            ticks = [t for t in axis.get_majorticklocs() if span_of.low <= t <= span_of.high]
            if narrow or len(ticks) > 2:
                axis.set_ticks(sorted({ticks[0], ticks[-1]}))  # a log axis may have but one
        ax.tick_params(axis="x", labelrotation=90.0 if narrow else 0.0)


def _draw_pairs(
    grid: np.ndarray, columns: list[CornerAxis], run: int, *, filled: bool | None
) -> None:
    """Regions of a run in the panels of the pairs that it varies."""
    for i, j in np.argwhere(np.tri(len(columns), k=-1)):
        x, y = columns[j].runs[run], columns[i].runs[run]
        if x and y:
            draw_regions(grid[i, j], (x[0], y[0]), (x[1], y[1]), style.colour(run), filled=filled)


def _draw_marginal(
    ax: Axes,
    column: CornerAxis,
    fixed: Sequence[Mapping[str, float]],
    reported: Sequence[Mapping[str, Reported]],
) -> list[str]:
    """Draw the densities, the interval of the first run shaded; return the texts by run."""
    texts = []
    top, label = 0.0, column.quantity.label
    for run, drawn in enumerate(column.runs):
        hue = style.colour(run)
        if drawn is None:
            value = fixed[run].get(column.name)
            if value is not None:
                ax.axvline(value, color=hue, linewidth=0.9)
            texts.append("" if value is None else f"{label}  {value:.4g} (fixed)")
            continue
        x, density = curve(*drawn)
        median, low, high = np.quantile(drawn[0], [0.5, *tails(CONTENT)])
        density = density / trapezoid(density, column.axis.forward(x))
        ax.plot(x, density, color=hue, linewidth=0.9)
        top = max(top, float(density.max()))
        middle, first, last = interval_texts(median, low, high, column.quantity.parameter)
        text = f"{first}–{last}"
        row = reported[run].get(column.name)
        if row is not None and row.bound:
            text = row.interval
            low, high = (low, np.inf) if row.bound == "low" else (-np.inf, high)
        elif row is not None and row.verdict == NOT_IDENTIFIED:
            text += f"; {NOT_IDENTIFIED}"
        if run == 0:
            inside = list((x >= low) & (x <= high))
            ax.fill_between(x, density, where=inside, color=hue, alpha=0.3, linewidth=0.0)
        texts.append(f"{label}  {middle} ({text})")
    ax.set_ylim(0.0, 1.08 * top)
    return texts


def _add_legend(figure: Figure, handles: list[Any], title: str, columns: int = 1) -> None:
    """A legend in the free upper right corner, or above the panels of a small figure."""
    how: dict[str, Any] = {"title": title, "alignment": "left", "labelspacing": 0.3}
    if len(figure.axes) > 1 and figure.get_figwidth() >= style.SIDE_BY_SIDE_MM * style.MM:
        legend = figure.legend(handles=handles, loc="upper right", ncols=columns, **how)
        legend.set_in_layout(False)
    else:
        figure.legend(handles=handles, loc="outside upper left", **how)
        lines = len(handles) + title.count("\n") + 1
        figure.set_figheight(figure.get_figheight() + lines * LEGEND_LINE_MM * style.MM)


# --- the joint posterior of two quantities as regions of given content ---------------------------

CONTENTS = (0.5, 0.9, 0.99)
"""Contents of the regions as shares of the draws."""
SHADES = (0.18, 0.42, 0.78)
"""Darkness of the regions, the widest first."""
REGION_OPACITY = 0.3
"""Opacity of the region of 50 % and of the marginal in an overlay."""
CELLS = 1.5
"""Width (sd) of the smoothing kernel in cells of the histogram."""
WIDER = 1.25
"""Width of the kernel of a pair, relative to Scott's."""
WIDEST = 1.5
"""Times that the kernel of a pair is doubled at most, for draws beyond the region of 90 %."""
VISIBLE = 20_000
"""Number of draws of a pair that are used; more would not be visible."""


def draw_regions(
    ax: Axes, pair: Sequence[np.ndarray], axes: Sequence[Span], hue: str, *, filled: bool | None
) -> None:
    """Draw a joint posterior: shaded (True), the 90 % outline (False), or 50 % in it (None).

    Its density is that of draws in cells, smoothed by a kernel whose width suits the pair and run.
    """
    import corner  # imports ArviZ, which takes a second or two

    shown = evenly_chosen(len(pair[0]), VISIBLE)
    along = np.array([a.forward(draws[shown]) for a, draws in zip(axes, pair, strict=True)])
    # cells for Scott's kernel h = sd n^(-1/6), narrower on a ridge: where one quantity is known,
    # the sd of the other is sd sqrt(1 - r^2); halfway to it, in logs
    sd, n = np.array([max(robust_sd(u), 1e-6) for u in along]), along.shape[1]
    r = np.corrcoef(np.clip(along, 0.0, 1.0))[0, 1] if n > 2 else 0.0
    ridge = (1.0 - min(abs(np.nan_to_num(r)), 0.999) ** 2) ** 0.25
    bins = [int(np.clip(CELLS / h, 30, 250)) for h in WIDER * ridge * sd * n ** (-1.0 / 6.0)]
    centres = [a.back((np.arange(m) + 0.5) / m) for a, m in zip(axes, bins, strict=True)]
    density, at_draws = _smooth(along, bins)
    look = _look(hue, filled)
    # corner counts the mass of the density; smoothing has spread that of the draws
    thresholds = np.quantile(at_draws, 1.0 - np.array(look["levels"]))
    look["levels"] = [density[density >= t].sum() / density.sum() for t in thresholds]
    corner.hist2d(
        *(c.ravel() for c in np.meshgrid(*centres, indexing="ij")),
        weights=density.ravel(),
        ax=ax,
        range=[(a.low, a.high) for a in axes],
        axes_scale=["log" if a.log else "linear" for a in axes],
        bins=bins,
        **look,
    )


def _smooth(along: np.ndarray, bins: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed density in cells and at the draws; the kernel widens where the density is low.

    Width (Abramson 1982): h (f90 / f)^(1/2) where the density f is below f90, that at the
    outline of the 90 % region. A single width leaves islands of single draws.
    """
    inside = np.all((along >= 0.0) & (along <= 1.0), axis=0)
    cell = [
        np.minimum((u * n).astype(int), n - 1) for u, n in zip(along[:, inside], bins, strict=True)
    ]
    counts = np.bincount(np.ravel_multi_index(cell, bins), minlength=bins[0] * bins[1])
    counts = counts.reshape(bins).astype(float)
    pilot = gaussian_filter(counts, CELLS)
    f90 = np.quantile(pilot[tuple(cell)], 1.0 - CONTENTS[1])
    # log2 of the width; between two powers of two a cell's draws are shared by both kernels
    wider = np.clip(0.5 * np.log2(f90 / np.maximum(pilot, 1e-300)), 0.0, WIDEST)
    density = np.zeros_like(counts)
    for k in range(math.ceil(WIDEST) + 1):
        weight = counts * np.maximum(1.0 - np.abs(wider - k), 0.0)
        density += gaussian_filter(weight, CELLS * 2.0**k)
    return density, density[tuple(cell)]


def _look(hue: str, filled: bool | None) -> dict[str, Any]:
    """Colours and levels of :func:`corner.hist2d`."""
    look: dict[str, Any] = {"color": hue, "plot_datapoints": False, "plot_density": False}
    look |= {"quiet": True, "no_fill_contours": True, "fill_contours": filled is not False}
    if filled is False:
        return look | {"levels": (0.9,), "contour_kwargs": {"linewidths": 0.9}}
    if filled is None:
        fills: dict[str, Any] = {"colors": ["none", "none", (*to_rgb(hue), REGION_OPACITY)]}
        lines: dict[str, Any] = {"linewidths": [0.8, 0.0]}
        return look | {"levels": CONTENTS[:2], "contourf_kwargs": fills, "contour_kwargs": lines}
    # Shades are mixed with white, not made transparent: panels stay small in a vector file.
    shades = [tuple(1.0 - s * (1.0 - np.array(to_rgb(hue)))) for s in SHADES]
    fills = {"colors": ["none", *shades], "antialiased": True}
    lines = {"colors": shades, "linewidths": 0.3}
    return look | {"levels": CONTENTS, "contourf_kwargs": fills, "contour_kwargs": lines}
