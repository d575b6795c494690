"""What ignoring the mounting stretch costs, at a glance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.findings.ledger import TREATMENTS, Ledger
from biaxbayes.output.figures.numbers import number
from biaxbayes.output.figures.quantities import quantity
from biaxbayes.output.style import MM, PAGE_MM, colour, plain, print_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["ledger_figure"]

ROLES = dict(zip(TREATMENTS, ("run", "other", "third"), strict=True))
MARKERS = dict(zip(TREATMENTS, ("o", "s", "^"), strict=True))
ROW_MM, HEAD_MM, FOOT_MM = 8.5, 9.0, 11.0
OFFSETS = (0.25, 0.0, -0.25)
LARGEST_LINEAR, LINEAR = 15.0, 2.0
"""Up to the first shift the axis is linear; else up to the second, and logarithmic beyond."""
LABELS = ("mounting stretch inferred", "ignored", "ignored, forces zeroed (medians, 90 %)")


def ledger_figure(
    found: Ledger, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians and 90 % intervals of the three treatments.

    Left the parameters, in standard deviations of the inferred posterior; right the stresses,
    relative to the inferred median.

    Parameters
    ----------
    found : Ledger
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.output.style.read_style`.
    """
    from matplotlib.figure import Figure

    parameters, stresses = found.parameters, found.stresses
    rows = max(len(parameters), len(stresses))
    height = HEAD_MM + FOOT_MM + ROW_MM * rows
    with print_style(style):
        figure = Figure((width_mm * MM, height * MM))
        panels = []
        for x, width, table in ((0.075, 0.39, parameters), (0.60, 0.385, stresses)):
            share = ROW_MM * len(table) / height
            panels.append(figure.add_axes((x, 1.0 - HEAD_MM / height - share, width, share)))
        left, right = panels
        _parameters(left, parameters)
        _stresses(right, stresses)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(
            handles,
            labels,
            loc="upper center",
            ncols=3,
            bbox_to_anchor=(0.5, 1.0),
            columnspacing=2.5,
        )
    return figure


def _parameters(ax: Axes, table: Any) -> None:
    largest = 3.0
    for i, (_, row) in enumerate(table.iterrows()):
        for name, offset in zip(TREATMENTS, OFFSETS, strict=True):
            shifts = [_shift(row, name, level) for level in ("q05", "median", "q95")]
            largest = max(largest, *(abs(s) for s in shifts if np.isfinite(s)))
            _draw(ax, shifts, i - offset, name, first=i == 0)
    _scale(ax, (1.6 if largest > LARGEST_LINEAR else 1.1) * largest)
    labels = [_symbol(str(name)) for name in table["quantity"]]
    _finish(ax, labels, "shift (standard deviations of the inferred posterior)")


def _symbol(name: str) -> str:
    """Symbol of a quantity; the protocol of its own mounted state on a second line."""
    stem, _, protocol = name.partition("[")
    symbol = quantity(stem).symbol
    return f"{symbol}\n{plain(protocol.removesuffix(']'), 8)}" if protocol else symbol


def _shift(row: Any, name: str, level: str) -> float:
    """A quantile of a treatment, in standard deviations from the inferred median."""
    move = np.log if str(row["scale"]).startswith("ln ") else float
    # (q - median inferred) / sd inferred, on the scale of the comparison
    moved = move(row[f"{name}_{level}"]) - move(row["inferred_median"])
    return float(moved / row["inferred_sd"]) if row["inferred_sd"] > 0.0 else np.nan


def _scale(ax: Axes, limit: float) -> None:
    """To scale where that can be read, else in logs beyond two standard deviations."""
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

    if limit > LARGEST_LINEAR:
        ax.set_xscale("symlog", linthresh=LINEAR, linscale=1.0)
        positive = [LINEAR, *(10.0**k for k in range(1, 9) if 10.0**k < limit)]
        values = [-v for v in reversed(positive)] + [0.0, *positive]
        texts = [f"{v:g}".replace("-", "\N{MINUS SIGN}") for v in values]
        ax.xaxis.set_major_locator(FixedLocator(values))
        ax.xaxis.set_major_formatter(FixedFormatter(texts))
        ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xlim(-limit, limit)


def _stresses(ax: Axes, table: Any) -> None:
    labels = []
    for i, (_, row) in enumerate(table.iterrows()):
        centre = row["inferred_median"]
        for name, offset in zip(TREATMENTS, OFFSETS, strict=True):
            # 100 (s / median inferred - 1)
            values = [100.0 * (row[f"{name}_{q}"] / centre - 1.0) for q in ("q05", "median", "q95")]
            _draw(ax, values, i - offset, name, first=False)
        axis = str(row["quantity"])[-1]
        value = number(centre, row["inferred_q05"], row["inferred_q95"])
        labels.append(rf"$\sigma_{axis}$ at {row['total_stretch']:.4g}" + f"\n({value} kPa)")
    _finish(ax, labels, "stress relative to the inferred median (%)")


def _draw(ax: Axes, values: list[float], y: float, name: str, *, first: bool) -> None:
    hue = colour(ROLES[name])
    low, median, high = values
    ax.plot([low, high], [y, y], color=hue, linewidth=1.4, solid_capstyle="butt")
    label = LABELS[TREATMENTS.index(name)] if first else None
    ax.plot(median, y, MARKERS[name], color=hue, markersize=3.2, label=label)


def _finish(ax: Axes, labels: list[str], title: str) -> None:
    ax.axvline(0.0, color="0.6", linewidth=0.6, zorder=0)
    for i in range(len(labels)):
        if i % 2:
            ax.axhspan(i - 0.5, i + 0.5, color="0.95", linewidth=0.0, zorder=-1)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_yticks(range(len(labels)), labels, linespacing=1.0)
    ax.tick_params(axis="y", length=0.0)
    ax.spines["left"].set_visible(False)
    ax.set_xlabel(title)
