"""Data with the credible and the predictive band of a run, protocol by protocol."""

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
    blank_figure,
    colour,
    font_points,
    layout,
    print_style,
    settle,
)
from biaxbayes.options import CONTENT, Settings
from biaxbayes.prediction.bands import bands, true_loads
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# --- where the panels of a bands figure stand ----------------------------------------------------


MAX_ROWS = 3
"""Rows of panels; what does not fit is left out, with a note."""
LEAST_MM = 32.0
"""Least width of a panel."""
LINE_MM = 4.0
"""Height of a line of the legend."""


class Panels:
    """For each protocol a panel of the curves and below it the residuals in x and in y.

    The legend, of ``lines`` entries, stands above them, or where the last row leaves a place free.
    """

    LEFT, TITLE, STRIP, GAP, BELOW = 16.0, 5.0, 10.5, 1.6, 10.0

    def __init__(self, protocols: int, width_mm: float, lines: int = 4) -> None:
        self.width_mm, self.protocols = width_mm, protocols
        most = max(1, int((width_mm - self.LEFT) // LEAST_MM))
        most = min(most, 3 if protocols <= 6 else 4)
        self.count = min(protocols, most * MAX_ROWS)
        self.down = math.ceil(self.count / most)
        self.across = math.ceil(self.count / self.down)
        self.panel_mm = (width_mm - self.LEFT) / self.across - 3.0
        self.free = self.count < self.down * self.across
        self.legend_columns = 1 if self.free else lines if width_mm >= 120.0 else 2
        self.legend_rows = 0 if self.free else math.ceil(lines / self.legend_columns)
        self.axes: list[dict[str, Axes]] = []

    def draw(self, *, noted: bool) -> None:
        """Make the figure and its empty panels, with room for a note above them."""
        load = min(self.panel_mm, 66.0 if self.across == 1 else 50.0)
        title = self.TITLE if self.protocols > 1 else 1.5
        row = title + load + 2.0 * (self.GAP + self.STRIP) + self.BELOW
        legend = LINE_MM * (self.legend_rows + noted) + 1.0
        room = layout(across_mm=1.2, down_mm=0.5 * self.GAP)
        height = (legend + self.down * row) * MM
        self.figure: Figure = blank_figure(self.width_mm * MM, height, room)
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
        first = self.axes[:: self.across]  # the others have no labels
        self.figure.align_ylabels([ax for trio in first for ax in trio.values()])


# --- data with the credible and the predictive band of a run, protocol by protocol ---------------


ROWS, DRAWS = 200, 500
"""Readings of a curve and draws that the bands are computed from; of longer records every n-th
reading is drawn, as the figure then says."""
LOADS = {
    "force": "force (N)",
    "piola": "first Piola-Kirchhoff\nstress (kPa)",
    "cauchy": "Cauchy stress (kPa)",
}
FINER = {"N": "mN", "kPa": "Pa"}
MARKERS = {"x": "o", "y": "s"}
TRUE: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (3, 2))}
"""How true loads are drawn."""
LARGEST_MARKER, LEAST_MARKER, OPEN_MARKER = 2.4, 0.9, 1.8
"""Sizes of a marker in points, and that from which it is open."""


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
        One row a draw, columns as in ``summary.csv``.
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
        One panel a protocol (the first 12) with its residuals below. All readings are drawn, of
        protocols of more than 200 rows every n-th.

    Raises
    ------
    InputError
        If the truth lacks a parameter of the law or a mounting stretch.
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
    true = None if truth is None else true_loads(shown, truth, settings=settings, max_rows=ROWS)
    return drawn_bands(
        specimen, table, truth=true, probability=probability, width_mm=width_mm, style=style
    )


def shown_protocols(specimen: Specimen, width_mm: float) -> int:
    """Protocols that a figure of this width has panels for."""
    return Panels(len(specimen.protocols), width_mm).count


def drawn_bands(
    specimen: Specimen,
    table: pd.DataFrame,
    *,
    truth: np.ndarray | None = None,
    probability: float = CONTENT,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """The same of bands that are there already.

    Parameters
    ----------
    specimen : Specimen
    table : DataFrame
        As of :func:`~biaxbayes.prediction.bands.bands`; of the protocols that have panels.
    truth : ndarray, shape (rows,), optional
        True loads at the rows of the table.
    probability, width_mm, style
        As in :func:`bands_figure`.
    """
    panels = Panels(len(specimen.protocols), width_mm, 4 if truth is None else 5)
    # The quantiles are named after their levels; here they go by their order.
    table = table.set_axis(pd.Index([*table.columns[:5], *QUANTILES]), axis=1)
    if truth is not None:
        table["truth"] = truth
    note = _note(panels, specimen, table)
    tests = [
        {str(axis): part for axis, part in one.groupby("direction")}
        for _, one in table.groupby("protocol", sort=False)
    ]
    scale, unit = residual_unit(table, specimen.unit)
    with print_style(style):
        panels.draw(noted=bool(note) and not panels.free)
        size = font_points("axes.titlesize")
        for trio, test in zip(panels.axes, tests, strict=True):
            places, label = abscissa(test)
            for axis, part in test.items():
                marker = _marker(axis, len(part), panels.panel_mm)
                _curve(trio["load"], part, places[axis], axis, marker)
                _residuals(trio[axis], part, places[axis], axis, scale, marker)
            trio["y"].set_xlabel(label)
            if len(specimen.protocols) > 1:
                name = shortened(test["x"]["protocol"].iloc[0], panels.panel_mm, size)
                trio["load"].set_title(name, pad=2.0)
        panels.finish(LOADS[specimen.stress_pair], f"residual ({unit})")
        if not panels.free:
            _legend(panels, specimen, probability, note, truth is not None)
        settle(panels.figure)
        if panels.free:
            _legend(panels, specimen, probability, note, truth is not None)
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


def _marker(axis: str, readings: int, panel_mm: float) -> dict[str, Any]:
    """Marker of the readings of a curve, small enough to be told apart along the panel."""
    apart = 0.8 * panel_mm * MM * 72.0 / readings
    size, hue = float(np.clip(apart, LEAST_MARKER, LARGEST_MARKER)), colour(axis)
    opened = size >= OPEN_MARKER
    return {
        "marker": MARKERS[axis],
        "markersize": size,
        "markerfacecolor": "white" if opened else hue,
        "markeredgecolor": hue,
        "markeredgewidth": 0.6 if opened else 0.0,
    }


def _curve(
    ax: Axes, part: pd.DataFrame, x: np.ndarray, axis: str, marker: Mapping[str, Any]
) -> None:
    hue = colour(axis)
    order = np.argsort(x, kind="stable")
    for kind, opacity in KINDS:
        low, high = (part[f"{kind}_{end}"].to_numpy()[order] for end in ("low", "high"))
        ax.fill_between(x[order], low, high, color=hue, alpha=opacity, linewidth=0.0)
    ax.plot(x[order], part["median"].to_numpy()[order], color=hue, linewidth=0.8)
    ax.plot(x, part["measured"], linestyle="none", **marker)
    if "truth" in part:
        ax.plot(x[order], part["truth"].to_numpy()[order], **TRUE)


def _residuals(
    ax: Axes,
    part: pd.DataFrame,
    x: np.ndarray,
    axis: str,
    scale: float,
    marker: Mapping[str, Any],
) -> None:
    hue = colour(axis)
    order = np.argsort(x, kind="stable")
    about = {name: scale * (part[name] - part["median"]).to_numpy() for name in QUANTILES}
    for kind, opacity in KINDS:
        low, high = (about[f"{kind}_{end}"][order] for end in ("low", "high"))
        ax.fill_between(x[order], low, high, color=hue, alpha=opacity, linewidth=0.0)
    ax.plot(x, scale * (part["measured"] - part["median"]).to_numpy(), linestyle="none", **marker)
    if "truth" in part:
        missed = scale * (part["truth"] - part["median"]).to_numpy()
        ax.plot(x[order], missed[order], **TRUE)


def _note(panels: Panels, specimen: Specimen, table: pd.DataFrame) -> str:
    """What is left out of the figure."""
    out = []
    if panels.count < panels.protocols:
        out.append(f"the first {panels.count} of {panels.protocols} protocols")
    rows = {p.name: p.rows for p in specimen.protocols}
    drawn = table[table["direction"] == "x"].groupby("protocol", sort=False).size()
    step = max(-(-(rows[str(name)] - 1) // max(int(n) - 1, 1)) for name, n in drawn.items())
    if step > 1:
        out.append(f"one reading in {step} is drawn")
    return "; ".join(out)


def _legend(panels: Panels, specimen: Specimen, probability: float, note: str, truth: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    size = font_points("legend.fontsize")
    handles: list[Any] = []
    room = min(30.0, panels.panel_mm - 10.0)
    for axis, name in (("x", specimen.axis_x), ("y", specimen.axis_y)):
        line = Line2D([], [], color=colour(axis), **_marker(axis, 1, panels.panel_mm))
        line.set(linewidth=0.8, label=f"{axis}: {shortened(name, room, size)}" if name else axis)
        handles.append(line)
    for kind, opacity in reversed(KINDS):
        label = f"{kind} band, {100 * probability:g} %"
        handles.append(Patch(facecolor="0.3", alpha=opacity, linewidth=0.0, label=label))
    if truth:
        handles.append(Line2D([], [], label="truth", **TRUE))
    if panels.free:
        if note:
            handles.append(Line2D([], [], linestyle="none", label=note))
        # in the place below the last panel of the row above, beside the last panel
        above = panels.axes[panels.count - panels.across]["load"].get_position()
        beside = panels.axes[-1]["load"].get_position()
        how: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (above.x0, beside.y1)}
        how |= {"borderpad": 0.0, "handlelength": 1.3, "handletextpad": 0.6}
    else:
        how = {"loc": "outside upper left"}
        if note:
            panels.figure.suptitle(note, x=0.99, ha="right", fontsize=size)
    panels.figure.legend(
        handles=handles,
        ncols=panels.legend_columns,
        borderaxespad=0.0 if panels.free else 0.2,
        columnspacing=1.4,
        **how,
    )
