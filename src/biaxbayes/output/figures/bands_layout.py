"""Where the panels of a bands figure stand."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.findings.bounded_density import Span
from biaxbayes.output.figures.ticks import choose_ticks, set_ticks
from biaxbayes.output.style import MM, font_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Panels"]

MAX_ROWS = 3
"""Rows of panels; what does not fit is left out, with a note."""
LEAST_MM = 32.0
"""Least width of a panel."""
POINTS_PER_MM, MAX_POINTS = 0.75, 60
"""Readings of a curve that are drawn."""


class Panels:
    """For each protocol a panel of the curves and below it the residuals in x and in y.

    Everything has its place in millimetres, so that the width in print is exact.
    """

    LEFT, BETWEEN, RIGHT = 16.0, 3.5, 2.0
    TITLE, STRIP, GAP, BELOW = 5.0, 10.5, 1.6, 10.0

    def __init__(self, protocols: int, width_mm: float) -> None:
        self.width_mm, self.protocols = width_mm, protocols
        most = max(1, int((width_mm - self.LEFT) // LEAST_MM))
        most = min(most, 3 if protocols <= 6 else 4)
        self.count = min(protocols, most * MAX_ROWS)
        self.down = math.ceil(self.count / most)
        self.across = math.ceil(self.count / self.down)
        self.axes: list[dict[str, Axes]] = []

    def draw(self) -> None:
        """Make the figure and its empty panels."""
        from matplotlib.figure import Figure

        narrow = self.width_mm < 120.0
        self.legend_mm = (9.0 if narrow else 5.5) + (0.0 if self.count == self.protocols else 4.0)
        free = self.width_mm - self.LEFT - self.RIGHT - (self.across - 1) * self.BETWEEN
        width = free / self.across
        self.points = int(np.clip(POINTS_PER_MM * width, 12, MAX_POINTS))
        self.panel_mm = width
        load = min(width, 66.0 if self.across == 1 else 50.0)
        title = self.TITLE if self.protocols > 1 else 1.5
        row = title + load + 2.0 * (self.GAP + self.STRIP) + self.BELOW
        self.height_mm = self.legend_mm + self.down * row
        self.figure: Figure = Figure((self.width_mm * MM, self.height_mm * MM))
        for number in range(self.count):
            x = self.LEFT + (number % self.across) * (width + self.BETWEEN)
            y = self.height_mm - self.legend_mm - (number // self.across) * row - title - load
            trio = {"load": self._add(x, y, width, load)}
            for axis in "xy":
                y -= self.GAP + self.STRIP
                trio[axis] = self._add(x, y, width, self.STRIP, trio["load"])
                trio[axis].axhline(0.0, color="0.4", linewidth=0.5, zorder=0.5)
            for name in ("load", "x"):
                trio[name].tick_params(labelbottom=False)
            self.axes.append(trio)

    def _add(self, x: float, y: float, width: float, height: float, over: Any = None) -> Axes:
        w, h = self.width_mm, self.height_mm
        return self.figure.add_axes((x / w, y / h, width / w, height / h), sharex=over)

    def finish(self, load: str, residual: str) -> None:
        """Common scales, so that panels can be compared; names of the axes at the left."""
        for group in (("load",), ("x", "y")):
            limits = np.array([trio[name].get_ylim() for trio in self.axes for name in group])
            shown = Span(float(limits[:, 0].min()), float(limits[:, 1].max()))
            for number, trio in enumerate(self.axes):
                for name in group:
                    trio[name].set_ylim(shown.low, shown.high)
                    self._ticks(trio[name], shown, "y", labels=number % self.across == 0)
        for number, trio in enumerate(self.axes):
            self._ticks(trio["load"], Span(*trio["load"].get_xlim()), "x", labels=True)
            if number % self.across == 0:
                self._name(trio["load"], load, 0.5)
                self._name(trio["y"], residual, 1.0 + 0.5 * self.GAP / self.STRIP)
            below = number + self.across
            label = trio["y"].get_xlabel()
            if below < self.count and self.axes[below]["y"].get_xlabel() == label:
                trio["y"].set_xlabel("")

    def _ticks(self, ax: Axes, shown: Span, which: str, *, labels: bool) -> None:
        across = which == "x"
        box = ax.get_position()
        side = box.width * self.width_mm if across else box.height * self.height_mm
        overhang = 0.4 * self.BETWEEN if across else 0.4 * self.GAP
        size = font_points(f"{which}tick.labelsize")
        ticks = choose_ticks(shown, side, size, horizontal=across, overhang=overhang, most=6)
        set_ticks(getattr(ax, f"{which}axis"), ticks, labels=labels)

    def _name(self, ax: Axes, name: str, up: float) -> None:
        """Name of a vertical axis at a fixed distance, centred ``up`` the axis."""
        away = -(self.LEFT - (6.8 if "\n" in name else 3.6)) / (
            ax.get_position().width * self.width_mm
        )
        ax.set_ylabel(name, linespacing=1.1)
        ax.yaxis.set_label_coords(away, up)
