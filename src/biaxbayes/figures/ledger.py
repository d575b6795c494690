"""The cost of ignoring the mounting stretch: three treatments of the same record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.comparison.mounting_bias import VARIANTS, Ledger
from biaxbayes.figures.quantities import axis_text, number, quantity
from biaxbayes.figures.style import PAGE_MM, RUNS, blank_figure, colour, print_style

MARKERS, OFFSETS = ("o", "s", "^"), (-0.25, 0.0, 0.25)
LABELS = (
    "mounting stretch inferred, within the law",
    "ignored",
    "ignored, forces zeroed (medians, 90 %)",
)
LEVELS = ("q05", "median", "q95")
ROW_MM = 8.5
LARGEST_LINEAR, LINEAR = 15.0, 2.0
"""Up to the first shift the axis is linear; beyond, it is logarithmic outside the second."""


def ledger_figure(ledger: Ledger) -> Figure:
    """Draw parameters in sd of the inferred posterior, and stresses over the inferred median."""
    rows = max(len(ledger.parameters), len(ledger.stresses))
    with print_style():
        figure = blank_figure(PAGE_MM, ROW_MM * rows + 20.0)
        left, right = figure.subplots(1, 2, width_ratios=(0.46, 0.54))
        _draw_parameters(left, ledger)
        _draw_stresses(right, ledger.stresses)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3, columnspacing=2.5)
    return figure


def _draw_parameters(ax: Axes, ledger: Ledger) -> None:
    """Shifts in standard deviations of the inferred posterior."""
    shifts = np.array([_shifts(row) for row in ledger.parameters.to_dict("records")])
    labels = [axis_text(ledger.known[str(n)]).symbol for n in ledger.parameters["quantity"]]
    title = "shift (standard deviations of the inferred posterior"
    largest = max(3.0, float(np.nanmax(np.abs(shifts))))
    if largest > LARGEST_LINEAR:
        ax.set_xscale("symlog", linthresh=LINEAR)
        ax.minorticks_off()
        for end in (-LINEAR, LINEAR):
            ax.axvline(end, color="0.4", linewidth=0.6, linestyle=":", zorder=0.5)
        title += f";\nlogarithmic beyond the dotted lines at \u00b1{LINEAR:g}"
    _draw_rows(ax, shifts, labels)
    limit = largest * (1.6 if largest > LARGEST_LINEAR else 1.1)
    ax.set(xlim=(-limit, limit), xlabel=f"{title})")


def _shifts(row: dict[Any, Any]) -> list[list[float]]:
    """Quantiles of each treatment, in standard deviations from the inferred median."""
    transform = np.log if str(row["scale"]).startswith("ln ") else float
    sd = row["inferred_sd"] if row["inferred_sd"] > 0.0 else np.nan
    # (q - median inferred) / sd inferred, on the scale of the comparison
    return [
        [(transform(row[f"{name}_{q}"]) - transform(row["inferred_median"])) / sd for q in LEVELS]
        for name in VARIANTS
    ]


def _draw_stresses(ax: Axes, table: pd.DataFrame) -> None:
    """Stresses relative to the inferred median, in per cent: 100 (s / median inferred - 1)."""
    labels, values = [], []
    for row in table.to_dict("records"):
        centre = row["inferred_median"]
        values.append(
            [[100.0 * (row[f"{n}_{q}"] / centre - 1.0) for q in LEVELS] for n in VARIANTS]
        )
        name = quantity(f"{row['quantity']} at {row['total_stretch']:.4g}").symbol
        labels.append(f"{name}\n({number(centre, row['inferred_q05'], row['inferred_q95'])} kPa)")
    _draw_rows(ax, np.array(values), labels)
    ax.set_xlabel("stress relative to the inferred median (%)")


def _draw_rows(ax: Axes, values: np.ndarray, labels: Sequence[str]) -> None:
    """Draw intervals and medians, shape (rows, treatments, 3), in rows."""
    rows = np.arange(len(labels))
    for k, (label, marker, offset) in enumerate(zip(LABELS, MARKERS, OFFSETS, strict=True)):
        low, median, high = values[:, k].T
        hue, y = colour(RUNS[k]), rows + offset
        ax.hlines(y, low, high, color=hue, linewidth=1.4)
        ax.plot(median, y, marker, color=hue, markersize=3.2, label=label)
    ax.axvline(0.0, color="0.6", linewidth=0.6, zorder=0)
    for i in rows[1::2]:
        ax.axhspan(i - 0.5, i + 0.5, color="0.95", linewidth=0.0, zorder=-1)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_yticks(rows, labels, linespacing=1.0)
    ax.tick_params(axis="y", length=0.0)
    ax.spines["left"].set_visible(False)
