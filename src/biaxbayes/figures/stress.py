"""Predicted stress along a path, with both bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.figures.predicted_bands import GREY, add_legend, draw_bands, draw_median
from biaxbayes.figures.style import (
    COLUMN_MM,
    SIDE_BY_SIDE_MM,
    blank_figure,
    colour,
    few_ticks,
    plain,
    print_style,
)
from biaxbayes.options import CONTENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STRESS_NAMES = {"cauchy": "Cauchy stress", "piola": "first Piola-Kirchhoff stress"}
STRIP_MM = 11.0
MARKERS = {"x": "o", "y": "s"}
_SMALL: dict[str, Any] = {"markersize": 1.3, "markeredgewidth": 0.0, "linestyle": "none"}


def stress_figure(
    table: pd.DataFrame,
    *,
    reference: str = "total",
    probability: float = CONTENT,
    directions: tuple[str, str] = ("x", "y"),
    measured: pd.DataFrame | None = None,
    width_mm: float = COLUMN_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Stress against stretch with both bands; dashed where nothing was tested.

    Below, the bands less their median: beside the stress itself they are often too narrow to see.

    Parameters
    ----------
    table : DataFrame
        From :func:`biaxbayes.prediction.stress.predict_stress`.
    reference : {"total", "measured"}
        What its stretches refer to.
    probability : float
        Content of its bands.
    directions : (str, str)
        What the axes of the test are, for the legend.
    measured : DataFrame, optional
        From :func:`biaxbayes.prediction.stress.measured_stress`: readings along the path.
    width_mm : float
        Width in print. From 120 mm the directions stand side by side.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    stress = "cauchy" if "cauchy_x_kPa_median" in table else "piola"
    abscissa, label = _abscissa(table, reference)
    wide = width_mm >= SIDE_BY_SIDE_MM
    read = measured if measured is not None and len(measured) else None
    with print_style(style):
        figure, curves, strips = _stress_panels(width_mm, wide=wide)
        for axis, name in zip("xy", directions, strict=True):
            ax, strip, tint = curves[axis], strips[axis], colour(axis)
            stem = f"{stress}_{axis}_kPa"
            middle = table[f"{stem}_median"]
            about = {c: table[c] - middle for c in table if str(c).startswith(f"{stem}_")}
            draw_bands(ax, abscissa, table, stem, tint)
            draw_bands(strip, abscissa, pd.DataFrame(about), stem, tint)
            strip.axhline(0.0, color="0.4", linewidth=0.5, zorder=0.5)
            if read is not None:
                at = _places(read, table, abscissa)
                for one, values in ((ax, read[stem]), (strip, read[f"{stem}_residual"])):
                    one.plot(at, values, MARKERS[axis], color=tint, **_SMALL)
            draw_median(ax, abscissa, middle, table, tint)
            known = "" if name == axis else f": {plain(name, 24)}"
            ax.plot([], [], color=tint, label=f"{axis}{known}")
        for ax in dict.fromkeys(curves.values()):
            first = ax is curves["x"]
            if read is not None and first:
                ax.plot([], [], "o", color=GREY, label="measured", **_SMALL)
            ax.margins(x=0.0)
            add_legend(ax, table, probability, bands=first)
        curves["x"].set_ylabel(f"{STRESS_NAMES[stress]} (kPa)")
        if wide:
            strips["x"].set_ylabel("less median\n(kPa)", linespacing=1.1)
        else:  # in the middle of both strips, whose heights do not depend on it
            strips["y"].set_ylabel("less median (kPa)", y=1.0 + 1.0 / STRIP_MM)
            strips["y"].yaxis.label.set_in_layout(False)
        figure.align_ylabels()
        for ax in dict.fromkeys((strips["x"] if wide else strips["y"], strips["y"])):
            ax.set_xlabel(label)
        for strip in strips.values():
            few_ticks(strip.yaxis, 3)
    return figure


def _stress_panels(
    width_mm: float, *, wide: bool
) -> tuple[Figure, dict[str, Axes], dict[str, Axes]]:
    """The figure, and by direction the panels of the stress and of what departs from its median."""
    rows = (52.0, 1.25 * STRIP_MM) if wide else (56.0, STRIP_MM, STRIP_MM)
    columns = 2 if wide else 1
    height = sum(rows) + 16.0
    figure = blank_figure(width_mm, height)
    places = figure.add_gridspec(len(rows), columns, height_ratios=rows)
    curves = {"x": figure.add_subplot(places[0, 0])}
    curves["y"] = figure.add_subplot(places[0, 1], sharey=curves["x"]) if wide else curves["x"]
    strips = {}
    for k, axis in enumerate("xy"):
        place = places[1, k] if wide else places[1 + k, 0]
        strips[axis] = figure.add_subplot(place, sharex=curves[axis])
    for ax in (*curves.values(), *([] if wide else [strips["x"]])):
        ax.tick_params(labelbottom=False)
    if wide:
        curves["y"].tick_params(labelleft=False)
    return figure, curves, strips


def _places(measured: pd.DataFrame, table: pd.DataFrame, abscissa: np.ndarray) -> np.ndarray:
    """Where readings stand on the abscissa of a path: at its point that is nearest to each."""
    path = table[["stretch_x", "stretch_y"]].to_numpy()
    state = measured[["stretch_x", "stretch_y"]].to_numpy()
    if len(path) < 2:
        return np.full(len(state), abscissa[0])
    edge = np.diff(path, axis=0)
    offset = state[:, None] - path[None, :-1]
    length = np.maximum((edge**2).sum(axis=1), 1e-300)
    along = np.clip((offset * edge).sum(axis=2) / length, 0.0, 1.0)
    apart = np.linalg.norm(offset - along[:, :, None] * edge, axis=2)
    nearest, rows = apart.argmin(axis=1), np.arange(len(state))
    share = along[rows, nearest]
    return (1.0 - share) * abscissa[nearest] + share * abscissa[nearest + 1]


def _abscissa(table: pd.DataFrame, reference: str) -> tuple[np.ndarray, str]:
    """The stretch that varies most along the path, if it orders the rows; else their number."""
    x, y = table["stretch_x"].to_numpy(), table["stretch_y"].to_numpy()
    name, leading = ("x", x) if np.ptp(x) >= np.ptp(y) else ("y", y)
    steps = np.diff(leading)
    if len(leading) > 1 and not ((steps > 0).all() or (steps < 0).all()):
        return np.arange(1, len(leading) + 1, dtype=float), "state (row of the path)"
    if np.allclose(x, y):
        return leading, f"{reference} stretch"
    return leading, f"{reference} stretch in {name}"
