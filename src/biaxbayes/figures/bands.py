"""Data with the credible and the predictive band of a run, protocol by protocol."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from biaxbayes.figures import style
from biaxbayes.figures.panels import band_handles, draw_bands
from biaxbayes.figures.quantities import plain
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import CONTENT
from biaxbayes.prediction.bands import bands, true_loads
from biaxbayes.specimens.specimen import Specimen

DRAWN_READINGS, BAND_DRAWS = 200, 500
"""Readings of a curve and draws for the bands; from longer records every n-th reading is drawn, as
a note in the figure says."""
MAX_PANEL_ROWS, MIN_PANEL_MM, LEFT_MM, RESIDUAL_MM = 3, 32.0, 16.0, 12.0
"""Rows of panels, least width of a panel, space at their left, height of the residuals."""
TRUE: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": style.DASHES}
"""Line style of true loads."""
LAW: dict[str, Any] = {"linewidth": 0.7, "linestyle": (0, (1.0, 1.5))}
"""Line style of the loads of the law nearest to the tissue, without misfit."""
OPEN_UP_TO = 150
"""Readings of a curve up to which markers are large and open."""


@style.print_style()
def bands_figure(
    posterior: Posterior,
    draws: pd.DataFrame,
    *,
    piece: int = 0,
    truth: Mapping[str, float] | None = None,
    width_mm: float = style.PAGE_MM,
) -> Figure:
    """Draw load against measured stretch with both bands, and residuals, for up to 12 protocols."""
    specimen, rows = posterior.pieces[piece].specimen, {"max_rows": DRAWN_READINGS}
    table = bands(posterior, draws, piece=piece, max_draws=BAND_DRAWS, **rows)
    if truth is not None:
        table["truth"] = true_loads(specimen, truth, settings=posterior.settings, **rows)
    table.columns = table.columns.str.replace("q05", "low").str.replace("q95", "high")
    figure, panels = _panels(specimen, width_mm)
    shown = [p.name for p in specimen.protocols[: len(panels)]]
    table, loads_of = table[table["protocol"].isin(shown)], table.columns[4:]
    scales = {
        str(axis): _residual_unit(part, specimen.units["xy".index(str(axis))])
        for axis, part in table.groupby("direction")
    }
    if len(load_panels(specimen)) == 1:
        scales = dict.fromkeys(scales, _residual_unit(table, specimen.unit))
    groups = table.groupby("protocol", sort=False)
    for (loads, strips), (name, group) in zip(panels, groups, strict=True):
        load = loads[0]
        test = {str(axis): part for axis, part in group.groupby("direction")}
        abscissas, label = _abscissa(test, specimen.experiment.stretches)
        first = load.get_subplotspec().is_first_col()  # type: ignore[union-attr]
        for k, ((axis, part), strip) in enumerate(zip(test.items(), strips, strict=True)):
            _draw(loads[k % len(loads)], abscissas[axis], part, axis)
            scale, unit = scales[axis]
            missed = part[loads_of].sub(part["credible_q50"], axis=0)
            _draw(strip, abscissas[axis], scale * missed, axis)
            if first:
                strip.set_ylabel(f"residual\n({unit})", linespacing=1.1, **style.small_text())
        strips[-1].set_xlabel(label)
        style.limit_ticks(load.xaxis, 5)
        if len(specimen.protocols) > 1:
            load.set_title(plain(name, int(width_mm / len(panels) ** 0.5 / 3.0)), pad=2.0)
        if first:
            for ax, (label, _) in zip(loads, load_panels(specimen), strict=True):
                ax.set_ylabel(label, linespacing=1.1)
    figure.align_ylabels()
    handles: list[Any] = []
    for k, curve in enumerate(curve_names(specimen, 16)):
        if k in specimen.experiment.axes:
            look = {"color": style.colour("xy"[k]), "linewidth": 0.8, **_marker("xy"[k], 1)}
            handles.append(Line2D([], [], label=curve, **look))
    handles += band_handles(CONTENT, " band")
    handles.append(Line2D([], [], label="nearest law", color="0.3", **LAW))
    if truth is not None:
        handles.append(Line2D([], [], label="truth", **TRUE))
    across = len(handles) if width_mm >= style.SIDE_BY_SIDE_MM else 2
    figure.legend(handles=handles, loc="outside upper left", ncols=across, columnspacing=1.4)
    notes = []
    if len(panels) < len(specimen.protocols):
        notes.append(f"the first {len(panels)} of {len(specimen.protocols)} protocols")
    step = table.groupby(["protocol", "direction"])["row"].diff().max()
    if step > 1:
        notes.append(f"one reading in {step:g} is drawn")
    style.add_note(figure, "; ".join(notes))
    return figure


def load_panels(specimen: Specimen) -> list[tuple[str, list[int]]]:
    """Labels and directions of the panels of loads: one, or one per reading of another unit."""
    test, units = specimen.experiment, specimen.units
    if units[0] == units[1]:
        words = specimen.kind_of_loads.words.replace("Kirchhoff ", "Kirchhoff\n")
        return [(f"{words} ({units[0]})", list(test.axes))]
    return [(f"{test.curves[k]} ({units[k]})", [k]) for k in test.axes]


def curve_names(specimen: Specimen, letters: int) -> list[str]:
    """What the readings are called, with the directions of the tissue."""
    named = zip(specimen.experiment.curves, (specimen.axis_x, specimen.axis_y), strict=True)
    return [f"{curve}: {plain(name, letters)}" if name else curve for curve, name in named]


def _panels(
    specimen: Specimen, width_mm: float
) -> tuple[Figure, list[tuple[list[Axes], list[Axes]]]]:
    """Panels of the loads, and below them of the residuals in x and y, per protocol."""
    count = len(specimen.protocols)
    columns = min(max(1, int((width_mm - LEFT_MM) // MIN_PANEL_MM)), 3 if count <= 6 else 4)
    count = min(count, MAX_PANEL_ROWS * columns)
    down = math.ceil(count / columns)
    across = math.ceil(count / down)
    load_mm = min((width_mm - LEFT_MM) / across - 3.0, 66.0 if across == 1 else 50.0)
    legend_mm = 5.0 if width_mm >= style.SIDE_BY_SIDE_MM else 13.0
    directions, of_loads = len(specimen.experiment.axes), len(load_panels(specimen))
    height = of_loads * load_mm + directions * RESIDUAL_MM + 18.0
    figure = style.blank_figure(width_mm, legend_mm + down * height)
    ratios = [*[load_mm] * of_loads, *[RESIDUAL_MM] * directions]
    grid = figure.add_gridspec(len(ratios) * down, across, height_ratios=ratios * down)
    panels: list[list[Axes]] = []
    for k in range(count):
        row, column = len(ratios) * (k // across), k % across
        own: list[Axes] = []
        panels.append(own)
        for i in range(len(ratios)):
            # residuals of one unit have one scale
            like = i if i < of_loads or of_loads > 1 else of_loads
            first = panels[0][like] if like < len(panels[0]) else None
            cell = grid[row + i, column]
            ax = figure.add_subplot(cell, sharex=own[0] if own else None, sharey=first)
            style.limit_ticks(ax.yaxis, 5 if i < of_loads else 3)
            ax.tick_params(labelbottom=i == len(ratios) - 1, labelleft=column == 0)
            own.append(ax)
    return figure, [(own[:of_loads], own[of_loads:]) for own in panels]


def _residual_unit(table: pd.DataFrame, unit: str) -> tuple[float, str]:
    """Factor and unit that avoid leading zeros of the residuals, measured less median."""
    largest = float((table["measured"] - table["credible_q50"]).abs().max())
    return (1000.0, style.FINER_UNIT[unit]) if largest < 0.05 else (1.0, unit)


def _abscissa(
    test: dict[str, pd.DataFrame], stretches: tuple[str, str]
) -> tuple[dict[str, np.ndarray], str]:
    """Abscissae of the curves in x and y and their name: own stretch, leading stretch or row."""
    own_stretch = {axis: part["stretch"].to_numpy() for axis, part in test.items()}
    leading = max(own_stretch, key=lambda axis: float(np.ptp(own_stretch[axis])))
    shared = dict.fromkeys(own_stretch, own_stretch[leading])
    rows = {axis: part["row"].to_numpy() + 1.0 for axis, part in test.items()}
    choices = (
        (own_stretch, "measured stretch"),
        (shared, f"measured {stretches['xy'.index(leading)]}"),
        (rows, "row of the protocol"),
    )
    for choice in choices:
        abscissas = choice[0]
        wide = all(np.ptp(x) > 0.15 * np.ptp(own_stretch[leading]) for x in abscissas.values())
        # the model ordered by x is a curve that hardly goes back and forth
        medians = [
            part["credible_q50"].to_numpy()[np.argsort(abscissas[axis], kind="stable")]
            for axis, part in test.items()
        ]
        if wide and all(np.abs(np.diff(y)).sum() <= 1.5 * np.ptp(y) + 1e-300 for y in medians):
            break
    return choice


def _marker(axis: str, readings: int) -> dict[str, Any]:
    """Marker of the readings of a curve: large and open where there are few."""
    hue = style.colour(axis)
    size, face, outline = (2.2, "white", 0.5) if readings <= OPEN_UP_TO else (1.4, hue, 0.0)
    return {"marker": style.AXIS_MARKERS[axis], "ms": size, "mfc": face, "mec": hue, "mew": outline}


def _draw(ax: Axes, x: np.ndarray, part: pd.DataFrame, axis: str) -> None:
    """Both bands, the median, the readings and the true loads."""
    order = np.argsort(x, kind="stable")
    curves = part.iloc[order]
    draw_bands(ax, x[order], curves, "", style.colour(axis))
    ax.plot(x[order], curves["credible_q50"], color=style.colour(axis), linewidth=0.8)
    ax.plot(x, part["measured"], linestyle="none", **_marker(axis, len(part)))
    for name, look in (("law", LAW | {"color": style.colour(axis)}), ("truth", TRUE)):
        if name in part:
            ax.plot(x[order], curves[name], **look)
