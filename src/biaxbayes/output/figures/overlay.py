"""Several posteriors over one another, pair by pair, up to the physical edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.findings.bands import evenly_chosen
from biaxbayes.findings.bounded_density import Span, curve, levels, span, surface
from biaxbayes.output.figures.compare import ROLES
from biaxbayes.output.figures.corner_layout import Grid
from biaxbayes.output.figures.quantities import Quantity, corner_columns
from biaxbayes.output.style import PAGE_MM, colour, font_points, plain, print_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["overlay_figure"]

VISIBLE = 20_000
WIDE_SPREAD = 8.0
FILL = 0.3
MOST_RUNS = len(ROLES)


class _Column(NamedTuple):
    """A quantity: its axis, and run by run its draws and the axis that fits them."""

    quantity: Quantity
    axis: Span
    draws: list[np.ndarray | None]
    own: list[Span | None]


def overlay_figure(
    runs: Sequence[pd.DataFrame],
    labels: Sequence[str],
    *,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Pairwise and marginal posteriors of several runs.

    The filled region holds 50 %, the outline 90 % of a run's draws. Each run is smoothed on the
    range of its own draws, so that a narrow one stays narrow beside a wide one.

    Parameters
    ----------
    runs : sequence of DataFrame
        At most six.
    labels : sequence of str
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.output.style.read_style`.

    Raises
    ------
    InputError
        If there are more than six runs, or nothing varies.
    """
    if len(runs) > MOST_RUNS:
        raise InputError(f"an overlay of {len(runs)} runs cannot be read; give six or fewer")
    columns = _columns(runs)
    if not columns:
        raise InputError("no parameter of these runs varies, so there is nothing to draw")
    with print_style(style):
        symbols = [(c.quantity.symbol, c.quantity.unit) for c in columns]
        grid = Grid([c.axis for c in columns], symbols, width_mm)
        for i, column in enumerate(columns):
            _marginal(grid.axes[i][i], column)
            for j in range(i):
                _joint(grid.axes[i][j], columns[j], column)
        grid.finish()
        _legend(grid, labels)
    return grid.figure


def _columns(runs: Sequence[pd.DataFrame]) -> list[_Column]:
    picked = [corner_columns(run.iloc[evenly_chosen(len(run), VISIBLE)]) for run in runs]
    # In the order of the first run that has a quantity.
    names = list(dict.fromkeys(name for columns in picked for name in columns))
    out = []
    for name in names:
        found = [columns.get(name) for columns in picked]
        q = next(f[0] for f in found if f is not None)
        draws = [None if f is None else f[1] for f in found]
        present = [d for d in draws if d is not None]
        low, high = np.quantile(np.concatenate(present), [0.005, 0.995])
        log = bool(q.scale and low > 0.0 and high > WIDE_SPREAD * low)
        axis = span(*present, edges=q.edges, log=log)
        own = [None if d is None else span(d, edges=q.edges, log=axis.log) for d in draws]
        out.append(_Column(q, axis, draws, own))
    return out


def _marginal(ax: Axes, column: _Column) -> None:
    """Each run's density, all of the same height: widths are what is compared."""
    for run, (values, own) in enumerate(zip(column.draws, column.own, strict=True)):
        if values is None or own is None:
            continue
        x, density = curve(values, own)
        hue = colour(ROLES[run])
        height = density / density.max()
        ax.fill_between(x, height, color=hue, alpha=FILL, linewidth=0.0)
        ax.plot(x, height, color=hue, linewidth=0.9)
    ax.set_ylim(0.0, 1.08)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)


def _joint(ax: Axes, across: _Column, up: _Column) -> None:
    for run in range(len(across.draws)):
        first, second = across.draws[run], up.draws[run]
        axes = across.own[run], up.own[run]
        if first is None or second is None or axes[0] is None or axes[1] is None:
            continue
        x, y, density = surface(first, second, (axes[0], axes[1]))
        hue = colour(ROLES[run])
        outer, inner = levels(density, (0.5, 0.9))
        ax.contourf(x, y, density, levels=[inner, np.inf], colors=[hue], alpha=FILL)
        ax.contour(x, y, density, levels=[outer], colors=[hue], linewidths=0.8)


def _legend(grid: Grid, labels: Sequence[str]) -> None:
    from matplotlib.patches import Patch

    handles = []
    for run in range(len(labels)):
        hue = colour(ROLES[run])
        handles.append(Patch(facecolor=(hue, FILL), edgecolor=hue, linewidth=0.9))
    grid.figure.legend(
        handles,
        [plain(label, 24) for label in labels],
        loc="upper right",
        title="filled 50 %, outline 90 % of the draws",
        fontsize=font_points("legend.fontsize"),
        alignment="left",
    )
