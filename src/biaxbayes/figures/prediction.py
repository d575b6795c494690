"""Figures of predictions: stress along a path, and the inflation of a tube."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.figures.style import (
    COLUMN_MM,
    CREDIBLE,
    PREDICTIVE,
    SIDE_BY_SIDE_MM,
    blank_figure,
    colour,
    few_ticks,
    plain,
    print_style,
)
from biaxbayes.options import CONTENT
from biaxbayes.prediction.inflation import MMHG_PER_KPA
from biaxbayes.prediction.stress import INSIDE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STRESS_NAMES = {"cauchy": "Cauchy stress", "piola": "first Piola-Kirchhoff stress"}
STRIP_MM = 11.0
MARKERS = {"x": "o", "y": "s"}
_SMALL: dict[str, Any] = {"markersize": 1.3, "markeredgewidth": 0.0, "linestyle": "none"}
DASHES = (0, (3, 2))
GREY = "0.3"


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
            _bands(ax, abscissa, table, stem, tint)
            _bands(strip, abscissa, pd.DataFrame(about), stem, tint)
            strip.axhline(0.0, color="0.4", linewidth=0.5, zorder=0.5)
            if read is not None:
                at = _places(read, table, abscissa)
                for one, values in ((ax, read[stem]), (strip, read[f"{stem}_residual"])):
                    one.plot(at, values, MARKERS[axis], color=tint, **_SMALL)
            _median(ax, abscissa, middle, table, tint)
            known = "" if name == axis else f": {plain(name, 24)}"
            ax.plot([], [], color=tint, label=f"{axis}{known}")
        for ax in dict.fromkeys(curves.values()):
            first = ax is curves["x"]
            if read is not None and first:
                ax.plot([], [], "o", color=GREY, label="measured", **_SMALL)
            ax.margins(x=0.0)
            _legend(ax, table, probability, bands=first)
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


def inflation_figure(
    table: pd.DataFrame,
    *,
    probability: float = CONTENT,
    width_mm: float = COLUMN_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Pressure against outer diameter with both bands; dashed where nothing was tested.

    Below, or beside, the bands less their median, which they hardly leave on the scale of the test.

    Parameters
    ----------
    table : DataFrame
        From :func:`biaxbayes.prediction.inflation.predict_pressure` or
        :func:`biaxbayes.prediction.inflation.predict_diameter`.
    probability : float
        Content of its bands.
    width_mm : float
        Width in print.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with print_style(style):
        tint = colour("run")
        figure = blank_figure(width_mm, 0.85 * width_mm)
        if "pressure_kPa_median" in table:
            ax, strip = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
            across = table["outer_diameter_mm"].to_numpy()
            middle: Any = table["pressure_kPa_median"]
            about = {c: table[c] - middle for c in table if str(c).startswith("pressure_kPa_")}
            _bands(ax, across, table, "pressure_kPa", tint)
            _median(ax, across, middle, table, tint)
            _bands(strip, across, pd.DataFrame(about), "pressure_kPa", tint)
            strip.axhline(0.0, color=tint)
            strip.set(xlabel="outer diameter (mm)", ylabel="less median\n(kPa)")
            right = ax
        else:
            ax, strip = figure.subplots(1, 2, sharey=True, width_ratios=(3.0, 1.0))
            up = table["pressure_kPa"].to_numpy()
            middle = table["outer_diameter_mm_median"].to_numpy()
            for kind, opacity in (("predictive", PREDICTIVE), ("credible", CREDIBLE)):
                ends = np.array([table[f"outer_diameter_mm_{kind}_{e}"] for e in ("low", "high")])
                for panel, (low, high) in ((ax, ends), (strip, ends - middle)):
                    panel.fill_betweenx(up, low, high, color=tint, alpha=opacity, linewidth=0.0)
            _median(ax, middle, up, table, tint)
            strip.axvline(0.0, color=tint)
            ax.set_xlabel("outer diameter (mm)")
            strip.set_xlabel("less median\n(mm)")
            right = strip
        strip.locator_params(nbins=3, axis="y" if right is ax else "x")
        ax.set_ylabel("pressure (kPa)")
        ax.margins(y=0.0)
        mercury = right.secondary_yaxis("right", functions=(_mmHg, _kPa))
        mercury.set_ylabel("pressure (mmHg)")
        mercury.spines["right"].set_visible(True)
        ax.plot([], [], color=tint, label="median")
        _legend(ax, table, probability, bands=True)
    return figure


def _mmHg(kPa: Any) -> Any:
    return kPa * MMHG_PER_KPA


def _kPa(mmHg: Any) -> Any:
    return mmHg / MMHG_PER_KPA


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


def _bands(ax: Axes, abscissa: np.ndarray, table: pd.DataFrame, stem: str, tint: str) -> None:
    for kind, opacity in (("predictive", PREDICTIVE), ("credible", CREDIBLE)):
        low, high = (table[f"{stem}_{kind}_{end}"] for end in ("low", "high"))
        ax.fill_between(abscissa, low, high, color=tint, alpha=opacity, linewidth=0.0)


def _median(ax: Axes, x, y, table: pd.DataFrame, tint: str) -> None:
    """A line, solid where the states were tested and dashed elsewhere."""
    x, y = np.asarray(x), np.asarray(y)
    for tested, rows in _stretches_of(table["extrapolation"].to_numpy() == INSIDE):
        ax.plot(x[rows], y[rows], color=tint, linestyle="-" if tested else DASHES)


def _stretches_of(tested: np.ndarray) -> Iterator[tuple[bool, slice]]:
    """Runs of equal rows; each reaches to the first row of the next, so that the line is whole."""
    edges = [0, *(np.flatnonzero(np.diff(tested.astype(int))) + 1), tested.size]
    for first, last in pairwise(edges):
        yield bool(tested[first]), slice(first, min(last + 1, tested.size))


def _legend(ax: Axes, table: pd.DataFrame, probability: float, *, bands: bool) -> None:
    if bands:
        for name, opacity in (("credible", CREDIBLE), ("predictive", PREDICTIVE)):
            ax.fill_between(
                [],
                [],
                [],
                color=GREY,
                alpha=opacity,
                linewidth=0.0,
                label=f"{name}, {100 * probability:g} %",
            )
    if bands and (table["extrapolation"] != INSIDE).any():
        ax.plot([], [], color=GREY, linestyle=DASHES, label="not tested")
    ax.legend(loc="upper left", borderaxespad=0.2)
