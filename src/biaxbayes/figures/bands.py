"""Data with the credible and the predictive band of a run, protocol by protocol.

Where the panels of a bands figure stand.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.figures.labels import few_ticks, shortened
from biaxbayes.figures.style import (
    CREDIBLE,
    MM,
    PAGE_MM,
    PREDICTIVE,
    colour,
    font_points,
    layout,
    print_style,
    settle,
)
from biaxbayes.options import Settings
from biaxbayes.prediction.bands import bands, evenly_spaced
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "LOADS",
    "Panels",
    "abscissa",
    "bands_figure",
    "drawn_bands",
    "residual_unit",
    "shown_protocols",
]


# --- where the panels of a bands figure stand ----------------------------------------------------


MAX_ROWS = 3
"""Rows of panels; what does not fit is left out, with a note."""
LEAST_MM = 32.0
"""Least width of a panel."""
POINTS_PER_MM, MAX_POINTS = 0.75, 60
"""Readings of a curve that are drawn."""


class Panels:
    """For each protocol a panel of the curves and below it the residuals in x and in y."""

    LEFT, TITLE, STRIP, GAP, BELOW = 16.0, 5.0, 10.5, 1.6, 10.0

    def __init__(self, protocols: int, width_mm: float) -> None:
        self.width_mm, self.protocols = width_mm, protocols
        most = max(1, int((width_mm - self.LEFT) // LEAST_MM))
        most = min(most, 3 if protocols <= 6 else 4)
        self.count = min(protocols, most * MAX_ROWS)
        self.down = math.ceil(self.count / most)
        self.across = math.ceil(self.count / self.down)
        self.panel_mm = (width_mm - self.LEFT) / self.across - 3.0
        self.points = int(np.clip(POINTS_PER_MM * self.panel_mm, 12, MAX_POINTS))
        self.axes: list[dict[str, Axes]] = []

    def draw(self) -> None:
        """Make the figure and its empty panels."""
        from matplotlib.figure import Figure

        load = min(self.panel_mm, 66.0 if self.across == 1 else 50.0)
        title = self.TITLE if self.protocols > 1 else 1.5
        row = title + load + 2.0 * (self.GAP + self.STRIP) + self.BELOW
        legend = (9.0 if self.width_mm < 120.0 else 5.5) + 4.0 * (self.count < self.protocols)
        room = layout(across_mm=1.2, down_mm=0.5 * self.GAP)
        height = (legend + self.down * row) * MM
        self.figure: Figure = Figure((self.width_mm * MM, height), layout=room)
        ratios = [load, self.STRIP, self.STRIP] * self.down
        places = self.figure.add_gridspec(3 * self.down, self.across, height_ratios=ratios)
        for number in range(self.count):
            down, across = divmod(number, self.across)
            trio = {"load": self.figure.add_subplot(places[3 * down, across])}
            for k, axis in enumerate("xy", start=1):
                place = places[3 * down + k, across]
                trio[axis] = self.figure.add_subplot(place, sharex=trio["load"])
                trio[axis].axhline(0.0, color="0.4", linewidth=0.5, zorder=0.5)
            for name in ("load", "x"):
                trio[name].tick_params(labelbottom=False)
            self.axes.append(trio)

    def finish(self, load: str, residual: str) -> None:
        """Common scales, so that panels can be compared; names of the axes at the left."""
        for group in (("load",), ("x", "y")):
            limits = np.array([trio[name].get_ylim() for trio in self.axes for name in group])
            for number, trio in enumerate(self.axes):
                for name in group:
                    trio[name].set_ylim(limits[:, 0].min(), limits[:, 1].max())
                    few_ticks(trio[name].yaxis, most=6, overhang=0.4 * self.GAP)
                    trio[name].tick_params(labelleft=number % self.across == 0)
        for number, trio in enumerate(self.axes):
            few_ticks(trio["load"].xaxis, most=6, overhang=1.4)
            if number % self.across == 0:
                trio["load"].set_ylabel(load, linespacing=1.1)
                # In the middle of both strips, whose heights do not depend on it.
                trio["y"].set_ylabel(residual, y=1.0 + 0.5 * self.GAP / self.STRIP)
                trio["y"].yaxis.label.set_in_layout(False)
            below = number + self.across
            label = trio["y"].get_xlabel()
            if below < self.count and self.axes[below]["y"].get_xlabel() == label:
                trio["y"].set_xlabel("")
        self.figure.align_ylabels()


# --- data with the credible and the predictive band of a run, protocol by protocol ---------------


ROWS, DRAWS = 81, 500
"""States of a curve and draws that the bands are computed from."""
LOADS = {
    "force": "force (N)",
    "piola": "first Piola-Kirchhoff\nstress (kPa)",
    "cauchy": "Cauchy stress (kPa)",
}
FINER = {"N": "mN", "kPa": "Pa"}
MARKERS = {"x": "o", "y": "s"}
_MARKER: dict[str, Any] = {
    "markersize": 2.4,
    "markerfacecolor": "white",
    "markeredgewidth": 0.6,
}


def bands_figure(
    specimen: Specimen,
    draws: pd.DataFrame,
    *,
    settings: Settings | None = None,
    probability: float = 0.9,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Load against measured stretch with both bands, and what the median misses.

    Parameters
    ----------
    specimen : Specimen
    draws : DataFrame
        One row a draw, columns as in ``summary.csv``.
    settings : Settings, optional
        Those of the run.
    probability : float
        Content of each band.
    width_mm : float
        Width in print.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
        One panel a protocol (the first 12) with its residuals below. Readings are
        thinned so that they can be told apart.
    """
    shown = replace(specimen, protocols=specimen.protocols[: shown_protocols(specimen, width_mm)])
    table = bands(
        shown,
        draws,
        settings=settings,
        probability=probability,
        max_rows=ROWS,
        max_draws=DRAWS,
    )
    return drawn_bands(specimen, table, probability=probability, width_mm=width_mm, style=style)


def shown_protocols(specimen: Specimen, width_mm: float) -> int:
    """Protocols that a figure of this width has panels for."""
    return Panels(len(specimen.protocols), width_mm).count


def drawn_bands(
    specimen: Specimen,
    table: pd.DataFrame,
    *,
    probability: float = 0.9,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """The same of bands that are there already.

    Parameters
    ----------
    specimen : Specimen
    table : DataFrame
        As of :func:`~biaxbayes.prediction.bands.bands`; of the protocols that have panels.
    probability, width_mm, style
        As in :func:`bands_figure`.
    """
    panels = Panels(len(specimen.protocols), width_mm)
    # The quantiles are named after their levels; here they go by their order.
    table = table.set_axis(pd.Index([*table.columns[:5], *QUANTILES]), axis=1)
    tests = [
        {str(axis): part for axis, part in one.groupby("direction")}
        for _, one in table.groupby("protocol", sort=False)
    ]
    scale, unit = residual_unit(table, specimen.unit)
    with print_style(style):
        panels.draw()
        size = font_points("axes.titlesize")
        for trio, test in zip(panels.axes, tests, strict=True):
            places, label = abscissa(test)
            for axis, part in test.items():
                _curve(trio["load"], part, places[axis], axis, panels.points)
                _residuals(trio[axis], part, places[axis], axis, scale, panels.points)
            trio["y"].set_xlabel(label)
            if len(specimen.protocols) > 1:
                name = shortened(test["x"]["protocol"].iloc[0], panels.panel_mm, size)
                trio["load"].set_title(name, pad=2.0)
        panels.finish(LOADS[specimen.stress_pair], f"residual ({unit})")
        _legend(panels, specimen, probability)
        settle(panels.figure)
    return panels.figure


QUANTILES = (
    "credible_low",
    "median",
    "credible_high",
    "predictive_low",
    "predictive_median",
    "predictive_high",
)
KINDS = (("predictive", PREDICTIVE), ("credible", CREDIBLE))


def residual_unit(table: pd.DataFrame, unit: str) -> tuple[float, str]:
    """Factor and unit that spare the residuals leading zeros.

    Parameters
    ----------
    table : DataFrame
        With ``measured`` and ``median``.
    unit : {"N", "kPa"}
    """
    largest = float((table["measured"] - table["median"]).abs().max())
    return (1000.0, FINER[unit]) if largest < 0.05 else (1.0, unit)


def abscissa(test: dict[str, pd.DataFrame]) -> tuple[dict[str, np.ndarray], str]:
    """What to draw the curves of a test against, and its name.

    Each direction's own stretch, if the model is a curve over it; else (a direction that is held,
    or a path that turns back) the stretch of the leading direction; else the number of the row.

    Parameters
    ----------
    test : dict of DataFrame
        Of ``x`` and ``y``, each with ``stretch``, ``row`` and ``median``.
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


def _curve(ax: Axes, part: pd.DataFrame, x: np.ndarray, axis: str, points: int) -> None:
    hue = colour(axis)
    order = np.argsort(x, kind="stable")
    for kind, opacity in KINDS:
        low, high = (part[f"{kind}_{end}"].to_numpy()[order] for end in ("low", "high"))
        ax.fill_between(x[order], low, high, color=hue, alpha=opacity, linewidth=0.0)
    ax.plot(x[order], part["median"].to_numpy()[order], color=hue, linewidth=0.8)
    _points(ax, x, part["measured"].to_numpy(), axis, points)


def _residuals(
    ax: Axes, part: pd.DataFrame, x: np.ndarray, axis: str, scale: float, points: int
) -> None:
    hue = colour(axis)
    order = np.argsort(x, kind="stable")
    about = {name: scale * (part[name] - part["median"]).to_numpy() for name in QUANTILES}
    for kind, opacity in KINDS:
        low, high = (about[f"{kind}_{end}"][order] for end in ("low", "high"))
        ax.fill_between(x[order], low, high, color=hue, alpha=opacity, linewidth=0.0)
    _points(ax, x, scale * (part["measured"] - part["median"]).to_numpy(), axis, points)


def _points(ax: Axes, x: np.ndarray, y: np.ndarray, axis: str, points: int) -> None:
    chosen = evenly_spaced(len(x), points)
    ax.plot(
        x[chosen],
        y[chosen],
        linestyle="none",
        marker=MARKERS[axis],
        markeredgecolor=colour(axis),
        **_MARKER,
    )


def _legend(panels: Panels, specimen: Specimen, probability: float) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    size = font_points("legend.fontsize")
    handles: list[Any] = []
    for axis, name in (("x", specimen.axis_x), ("y", specimen.axis_y)):
        line = Line2D([], [], color=colour(axis), marker=MARKERS[axis], **_MARKER)
        line.set(linewidth=0.8, label=f"{axis}: {shortened(name, 30.0, size)}" if name else axis)
        handles.append(line)
    for kind, opacity in reversed(KINDS):
        label = f"{kind} band, {100 * probability:g} %"
        handles.append(Patch(facecolor="0.3", alpha=opacity, linewidth=0.0, label=label))
    panels.figure.legend(
        handles=handles,
        loc="outside upper left",
        ncols=4 if panels.width_mm >= 120.0 else 2,
        borderaxespad=0.2,
        columnspacing=1.4,
    )
    if panels.count < panels.protocols:
        note = f"the first {panels.count} of {panels.protocols} protocols"
        panels.figure.suptitle(note, x=0.99, ha="right", fontsize=size)
