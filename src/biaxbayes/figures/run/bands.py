"""Data with the credible and the predictive band of a run, protocol by protocol."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.figures.style import (
    CREDIBLE,
    FINER_UNIT,
    MM,
    PAGE_MM,
    PREDICTIVE,
    SIDE_BY_SIDE_MM,
    add_note,
    blank_figure,
    colour,
    few_ticks,
    print_style,
    shortened,
)
from biaxbayes.options import CONTENT, Settings
from biaxbayes.prediction.bands import bands, true_loads
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROWS, DRAWS = 200, 500
"""Readings of a curve and draws that the bands are computed from; of longer records every n-th
reading is drawn, as the figure then says."""
MAX_ROWS, LEAST_MM, LEFT_MM, STRIP_MM = 3, 32.0, 16.0, 10.5
"""Rows of panels, least width of a panel, space at their left, height of the residuals."""
LOADS = {
    "force": "force (N)",
    "piola": "first Piola-Kirchhoff\nstress (kPa)",
    "cauchy": "Cauchy stress (kPa)",
}
MARKERS = {"x": "o", "y": "s"}
TRUE: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (3, 2))}
"""How true loads are drawn."""
LARGEST_MARKER, LEAST_MARKER, OPEN_MARKER = 2.4, 0.9, 1.8
"""Sizes of a marker in points, and that from which it is open."""
QUANTILES = (
    "credible_low",
    "median",
    "credible_high",
    "predictive_low",
    "predictive_median",
    "predictive_high",
)
KINDS = (("predictive", PREDICTIVE), ("credible", CREDIBLE))


def bands_figure(
    specimen: Specimen,
    draws: pd.DataFrame,
    *,
    settings: Settings | None = None,
    truth: Mapping[str, float] | None = None,
    probability: float = CONTENT,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Load against measured stretch with both bands, and what the median misses.

    Parameters
    ----------
    specimen : Specimen
    draws : DataFrame
        One row per draw, columns as in ``summary.csv``.
    settings : Settings, optional
        Those of the run.
    truth : mapping, optional
        Known material and mounting stretches, by the names of the draws: their loads are dashed.
    probability : float
        Content of each band.
    width_mm : float
        Width in print.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
        One panel per protocol (the first 12) with its residuals below. All readings are drawn, of
        protocols of more than 200 rows every n-th.

    Raises
    ------
    InputError
        If the truth lacks a parameter of the law or a mounting stretch.
    """
    shown = replace(specimen, protocols=specimen.protocols[: shown_protocols(specimen, width_mm)])
    table = bands(
        shown, draws, settings=settings, probability=probability, max_rows=ROWS, max_draws=DRAWS
    )
    true = None if truth is None else true_loads(shown, truth, settings=settings, max_rows=ROWS)
    return figure_from_bands(
        specimen, table, truth=true, probability=probability, width_mm=width_mm, style=style
    )


def figure_from_bands(
    specimen: Specimen,
    table: pd.DataFrame,
    *,
    truth: np.ndarray | None = None,
    probability: float = CONTENT,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Draw bands that have been computed.

    Parameters
    ----------
    specimen : Specimen
    table : DataFrame
        From :func:`~biaxbayes.prediction.bands.bands`, for the protocols that have panels.
    truth : ndarray, shape (rows,), optional
        True loads at the rows of the table.
    probability, width_mm, style
        As in :func:`bands_figure`.
    """
    # The quantiles are named after their levels; here they go by their order.
    table = table.set_axis(pd.Index([*table.columns[:5], *QUANTILES]), axis=1)
    if truth is not None:
        table["truth"] = truth
    scale, unit = residual_unit(table, specimen.unit)
    with print_style(style):
        figure, panels, across, panel_mm = _panels(specimen, width_mm)
        groups = table.groupby("protocol", sort=False)
        for k, ((load, *strips), (name, group)) in enumerate(zip(panels, groups, strict=True)):
            test = {str(axis): part for axis, part in group.groupby("direction")}
            places, label = abscissa(test)
            for (axis, part), strip in zip(test.items(), strips, strict=True):
                marker = _marker(axis, len(part), panel_mm)
                _draw(load, places[axis], part, axis, marker)
                columns = [*QUANTILES, "measured", *(["truth"] if truth is not None else [])]
                missed = scale * part[columns].sub(part["median"], axis=0)
                _draw(strip, places[axis], missed, axis, marker, residual=True)
            strips[-1].set_xlabel(label)
            few_ticks(load.xaxis, 5)
            if len(specimen.protocols) > 1:
                load.set_title(shortened(name, panel_mm, "axes.titlesize"), pad=2.0)
            if k % across == 0:
                load.set_ylabel(LOADS[specimen.stress_pair], linespacing=1.1)
                # In the middle of both strips, whose heights do not depend on it.
                strips[-1].set_ylabel(f"residual ({unit})", y=1.1)
                strips[-1].yaxis.label.set_in_layout(False)
        figure.align_ylabels()
        _legend(figure, specimen, probability, truth is not None)
        add_note(figure, _note(len(panels), specimen, table))
    return figure


def shown_protocols(specimen: Specimen, width_mm: float) -> int:
    """Number of protocols that a figure of this width has panels for."""
    return min(len(specimen.protocols), MAX_ROWS * _most_columns(specimen, width_mm))


def _most_columns(specimen: Specimen, width_mm: float) -> int:
    most = max(1, int((width_mm - LEFT_MM) // LEAST_MM))
    return min(most, 3 if len(specimen.protocols) <= 6 else 4)


def _panels(specimen: Specimen, width_mm: float) -> tuple[Figure, list[list[Axes]], int, float]:
    """For each protocol a panel of the loads and below it the residuals in x and in y."""
    count = shown_protocols(specimen, width_mm)
    down = math.ceil(count / _most_columns(specimen, width_mm))
    across = math.ceil(count / down)
    panel_mm = (width_mm - LEFT_MM) / across - 3.0
    load_mm = min(panel_mm, 66.0 if across == 1 else 50.0)
    legend_mm = 5.0 if width_mm >= SIDE_BY_SIDE_MM else 13.0
    figure = blank_figure(width_mm, legend_mm + down * (load_mm + 2.0 * STRIP_MM + 18.0))
    grid = figure.add_gridspec(3 * down, across, height_ratios=[load_mm, STRIP_MM, STRIP_MM] * down)
    panels: list[list[Axes]] = []
    for k in range(count):
        row, column = 3 * (k // across), k % across
        first: list[Any] = panels[0] if panels else [None] * 3
        load = figure.add_subplot(grid[row, column], sharey=first[0])
        x = figure.add_subplot(grid[row + 1, column], sharex=load, sharey=first[1])
        y = figure.add_subplot(grid[row + 2, column], sharex=load, sharey=first[1] or x)
        for ax in (load, x, y):
            few_ticks(ax.yaxis, 5 if ax is load else 3)
            ax.tick_params(labelbottom=ax is y, labelleft=column == 0)
        panels.append([load, x, y])
    return figure, panels, across, panel_mm


def residual_unit(table: pd.DataFrame, unit: str) -> tuple[float, str]:
    """Factor and unit that spare the residuals leading zeros.

    Parameters
    ----------
    table : DataFrame
        With ``measured`` and ``median``.
    unit : {"N", "kPa"}
    """
    largest = float((table["measured"] - table["median"]).abs().max())
    return (1000.0, FINER_UNIT[unit]) if largest < 0.05 else (1.0, unit)


def abscissa(test: dict[str, pd.DataFrame]) -> tuple[dict[str, np.ndarray], str]:
    """What to draw the curves of a test against, and its name.

    Each direction's own stretch, if the model is a curve over it; else (a fixed direction, or a
    path that turns back) the stretch of the leading direction; else the number of the row.

    Parameters
    ----------
    test : dict of DataFrame
        ``x`` and ``y``, each with ``stretch``, ``row`` and ``median``.
    """
    own = {axis: part["stretch"].to_numpy() for axis, part in test.items()}
    leading = max(own, key=lambda axis: float(np.ptp(own[axis])))
    shared = dict.fromkeys(own, own[leading])
    rows = {axis: part["row"].to_numpy() + 1.0 for axis, part in test.items()}
    choices = (
        (own, "measured stretch"),
        (shared, f"measured stretch in {leading}"),
        (rows, "row of the protocol"),
    )
    for choice in choices:
        places = choice[0]
        wide = all(np.ptp(x) > 0.15 * np.ptp(own[leading]) for x in places.values())
        if wide and all(_is_curve(places[axis], part) for axis, part in test.items()):
            break
    return choice


def _is_curve(x: np.ndarray, part: pd.DataFrame) -> bool:
    """Whether the model over x is one curve: ordered by x it hardly goes to and fro."""
    y = part["median"].to_numpy()[np.argsort(x, kind="stable")]
    return float(np.abs(np.diff(y)).sum()) <= 1.5 * float(np.ptp(y)) + 1e-300


def _marker(axis: str, readings: int, panel_mm: float) -> dict[str, Any]:
    """Marker of the readings of a curve, small enough to be distinguished along the panel."""
    spacing = 0.8 * panel_mm * MM * 72.0 / readings
    size, hue = float(np.clip(spacing, LEAST_MARKER, LARGEST_MARKER)), colour(axis)
    opened = size >= OPEN_MARKER
    return {
        "marker": MARKERS[axis],
        "markersize": size,
        "markerfacecolor": "white" if opened else hue,
        "markeredgecolor": hue,
        "markeredgewidth": 0.6 if opened else 0.0,
    }


def _draw(
    ax: Axes,
    x: np.ndarray,
    part: pd.DataFrame,
    axis: str,
    marker: Mapping[str, Any],
    *,
    residual: bool = False,
) -> None:
    """Both bands, the median (zero of the residuals), the readings and the true loads."""
    order = np.argsort(x, kind="stable")
    curves = {name: part[name].to_numpy()[order] for name in part if name in (*QUANTILES, "truth")}
    for kind, opacity in KINDS:
        low, high = curves[f"{kind}_low"], curves[f"{kind}_high"]
        ax.fill_between(x[order], low, high, color=colour(axis), alpha=opacity, linewidth=0.0)
    if residual:
        ax.axhline(0.0, color="0.4", linewidth=0.5, zorder=0.5)
    else:
        ax.plot(x[order], curves["median"], color=colour(axis), linewidth=0.8)
    ax.plot(x, part["measured"], linestyle="none", **marker)
    if "truth" in curves:
        ax.plot(x[order], curves["truth"], **TRUE)


def _note(count: int, specimen: Specimen, table: pd.DataFrame) -> str:
    """What is left out of the figure."""
    notes = []
    if count < len(specimen.protocols):
        notes.append(f"the first {count} of {len(specimen.protocols)} protocols")
    rows = {p.name: p.rows for p in specimen.protocols}
    drawn = table[table["direction"] == "x"].groupby("protocol", sort=False).size()
    step = max(-(-(rows[str(name)] - 1) // max(int(n) - 1, 1)) for name, n in drawn.items())
    if step > 1:
        notes.append(f"one reading in {step} is drawn")
    return "; ".join(notes)


def _legend(figure: Figure, specimen: Specimen, probability: float, truth: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = []
    for axis, name in (("x", specimen.axis_x), ("y", specimen.axis_y)):
        label = f"{axis}: {shortened(name, 26.0, 'legend.fontsize')}" if name else axis
        how: dict[str, Any] = {**_marker(axis, 1, LEAST_MM), "color": colour(axis), "label": label}
        handles.append(Line2D([], [], linewidth=0.8, **how))
    for kind, opacity in reversed(KINDS):
        label = f"{kind} band, {100 * probability:g} %"
        handles.append(Patch(facecolor="0.3", alpha=opacity, linewidth=0.0, label=label))
    if truth:
        handles.append(Line2D([], [], label="truth", **TRUE))
    wide = figure.get_figwidth() / MM >= SIDE_BY_SIDE_MM
    columns = len(handles) if wide else 2
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, columnspacing=1.4)
