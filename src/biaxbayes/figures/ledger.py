"""What ignoring the mounting stretch costs: three treatments of the same record side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.comparison.mounting_bias import TREATMENTS, Ledger
from biaxbayes.figures.quantities import number
from biaxbayes.figures.style import PAGE_MM, blank_figure, colour, plain, print_style
from biaxbayes.parameters import Quantities, Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROLES = dict(zip(TREATMENTS, ("run", "other", "third"), strict=True))
MARKERS = dict(zip(TREATMENTS, ("o", "s", "^"), strict=True))
OFFSETS = dict(zip(TREATMENTS, (-0.25, 0.0, 0.25), strict=True))
LABELS = dict(
    zip(
        TREATMENTS,
        (
            "mounting stretch inferred, within the law",
            "ignored",
            "ignored, forces zeroed (medians, 90 %)",
        ),
        strict=True,
    )
)
ROW_MM = 8.5
LARGEST_LINEAR, LINEAR = 15.0, 2.0
"""Up to the first shift the axis is linear; beyond, it is logarithmic outside the second."""


def ledger_figure(
    ledger: Ledger, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians and 90 % intervals of the three treatments.

    Left the parameters, in standard deviations of the inferred posterior; right the stresses,
    relative to the inferred median.

    Parameters
    ----------
    ledger : Ledger
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    rows = max(len(ledger.parameters), len(ledger.stresses))
    with print_style(style):
        figure = blank_figure(width_mm, ROW_MM * rows + 20.0)
        left, right = figure.subplots(1, 2, width_ratios=(0.46, 0.54))
        _draw_parameters(left, ledger.parameters, ledger.known)
        _draw_stresses(right, ledger.stresses)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3, columnspacing=2.5)
    return figure


def _draw_parameters(ax: Axes, table: Any, known: Quantities) -> None:
    """Shifts in standard deviations of the inferred posterior."""
    largest = 3.0
    for i, (_, row) in enumerate(table.iterrows()):
        for name in TREATMENTS:
            shifts = [_shift(row, name, level) for level in ("q05", "median", "q95")]
            largest = max(largest, *(abs(s) for s in shifts if np.isfinite(s)))
            _draw_interval(ax, shifts, i, name, label=LABELS[name] if i == 0 else None)
    title = "shift (standard deviations of the inferred posterior"
    if largest > LARGEST_LINEAR:
        _set_symlog(ax, 1.6 * largest)
        title += f";\nlogarithmic beyond the dotted lines at \u00b1{LINEAR:g}"
    else:
        ax.set_xlim(-1.1 * largest, 1.1 * largest)
    _finish_rows(ax, [_symbol(known[str(name)]) for name in table["quantity"]], f"{title})")


def _symbol(q: Quantity) -> str:
    """Symbol of a quantity; the protocol of its own mounted state on a second line."""
    symbol = f"${q.parameter.symbol}$"
    return f"{symbol}\n{plain(q.state, 8)}" if q.state else symbol


def _shift(row: Any, name: str, level: str) -> float:
    """A quantile of a treatment, in standard deviations from the inferred median."""
    transform = np.log if str(row["scale"]).startswith("ln ") else float
    # (q - median inferred) / sd inferred, on the scale of the comparison
    difference = transform(row[f"{name}_{level}"]) - transform(row["inferred_median"])
    return float(difference / row["inferred_sd"]) if row["inferred_sd"] > 0.0 else np.nan


def _set_symlog(ax: Axes, limit: float) -> None:
    """Linear up to two standard deviations, logarithmic beyond, as marked by dotted lines."""
    ax.set_xscale("symlog", linthresh=LINEAR)
    positive = [LINEAR, *(10.0**k for k in range(1, 9) if 10.0**k < limit)]
    values = [*(-v for v in reversed(positive)), 0.0, *positive]
    ax.set_xticks(values, [f"{v:g}".replace("-", "\N{MINUS SIGN}") for v in values])
    ax.minorticks_off()
    for end in (-LINEAR, LINEAR):
        ax.axvline(end, color="0.4", linewidth=0.6, linestyle=":", zorder=0.5)
    ax.set_xlim(-limit, limit)


def _draw_stresses(ax: Axes, table: Any) -> None:
    """Stresses relative to the inferred median."""
    labels = []
    for i, (_, row) in enumerate(table.iterrows()):
        centre = row["inferred_median"]
        for name in TREATMENTS:
            # 100 (s / median inferred - 1)
            values = [100.0 * (row[f"{name}_{q}"] / centre - 1.0) for q in ("q05", "median", "q95")]
            _draw_interval(ax, values, i, name)
        axis = str(row["quantity"])[-1]
        value = number(centre, row["inferred_q05"], row["inferred_q95"])
        labels.append(rf"$\sigma_{axis}$ at {row['total_stretch']:.4g}" + f"\n({value} kPa)")
    _finish_rows(ax, labels, "stress relative to the inferred median (%)")


def _draw_interval(
    ax: Axes, values: list[float], row: int, name: str, label: str | None = None
) -> None:
    (low, median, high), y, hue = values, row + OFFSETS[name], colour(ROLES[name])
    ax.plot([low, high], [y, y], color=hue, linewidth=1.4, solid_capstyle="butt")
    ax.plot(median, y, MARKERS[name], color=hue, markersize=3.2, label=label)


def _finish_rows(ax: Axes, labels: list[str], title: str) -> None:
    ax.axvline(0.0, color="0.6", linewidth=0.6, zorder=0)
    for i in range(1, len(labels), 2):
        ax.axhspan(i - 0.5, i + 0.5, color="0.95", linewidth=0.0, zorder=-1)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_yticks(range(len(labels)), labels, linespacing=1.0)
    ax.tick_params(axis="y", length=0.0)
    ax.spines["left"].set_visible(False)
    ax.set_xlabel(title)
