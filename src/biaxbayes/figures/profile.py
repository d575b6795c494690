"""Profile likelihoods: the curve with its threshold, and how the other parameters follow."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

from biaxbayes.figures import style
from biaxbayes.figures.quantities import axis_text
from biaxbayes.options import CONTENT
from biaxbayes.parameters import DEGREE, MATERIAL, STRETCH
from biaxbayes.profiles.profile import Profile
from biaxbayes.profiles.profile_curve import CEILING, THRESHOLD

ROW_MM, NARROW_MM, HEAD_MM = 46.0, 40.0, 2.0
CURVE_STYLES = ((0, "-"), (1, "--"), (2, "-."))
"""Colour and dashes of the curves of a panel."""


@style.print_style()
def profile_figure(profiles: Sequence[Profile], *, width_mm: float = style.PAGE_MM) -> Figure:
    """Draw a row per profile: deviance with threshold, and the values of the other parameters."""
    lines = 1 if width_mm >= style.SIDE_BY_SIDE_MM else 2
    height = HEAD_MM + (ROW_MM if lines == 1 else NARROW_MM) * lines * len(profiles)
    figure = style.blank_figure(width_mm, height)
    panels = figure.subplots(lines * len(profiles), 4 // lines, squeeze=False)
    for profile, row in zip(profiles, panels.reshape(-1, 4), strict=True):
        drawn = _Curves(profile)
        value = drawn.table["value"]
        drawings = (drawn.deviance, drawn.stiffness, drawn.structure, drawn.mounting)
        for ax, draw in zip(row, drawings, strict=True):
            draw(ax)
            ax.set_xlabel(axis_text(profile.quantity).label)
            if drawn.log and value.max() > 5.0 * value.min():
                ax.set_xscale("log")
            else:
                ax.margins(x=0.03)
            style.limit_ticks(ax.xaxis, 3)
    return figure


class _Curves:
    """Draws the part of a profile up to a little beyond the threshold, panel by panel."""

    def __init__(self, profile: Profile) -> None:
        table = profile.table
        self.profile = profile
        self.log = profile.quantity.parameter.logarithmic
        self.best = table.iloc[int(table["deviance"].argmin())]
        shown = table["deviance"] <= CEILING
        self.table = table[shown & (table["value"] > 0.0)] if self.log else table[shown]

    def smooth(self, y: Any) -> tuple[np.ndarray, np.ndarray]:
        """A curve through the points without overshoot (PCHIP)."""
        value, first = np.unique(self.table["value"].to_numpy(), return_index=True)
        y = np.asarray(y, dtype=float)[first]
        if value.size < 2:
            return value, y
        fine = (np.geomspace if self.log else np.linspace)(value[0], value[-1], 300)
        return fine, PchipInterpolator(value, y)(fine)

    def deviance(self, ax: Axes) -> None:
        table, blue = self.table, style.colour(0)
        low = max(self.profile.low, table["value"].min())
        high = min(self.profile.high, table["value"].max())
        if low < high:
            ax.axvspan(low, high, color=blue, alpha=0.12, linewidth=0.0)
        # in the square root of the deviance, which is straight where the likelihood is normal
        signs = np.sign(table["value"] - self.best["value"])
        x, root = self.smooth(signs * np.sqrt(np.maximum(table["deviance"], 0.0)))
        ax.plot(x, root**2, color=blue)
        ax.plot(table["value"], table["deviance"], "o", color=blue, markersize=1.6)
        ax.axhline(THRESHOLD, color="0.35", linewidth=0.8, linestyle=(0, (4, 2)))
        at, how = ax.get_yaxis_transform(), style.small_text(ha="center", va="bottom", color="0.35")
        ax.text(0.5, THRESHOLD + 0.05, f"{100.0 * CONTENT:g} %", transform=at, **how)
        ax.set_ylim(0.0, CEILING)
        style.limit_ticks(ax.yaxis)
        ax.set_ylabel(r"$-2\,\Delta\ln L$")

    def stiffness(self, ax: Axes) -> None:
        """Stiffnesses and exponents relative to the best fit, on a logarithmic axis."""
        scales = [q for q in self.profile.known.of_kind(MATERIAL) if q.parameter.logarithmic]
        for (hue, line), q in zip(cycle(CURVE_STYLES), scales, strict=False):
            if q.name == self.profile.parameter or not self.best[q.name] > 0.0:
                continue
            ratio = np.maximum(self.table[q.name].to_numpy() / self.best[q.name], 1e-4)
            x, log_ratio = self.smooth(np.log(ratio))
            label = axis_text(q).symbol
            ax.plot(x, np.exp(log_ratio), color=style.colour(hue), linestyle=line, label=label)
        ax.set_yscale("log")
        low, high = ax.get_ylim()
        ax.set_ylim(min(low, 0.5), max(high, 2.0))
        ax.set_ylabel("relative to best")
        style.limit_ticks(ax.yaxis)
        ax.legend(handlelength=1.8)

    def structure(self, ax: Axes) -> None:
        """Angle on the left, dispersion on the right, except the profiled parameter."""
        bounded = [q for q in self.profile.known.of_kind(MATERIAL) if q.parameter.bounded]
        shown = [q for q in bounded if q.name != self.profile.parameter][:2]
        for k, q in enumerate(shown):
            side = ax if k == 0 else ax.twinx()
            hue, line = CURVE_STYLES[k]
            values = self.table[q.name]
            tint = style.colour(hue)
            side.plot(*self.smooth(values), color=tint, linestyle=line)
            side.set_ylabel(axis_text(q).label, color=tint if len(shown) > 1 else "black")
            min_pad = 1.0 if q.parameter.unit == DEGREE else 0.005
            pad, top = max(0.08 * float(np.ptp(values)), min_pad), q.parameter.high
            side.set_ylim(max(values.min() - pad, -0.02 * top), min(values.max() + pad, 1.02 * top))
            style.limit_ticks(side.yaxis)
            side.spines["right"].set_visible(k == 1)

    def mounting(self, ax: Axes) -> None:
        """Mounting stretches; the mean over the protocols where each has its own."""
        stretches = self.profile.known.of_kind(STRETCH)
        for k, line in enumerate(("-", "--")):
            columns = [q.name for q in stretches if q.axis == k and q.name in self.table]
            if columns:
                curve, axis = self.smooth(self.table[columns].mean(axis=1)), "xy"[k]
                ax.plot(*curve, color=style.colour(axis), linestyle=line, label=f"${axis}$")
        if not ax.lines:
            ax.axhline(1.0, color="0.6", linewidth=0.8)
        low, high = ax.get_ylim()
        middle, half = 0.5 * (low + high), max(0.5 * (high - low), 0.004)
        ax.set_ylim(middle - half, middle + half)
        style.limit_ticks(ax.yaxis)
        ax.set_ylabel("mounting stretch")
        if len(ax.lines) > 1:
            ax.legend(handlelength=1.8)
