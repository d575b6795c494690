"""Prior, posterior and verdict of each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.figures import style
from biaxbayes.figures.quantities import axis_text
from biaxbayes.identifiability import verdict
from biaxbayes.identifiability.identify import Identifiability
from biaxbayes.identifiability.reported import Reported
from biaxbayes.model.priors import Prior

# Okabe and Ito, from known to unknown; the verdict is also written in the box.
VERDICT_COLOURS = {
    verdict.IDENTIFIED: "#009E73",
    verdict.MEASURED: "#0072B2",
    verdict.BOUNDED: "#56B4E9",
    verdict.COMBINATION: "#E69F00",
    verdict.NOT_IDENTIFIED: "#CC79A7",
    verdict.NO_VERDICT: "#999999",
    verdict.FIXED: "#DDDDDD",
}
PRIOR_GREY, POSTERIOR = "0.82", "#0072B2"
MAX_ROWS, REASON_LINE_MM = 16, 3.4
WIDE, NARROW = (12.5, 40, 2), (24.0, 24, 4)
"""Least height of a row, letters per line of its reason, and lines of interval and verdict."""


@style.print_style()
def identifiability_figure(
    verdicts: Identifiability, reported: Sequence[Reported], *, width_mm: float = style.PAGE_MM
) -> Figure:
    """Prior and posterior of the first 16 parameters beside their rows of the reported table."""
    rows = reported[:MAX_ROWS]
    wide = width_mm >= style.SIDE_BY_SIDE_MM
    min_mm, letters, lines = WIDE if wide else NARROW
    reasons = [fill(row.reason, letters, break_on_hyphens=False) for row in rows]
    heights = [max(min_mm, REASON_LINE_MM * (text.count("\n") + lines)) for text in reasons]
    widths = (0.34, 0.12, 0.5) if wide else (0.52, 0.48)
    headings = ["prior, posterior", "verdict"]
    if wide:
        headings = ["prior (grey), posterior", "contraction", "verdict"]
    figure = style.blank_figure(width_mm, 7.0 + sum(heights))
    grid = figure.subplots(
        len(rows), len(widths), squeeze=False, width_ratios=widths, height_ratios=heights
    )
    in_box, beside = ((0.02, 0.5), (0.42, 0.5)) if wide else ((0.02, 0.9), (0.0, 0.3))
    for axes, row, reason in zip(grid, rows, reasons, strict=True):
        _draw_densities(axes[0], verdicts[row.name])
        if wide:
            _draw_contraction(axes[1], verdicts[row.name])
        # the verdict in a box; beside it, or below, interval and reason
        ax, face = axes[-1], VERDICT_COLOURS[row.verdict]
        ax.set_axis_off()
        ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
        box = {"boxstyle": "round,pad=0.3", "facecolor": face, "edgecolor": "none"}
        look = style.small_text(va="center")
        ax.text(*in_box, row.verdict, color=style.text_colour(face), bbox=box, **look)
        ax.text(*beside, f"{row.text} ({row.interval_with_unit})\n{reason}", **look)
    for ax, heading in zip(grid[0], headings, strict=True):
        ax.set_title(heading, loc="left", **style.small_text(color="0.35"))
    return figure


def _draw_densities(ax: Axes, row: verdict.ParameterVerdict) -> None:
    label = axis_text(row.scale.quantity).label
    ax.set_ylabel(label, rotation=0.0, ha="right", va="center")
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    diagnostics = row.diagnostics
    prior_density = diagnostics.prior_density if diagnostics else None
    posterior_density = diagnostics.posterior_density if diagnostics else None
    if prior_density is None or posterior_density is None:
        ax.set_xticks([])
        ax.spines["bottom"].set_visible(False)
        return
    if row.scale.parameter.logarithmic:
        ax.set_xscale("log")
    for density, colour, outline in (
        (prior_density, PRIOR_GREY, "0.6"),
        (posterior_density, POSTERIOR, None),
    ):
        x, height = row.scale.from_scale(density.x), density.height / density.peak
        ax.fill_between(x, height, color=colour, alpha=1.0 if outline else 0.75, linewidth=0.0)
        ax.plot(x, height, color=outline or colour, linewidth=0.5)
    # the physical range if it is bounded, otherwise 98 % of the prior and all of the posterior
    prior, (low, high) = row.scale.prior, row.scale.limits
    if not (np.isfinite(high) and np.isfinite(row.scale.to_scale(np.array(low)))):
        assert isinstance(prior, Prior)
        ends = row.scale.from_scale(posterior_density.x[[0, -1]])
        low, high = prior.ppf(np.array([0.01, 0.99]))
        low, high = min(low, ends[0]), max(high, ends[1])
    ax.set(xlim=(low, high), ylim=(0.0, 1.08))
    style.limit_ticks(ax.xaxis)
    ax.tick_params(axis="x", length=2.0, pad=1.0)


def _draw_contraction(ax: Axes, row: verdict.ParameterVerdict) -> None:
    """Draw a bar of the share of the prior variance that the data remove."""
    ax.set_axis_off()
    if row.diagnostics is None:
        return
    contraction = max(row.diagnostics.contraction, 0.0)
    ax.barh(0.0, 1.0, height=0.4, color="0.92")
    ax.barh(0.0, contraction, height=0.4, color="0.35")
    ax.set(xlim=(0.0, 1.9), ylim=(-0.6, 0.6))
    per_cent = f"{100.0 * min(contraction, 0.999):.3g} %"
    ax.text(1.06, 0.0, per_cent, **style.small_text(va="center"))
