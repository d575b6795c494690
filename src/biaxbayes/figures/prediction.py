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
    MM,
    PREDICTIVE,
    colour,
    plain,
    print_style,
)
from biaxbayes.mechanics.inflation import MMHG_PER_KPA
from biaxbayes.options import CONTENT
from biaxbayes.prediction.stress import INSIDE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["inflation_figure", "stress_figure"]

STRESS_NAMES = {"cauchy": "Cauchy stress", "piola": "first Piola-Kirchhoff stress"}
SIDE_BY_SIDE_MM = 120.0
"""Width from which the two directions have a panel each."""
DASHES = (0, (3, 2))
GREY = "0.3"


def stress_figure(
    table: pd.DataFrame,
    *,
    reference: str = "total",
    probability: float = CONTENT,
    directions: tuple[str, str] = ("x", "y"),
    width_mm: float = COLUMN_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Stress against stretch with both bands; dashed where nothing was tested.

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
    width_mm : float
        Width in print. From 120 mm the directions stand side by side.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    stress = "cauchy" if "cauchy_x_kPa_median" in table else "piola"
    abscissa, label = _abscissa(table, reference)
    wide = width_mm >= SIDE_BY_SIDE_MM
    with print_style(style):
        room = ConstrainedLayoutEngine(wspace=0.08)  # between the ends of two scales
        figure = Figure((width_mm * MM, (70.0 if wide else 72.0) * MM), layout=room)
        axes = figure.subplots(1, 2 if wide else 1, sharey=True, squeeze=False)
        for i, (axis, name) in enumerate(zip("xy", directions, strict=True)):
            ax = axes[0, i if wide else 0]
            stem = f"{stress}_{axis}_kPa"
            _bands(ax, abscissa, table, stem, colour(axis))
            _median(ax, abscissa, table[f"{stem}_median"], table, colour(axis))
            known = "" if name == axis else f": {plain(name, 24)}"
            ax.plot([], [], color=colour(axis), label=f"{axis}{known}")
        for ax in axes[0]:
            ax.set_xlabel(label)
            ax.margins(x=0.0)
        axes[0, 0].set_ylabel(f"{STRESS_NAMES[stress]} (kPa)")
        for ax in axes[0]:
            _legend(ax, table, probability, bands=ax is axes[0, 0])
    return figure


def inflation_figure(
    table: pd.DataFrame,
    *,
    probability: float = CONTENT,
    width_mm: float = COLUMN_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Pressure against outer diameter with both bands; dashed where nothing was tested.

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
    from matplotlib.figure import Figure

    with print_style(style):
        tint = colour("run")
        figure = Figure((width_mm * MM, min(72.0, 0.85 * width_mm) * MM), layout="constrained")
        ax = figure.subplots()
        if "pressure_kPa_median" in table:
            across = table["outer_diameter_mm"].to_numpy()
            _bands(ax, across, table, "pressure_kPa", tint)
            _median(ax, across, table["pressure_kPa_median"], table, tint)
        else:
            up = table["pressure_kPa"].to_numpy()
            for kind, opacity in (("predictive", PREDICTIVE), ("credible", CREDIBLE)):
                low, high = (table[f"outer_diameter_mm_{kind}_{end}"] for end in ("low", "high"))
                ax.fill_betweenx(up, low, high, color=tint, alpha=opacity, linewidth=0.0)
            _median(ax, table["outer_diameter_mm_median"].to_numpy(), up, table, tint)
        ax.set_xlabel("outer diameter (mm)")
        ax.set_ylabel("pressure (kPa)")
        ax.margins(y=0.0)
        right = ax.secondary_yaxis("right", functions=(_mmHg, _kPa))
        right.set_ylabel("pressure (mmHg)")
        right.spines["right"].set_visible(True)
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
