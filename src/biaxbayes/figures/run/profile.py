"""Profile likelihoods: the curve with its threshold, and how the other parameters follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.figures.quantities import axis_text
from biaxbayes.figures.style import (
    PAGE_MM,
    SIDE_BY_SIDE_MM,
    blank_figure,
    colour,
    few_ticks,
    font_points,
    plain,
    print_style,
)
from biaxbayes.identifiability.profile.profile import THRESHOLD, Profile
from biaxbayes.options import CONTENT
from biaxbayes.parameters import DEGREE, MATERIAL, STRETCH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_MM, NARROW_MM, HEAD_MM = 46.0, 40.0, 2.0
CEILING = THRESHOLD + 2.0
"""Deviance up to which a curve is drawn."""
STYLES = (("run", "-"), ("other", "--"), ("third", "-."))


def profile_figure(
    profiles: Sequence[Profile],
    *,
    titles: Sequence[str] | None = None,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """One row per profile.

    Parameters
    ----------
    profiles : sequence of Profile
    titles : sequence of str, optional
        One per row, such as the layer.
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
        From left to right the deviance with the threshold and interval, and the values that
        C1, k1 and k2 (relative to the best fit), alpha and kappa, and the mounting stretches take;
        below 120 mm two and two.
    """
    with print_style(style):
        lines = 1 if width_mm >= SIDE_BY_SIDE_MM else 2
        height = HEAD_MM + (ROW_MM if lines == 1 else NARROW_MM) * lines * len(profiles)
        figure = blank_figure(width_mm, height)
        panels = figure.subplots(lines * len(profiles), 4 // lines, squeeze=False)
        grid = panels.reshape(len(profiles), 4)
        for i, (row, profile) in enumerate(zip(grid, profiles, strict=True)):
            _deviance(row[0], profile)
            _stiffness(row[1], profile)
            _structure(row[2], profile)
            _mounting(row[3], profile)
            label = axis_text(profile.quantity).label
            for ax in row:
                ax.set_xlabel(label)
                _set_scale(ax, profile)
            if titles is not None:
                row[0].set_title(plain(titles[i]), loc="left", fontweight="bold")
    return figure


def _smooth(profile: Profile, y: Any, *, log: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A curve through the points of a profile that overshoots none of them (PCHIP)."""
    from scipy.interpolate import PchipInterpolator

    value = profile.table["value"].to_numpy()[_shown(profile)]
    value, first = np.unique(value, return_index=True)
    y = np.asarray(y, dtype=float)[first]
    if value.size < 2:
        return value, y
    fine = np.linspace(value[0], value[-1], 300)
    if profile.quantity.parameter.logarithmic:
        fine = np.geomspace(value[0], value[-1], 300)
    curve = PchipInterpolator(value, np.log(y) if log else y)(fine)
    return fine, np.exp(curve) if log else curve


def _shown(profile: Profile) -> np.ndarray:
    """Rows of the table that are drawn: up to a little beyond the threshold."""
    table = profile.table
    shown = table["deviance"].to_numpy() <= CEILING
    if profile.quantity.parameter.logarithmic:
        shown &= table["value"].to_numpy() > 0.0
    return shown


def _set_scale(ax: Axes, profile: Profile) -> None:
    value = profile.table["value"].to_numpy()[_shown(profile)]
    if profile.quantity.parameter.logarithmic and value.max() > 5.0 * value.min():
        ax.set_xscale("log")
    else:
        ax.margins(x=0.03)
    few_ticks(ax.xaxis, 3)


def _deviance(ax: Axes, profile: Profile) -> None:
    shown = profile.table[_shown(profile)]
    blue = colour("run")
    best = int(profile.table["deviance"].argmin())
    inside = shown[(shown["value"] >= profile.low) & (shown["value"] <= profile.high)]
    if len(inside):
        ax.axvspan(
            max(profile.low, float(shown["value"].min())),
            min(profile.high, float(shown["value"].max())),
            color=blue,
            alpha=0.12,
            linewidth=0.0,
        )
    # in the square root of the deviance, which is straight where the likelihood is normal
    signs = np.sign(shown["value"] - profile.table["value"].iloc[best])
    x, root = _smooth(profile, signs * np.sqrt(np.maximum(shown["deviance"], 0.0)))
    ax.plot(x, root**2, color=blue)
    ax.plot(shown["value"], shown["deviance"], "o", color=blue, markersize=1.6)
    ax.axhline(THRESHOLD, color="0.35", linewidth=0.8, linestyle=(0, (4, 2)))
    ax.annotate(
        f"{100.0 * CONTENT:g} %",
        (0.5, THRESHOLD),
        xycoords=("axes fraction", "data"),
        xytext=(0, 1.5),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=font_points("legend.fontsize"),
        color="0.35",
    )
    ax.set_ylim(0.0, CEILING)
    few_ticks(ax.yaxis)
    ax.set_ylabel(r"$-2\,\Delta\ln L$")


def _stiffness(ax: Axes, profile: Profile) -> None:
    """C1, k1 and k2 relative to the best fit, on a logarithmic axis."""
    shown = profile.table[_shown(profile)]
    best = profile.table.iloc[int(profile.table["deviance"].argmin())]
    scales = [q for q in profile.known.of_kind(MATERIAL) if q.parameter.logarithmic]
    for (role, line), q in zip(cycle(STYLES), scales, strict=False):
        name = q.name
        if name == profile.parameter or not best[name] > 0.0:
            continue
        ratio = np.maximum(shown[name].to_numpy() / best[name], 1e-4)
        label = axis_text(q).symbol
        curve = _smooth(profile, ratio, log=True)
        ax.plot(*curve, color=colour(role), linestyle=line, label=label)
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    ax.set_ylim(min(low, 0.5), max(high, 2.0))
    ax.set_ylabel("relative to best")
    few_ticks(ax.yaxis)
    ax.legend(loc="best", handlelength=1.8)


def _structure(ax: Axes, profile: Profile) -> None:
    """Angle on the left, dispersion on the right, but for the one that is profiled."""
    shown = profile.table[_shown(profile)]
    bounded = [q for q in profile.known.of_kind(MATERIAL) if q.parameter.bounded]
    names = [q for q in bounded if q.name != profile.parameter][:2]
    for k, q in enumerate(names):
        name, angle = q.name, q.parameter.unit == DEGREE
        side = ax if k == 0 else ax.twinx()
        role, line = STYLES[k]
        side.plot(*_smooth(profile, shown[name]), color=colour(role), linestyle=line)
        side.set_ylabel(axis_text(q).label, color=colour(role) if len(names) > 1 else "black")
        values = shown[name].to_numpy()
        pad = max(0.08 * float(np.ptp(values)), 1.0 if angle else 0.005)
        top = q.parameter.high
        side.set_ylim(max(values.min() - pad, -0.02 * top), min(values.max() + pad, 1.02 * top))
        few_ticks(side.yaxis)
        if k == 1:
            side.spines["right"].set_visible(True)


def _mounting(ax: Axes, profile: Profile) -> None:
    """Mounting stretches; the mean over the protocols where each has its own."""
    shown = profile.table[_shown(profile)]
    stretches = profile.known.of_kind(STRETCH)
    for k, (role, line, axis) in enumerate((("x", "-", "x"), ("y", "--", "y"))):
        columns = [q.name for q in stretches if q.axis == k and q.name in shown.columns]
        if not columns:
            continue
        lm = shown[columns].mean(axis=1)
        ax.plot(*_smooth(profile, lm), color=colour(role), linestyle=line, label=f"${axis}$")
    if not ax.lines:
        ax.axhline(1.0, color="0.6", linewidth=0.8)
    low, high = ax.get_ylim()
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), 0.004)
    ax.set_ylim(middle - half, middle + half)
    few_ticks(ax.yaxis)
    ax.set_ylabel("mounting stretch")
    if len(ax.lines) > 1:
        ax.legend(loc="best", handlelength=1.8)
