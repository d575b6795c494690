"""Figures of predictions: stress along a path, and the inflation of a tube."""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.findings.covered_stretches import INSIDE
from biaxbayes.mechanics.inflation import MMHG_PER_KPA

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure_bytes", "inflation_figure", "stress_figure"]

COLOURS = {"x": "#0072B2", "y": "#D55E00"}  # blue and vermilion of Okabe and Ito
MM = 1.0 / 25.4
CREDIBLE, PREDICTIVE = 0.45, 0.18  # opacity of the bands
STRESS_NAMES = {"cauchy": "Cauchy stress", "piola": "first Piola-Kirchhoff stress"}
STYLE: Any = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "legend.fontsize": 7.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.1,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "savefig.dpi": 300,
}


def stress_figure(
    table: pd.DataFrame,
    *,
    reference: str = "total",
    probability: float = 0.9,
    directions: tuple[str, str] = ("x", "y"),
    width_mm: float = 85.0,
) -> Figure:
    """Stress against stretch with both bands; dashed where nothing was tested.

    Parameters
    ----------
    table : DataFrame
        From :func:`biaxbayes.findings.prediction.predict_stress`.
    reference : {"total", "measured"}
        What its stretches refer to.
    probability : float
        Content of its bands.
    directions : (str, str)
        What the axes of the test are, for the legend.
    width_mm : float
        Width in print. From 120 mm the directions stand side by side.

    Returns
    -------
    matplotlib.figure.Figure
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    stress = "cauchy" if "cauchy_x_kPa_median" in table else "piola"
    abscissa, label = _abscissa(table, reference)
    wide = width_mm >= 120.0
    with mpl.rc_context(STYLE):
        figure = Figure((width_mm * MM, (70.0 if wide else 72.0) * MM), layout="constrained")
        axes = figure.subplots(1, 2 if wide else 1, sharey=True, squeeze=False)
        for i, (axis, name) in enumerate(zip("xy", directions, strict=True)):
            ax = axes[0, i if wide else 0]
            stem = f"{stress}_{axis}_kPa"
            _bands(ax, abscissa, table, stem, COLOURS[axis])
            _median(ax, abscissa, table[f"{stem}_median"], table, COLOURS[axis])
            ax.plot([], [], color=COLOURS[axis], label=name if name == axis else f"{axis}: {name}")
        for ax in axes[0]:
            ax.set_xlabel(label)
            ax.margins(x=0.0)
        axes[0, 0].set_ylabel(f"{STRESS_NAMES[stress]} (kPa)")
        for ax in axes[0]:
            _legend(ax, table, probability, bands=ax is axes[0, 0])
    return figure


def inflation_figure(
    table: pd.DataFrame, *, probability: float = 0.9, width_mm: float = 85.0
) -> Figure:
    """Pressure against outer diameter with both bands; dashed where nothing was tested.

    Parameters
    ----------
    table : DataFrame
        From :func:`biaxbayes.findings.inflation_prediction.predict_pressure` or
        :func:`biaxbayes.findings.inflation_prediction.predict_diameter`.
    probability : float
        Content of its bands.
    width_mm : float
        Width in print.

    Returns
    -------
    matplotlib.figure.Figure
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    colour = COLOURS["x"]
    with mpl.rc_context(STYLE):
        figure = Figure((width_mm * MM, min(72.0, 0.85 * width_mm) * MM), layout="constrained")
        ax = figure.subplots()
        if "pressure_kPa_median" in table:
            across = table["outer_diameter_mm"].to_numpy()
            _bands(ax, across, table, "pressure_kPa", colour)
            _median(ax, across, table["pressure_kPa_median"], table, colour)
        else:
            up = table["pressure_kPa"].to_numpy()
            for kind, opacity in (("predictive", PREDICTIVE), ("credible", CREDIBLE)):
                low, high = (table[f"outer_diameter_mm_{kind}_{end}"] for end in ("low", "high"))
                ax.fill_betweenx(up, low, high, color=colour, alpha=opacity, linewidth=0.0)
            _median(ax, table["outer_diameter_mm_median"].to_numpy(), up, table, colour)
        ax.set_xlabel("outer diameter (mm)")
        ax.set_ylabel("pressure (kPa)")
        ax.margins(y=0.0)
        right = ax.secondary_yaxis("right", functions=(_mmHg, _kPa))
        right.set_ylabel("pressure (mmHg)")
        right.spines["right"].set_visible(True)
        ax.plot([], [], color=colour, label="median")
        _legend(ax, table, probability, bands=True)
    return figure


def figure_bytes(figure: Figure, suffix: str) -> bytes:
    """The figure as a file: fonts embedded, the same bytes for the same figure.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    suffix : {"pdf", "svg", "png"}
    """
    import matplotlib as mpl

    out = io.BytesIO()
    undated: dict[str, Any] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    # The kind of fonts is decided when the figure is saved.
    with mpl.rc_context({**STYLE, "svg.hashsalt": "biaxbayes"}):
        figure.savefig(out, format=suffix, metadata=undated.get(suffix))
    return out.getvalue()


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


def _bands(ax: Axes, abscissa: np.ndarray, table: pd.DataFrame, stem: str, colour: str) -> None:
    for kind, opacity in (("predictive", PREDICTIVE), ("credible", CREDIBLE)):
        low, high = (table[f"{stem}_{kind}_{end}"] for end in ("low", "high"))
        ax.fill_between(abscissa, low, high, color=colour, alpha=opacity, linewidth=0.0)


def _median(ax: Axes, x, y, table: pd.DataFrame, colour: str) -> None:
    """A line, solid where the states were tested and dashed elsewhere."""
    x, y = np.asarray(x), np.asarray(y)
    for tested, rows in _stretches_of(table["extrapolation"].to_numpy() == INSIDE):
        ax.plot(x[rows], y[rows], color=colour, linestyle="-" if tested else (0, (3, 2)))


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
                color="0.3",
                alpha=opacity,
                linewidth=0.0,
                label=f"{name}, {100 * probability:g} %",
            )
    if bands and (table["extrapolation"] != INSIDE).any():
        ax.plot([], [], color="0.3", linestyle=(0, (3, 2)), label="not tested")
    ax.legend(loc="upper left", handlelength=1.6, borderaxespad=0.2)
