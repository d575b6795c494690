"""The joint posterior at a glance: every pair of quantities, every quantity alone, of several runs.

The corner package draws the panels. Ours is what it leaves open: ranges that end at physical edges
(SciPy's filter reflects there, so no mass leaks over an edge), a width of smoothing for each pair
and run, wider where few draws lie, the table in the free corner and the size in print.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.integrate import trapezoid

from biaxbayes.errors import InputError
from biaxbayes.figures.labels import few_ticks, repeat_ticks
from biaxbayes.figures.quantities import AxisText, corner_columns
from biaxbayes.figures.run.free_corner import NARROW_MM, Column, Found, tabulate
from biaxbayes.figures.run.regions import CELLS_1D, FILL, Moved, cells, moved, regions
from biaxbayes.figures.style import (
    MM,
    PAGE_MM,
    RUNS,
    blank_figure,
    colour,
    keep_labels,
    plain,
    print_style,
)
from biaxbayes.identifiability.bounded_density import (
    Span,
    at_edges,
    curve,
    interval,
    span,
)
from biaxbayes.options import CONTENT
from biaxbayes.parameters import Quantities
from biaxbayes.prediction.bands import evenly_chosen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["axis_span", "corner_figure", "overlay_figure"]

VISIBLE = 40_000
"""Draws of a quantity that are looked at; more would change nothing to the eye."""
WIDE_SPREAD = 8.0
"""Ratio of the 99.5 % to the 0.5 % point from which a scale gets a logarithmic axis."""
PANEL_MM, LEAST_PANEL_MM = 46.0, 8.0
"""Largest panel, for few quantities, and the smallest that can be read."""
GAP = 0.09
"""Space between panels, as a share of a panel."""
DASHES = (0, (3, 2))


def corner_figure(
    draws: pd.DataFrame,
    *,
    truth: Mapping[str, float] | None = None,
    compare: pd.DataFrame | None = None,
    names: tuple[str, str] = ("this run", "compared"),
    parameters: Sequence[str] | None = None,
    probability: float = CONTENT,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
    known: Quantities | None = None,
) -> Figure:
    """Pairwise and marginal posterior of the material parameters and mounting stretches.

    Parameters
    ----------
    draws : DataFrame
        One row a draw, columns as in ``summary.csv``. Constant columns are left out.
    truth : mapping, optional
        Known values by the same names, drawn as dashed lines.
    compare : DataFrame, optional
        Draws of another run, drawn as outlines.
    names : (str, str)
        Of the run and of the compared one, for the legend.
    parameters : sequence of str, optional
        The quantities to draw; all by default.
    probability : float
        Content of the shaded interval of each quantity: central, or one-sided where the draws
        pile up at a physical edge.
    width_mm : float
        Width in print.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    known : Quantities, optional
        What each name is, where it is not the default law with one mounted state.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If nothing varies, a parameter is not there, or the panels do not fit the width.
    """
    runs = [draws] if compare is None else [draws, compare]
    truth = {k: float(v) for k, v in (truth or {}).items() if np.isfinite(v)}
    fixed = [
        {str(n): float(run[n].iloc[0]) for n in run.select_dtypes("number") if not np.ptp(run[n])}
        for run in runs
    ]
    columns = _columns(runs, parameters, seen=[truth, *fixed], shared=True, known=known)
    # What the run itself does not vary is no quantity of its figure.
    columns = [c for c in columns if c.draws[0] is not None]
    if not columns:
        raise InputError("no parameter of this run varies, so there is nothing to draw")
    with print_style(style):
        figure, grid = _grid(len(columns), width_mm)
        for run in range(len(runs)):
            _draw(grid, columns, run, filled=run == 0)
        rows = [
            _marginal(grid[i, i], column, fixed, probability) for i, column in enumerate(columns)
        ]
        true_values = [truth.get(c.name) for c in columns]
        for i, value in enumerate(true_values):
            if value is None:
                continue
            for ax in grid[i:, i]:
                ax.axvline(value, color="black", linewidth=0.7, linestyle=DASHES)
            for ax in grid[i, :i]:
                ax.axhline(value, color="black", linewidth=0.7, linestyle=DASHES)
        _arrange(figure, grid, columns, width_mm)
        legend = names if compare is not None else None
        tabulate(figure, columns, rows, true_values, legend, probability, width_mm)
    return figure


def overlay_figure(
    runs: Sequence[pd.DataFrame],
    labels: Sequence[str],
    *,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
    known: Quantities | None = None,
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
        From :func:`biaxbayes.figures.style.read_style`.
    known : Quantities, optional
        What each name is, where it is not the default law with one mounted state.

    Raises
    ------
    InputError
        If there are more than six runs, nothing varies, or the panels do not fit the width.
    """
    if len(runs) > len(RUNS):
        raise InputError(f"an overlay of {len(runs)} runs cannot be read; give six or fewer")
    columns = _columns(runs, known=known)
    if not columns:
        raise InputError("no parameter of these runs varies, so there is nothing to draw")
    with print_style(style):
        figure, grid = _grid(len(columns), width_mm)
        for run in range(len(runs)):
            _draw(grid, columns, run, filled=None)
        for i in range(len(columns)):
            # All of the same height: widths are what is compared.
            for line in grid[i, i].lines:
                height = line.get_ydata() / np.max(line.get_ydata())
                line.set_ydata(height)
                grid[i, i].fill_between(
                    line.get_xdata(), height, color=line.get_color(), alpha=FILL, linewidth=0.0
                )
            grid[i, i].set_ylim(0.0, 1.08)
        _arrange(figure, grid, columns, width_mm)
        _legend(figure, labels)
    return figure


# --- draws into panels, by corner ----------------------------------------------------------------


class _Panel(NamedTuple):
    """One panel: what corner asks of a figure of one quantity."""

    axes: list[Axes]

    def subplots_adjust(self, **places: float) -> None:
        """Leave the panel where it is."""


def _columns(
    runs: Sequence[pd.DataFrame],
    parameters: Sequence[str] | None = None,
    *,
    seen: Sequence[Mapping[str, float]] = (),
    shared: bool = False,
    known: Quantities | None = None,
) -> list[Column]:
    """The quantities in the order of the first run that has them, with the values to be seen."""
    picked = [corner_columns(run, known) for run in runs]
    drawn = [evenly_chosen(len(run), VISIBLE) for run in runs]
    names = list(dict.fromkeys(name for columns in picked for name in columns))
    for name in parameters or ():
        if name not in names:
            raise InputError(
                f"no quantity {name[:40]!r} varies in this run",
                remedy=f"choose from {', '.join(names)}",
            )
    out = []
    for name in names if parameters is None else [n for n in names if n in parameters]:
        q = next(columns[name][0] for columns in picked if name in columns)
        every = [columns[name][1] if name in columns else None for columns in picked]
        draws = [None if v is None else v[at] for v, at in zip(every, drawn, strict=True)]
        present = [d for d in draws if d is not None]
        include = tuple(values[name] for values in seen if name in values)
        axis = axis_span(q, *present, include=include)
        own = [None if d is None else span(d, edges=q.edges, log=axis.log) for d in draws]
        out.append(Column(name, q, axis, draws, every, own))
    return out


def axis_span(q: AxisText, *draws: np.ndarray, include: tuple[float, ...] = ()) -> Span:
    """Axis of a quantity: logarithmic where a scale spreads widely.

    Parameters
    ----------
    q : AxisText
    *draws : ndarray, shape (n,)
        Of one or more runs.
    include : tuple of float
        Values that must be visible.
    """
    low, high = np.quantile(np.concatenate(draws), [0.005, 0.995])
    log = bool(q.scale and low > 0.0 and high > WIDE_SPREAD * low)
    return span(*draws, edges=q.edges, log=log, include=include)


def _draw(grid: np.ndarray, columns: list[Column], run: int, *, filled: bool | None) -> None:
    """One run into the panels of the quantities that it has.

    Panel by panel: corner has one width of smoothing for all pairs, and a ridge wants a narrow one.
    """
    import corner  # takes a second or two: it imports ArviZ

    hue = colour(RUNS[run])
    paired: list[Moved | None] = []
    for i, up in enumerate(columns):
        paired.append(None)
        draws, axis = up.draws[run], up.own[run]
        if draws is None or axis is None:
            continue
        corner.corner(
            draws[:, None],
            fig=_Panel([grid[i, i]]),
            range=[(axis.low, axis.high)],
            axes_scale=["log" if axis.log else "linear"],
            bins=cells([moved(draws, axis, VISIBLE)]),
            weights=np.ones(len(draws)),  # counts without weights are smoothed as integers
            smooth1d=CELLS_1D,
            hist_kwargs={"color": hue, "linewidth": 0.9},
            max_n_ticks=0,
        )
        paired[i] = own = moved(draws, axis)
        for j, across in enumerate(paired[:i]):
            if across is not None:
                regions(grid[i, j], (across, own), hue, filled=filled)


def _marginal(
    ax: Axes, column: Column, fixed: Sequence[Mapping[str, float]], probability: float
) -> list[Found | None]:
    """Make corner's curves densities, shade the interval; median and interval of each run."""
    out: list[Found | None] = []
    lines = iter(list(ax.lines))
    top = 0.0
    for run, values in enumerate(column.draws):
        if values is None:
            at = fixed[run].get(column.name)
            if at is not None:
                ax.axvline(at, color=colour(RUNS[run]), linewidth=0.9)
            out.append(None if at is None else Found(at, at, at, (False, False)))
            continue
        axis = column.own[run]
        assert axis is not None
        piled = at_edges(curve(values, axis)[1], axis)
        every = column.every[run]
        assert every is not None
        low, high = interval(every, piled, probability)
        line = next(lines)
        x, height = np.array(line.get_xdata()), np.array(line.get_ydata(), dtype=float)
        height /= trapezoid(height, column.axis.forward(x))
        line.set_ydata(height)
        if run == 0:
            inside = list((x >= low) & (x <= high))
            ax.fill_between(
                x, height, where=inside, color=line.get_color(), alpha=0.3, linewidth=0.0
            )
        top = max(top, float(height.max()))
        out.append(Found(float(np.median(every)), low, high, piled))
    ax.set_ylim(0.0, 1.08 * top)
    return out


# --- places and labels ---------------------------------------------------------------------------


def _grid(count: int, width_mm: float) -> tuple[Figure, np.ndarray]:
    """Empty panels of a lower triangle."""
    figure = blank_figure(width_mm * MM, width_mm * MM)
    places = figure.add_gridspec(count, count)
    grid = np.full((count, count), None, dtype=object)
    for i, j in np.argwhere(np.tri(count)).tolist():
        grid[i, j] = figure.add_subplot(places[i, j])
    return figure, grid


def _arrange(figure: Figure, grid: np.ndarray, columns: list[Column], width_mm: float) -> None:
    """Set ranges, ticks and labels, and make the panels square between their labels."""
    last, narrow = len(columns) - 1, width_mm < NARROW_MM
    labels = [
        c.quantity.label.replace(" (", "\n(") if narrow else c.quantity.label for c in columns
    ]
    for i, j in np.argwhere(np.tri(last + 1)).tolist():
        ax = grid[i, j]
        _show(ax, columns[j].axis, "x", ticks=i == last)
        if i == last:
            ax.set_xlabel(labels[j], labelpad=2.0)
        if i == j:
            ax.set_yticks([])
            ax.spines["left"].set_visible(False)
            continue
        _show(ax, columns[i].axis, "y", ticks=j == 0)
        if j == 0:
            ax.set_ylabel(labels[i], linespacing=1.1, labelpad=2.0)
    side = _square(figure, grid, width_mm)
    if any(len(ax.get_xticks()) < 2 for ax in grid[last]):
        for ax in grid[last]:
            few_ticks(ax.xaxis, overhang=0.3, upright=True)
        side = _square(figure, grid, width_mm)
    if side < LEAST_PANEL_MM:
        raise InputError(
            f"{last + 1} quantities do not fit a width of {width_mm:g} mm",
            remedy="name fewer with --parameter, or ask for --width-mm 180",
        )
    for i, j in np.argwhere(np.tri(last + 1)).tolist():
        if i < last:
            repeat_ticks(grid[i, j].xaxis, grid[last, j].xaxis)
        if 0 < j < i:
            repeat_ticks(grid[i, j].yaxis, grid[i, 0].yaxis)
    keep_labels(figure, [ax.xaxis for ax in grid[-1]], [ax.yaxis for ax in grid[:, 0]])


def _square(figure: Figure, grid: np.ndarray, width_mm: float) -> float:
    """Square panels in the space that the labels leave, and the height to it; their side in mm.

    Constrained layout finds the same places, but takes longer than all the drawing.
    """
    count, margin = len(grid), 1.0
    for _ in range(2):  # labels depend on the panels' size, and this on the labels
        left = _beside(list(grid[1:, 0] if count > 1 else grid[:, 0]), "y") + margin
        bottom = _beside(list(grid[-1]), "x") + margin
        panels = count + GAP * (count - 1)
        side = min((width_mm - left - 2.0 * margin) / panels, PANEL_MM)
        height = bottom + side * panels + 2.0 * margin
        figure.set_figheight(height * MM)
        figure.subplots_adjust(
            left=left / width_mm,
            right=(left + side * panels) / width_mm,
            bottom=bottom / height,
            top=1.0 - 2.0 * margin / height,
            wspace=GAP,
            hspace=GAP,
        )
    return float(side)


def _beside(panels: Sequence[Axes], which: str) -> float:
    """How far the aligned labels of an axis stand out from panels, mm."""
    far, size = [], []
    for ax in panels:
        axis = getattr(ax, f"{which}axis")
        # a panel alone has nothing at its left but the labels below it
        box = ax.get_tightbbox() if len(panels) == 1 else axis.get_tightbbox()
        label = axis.label.get_window_extent()
        assert box is not None
        across = which == "y"
        size.append(label.width if across else label.height)
        far.append((ax.bbox.x0 - box.x0 if across else ax.bbox.y0 - box.y0) - size[-1])
    return float(max(far) + max(size)) / panels[0].figure.dpi / MM


def _show(ax: Axes, shown: Span, which: str, *, ticks: bool) -> None:
    """Range of an axis, with ticks or without."""
    if shown.log:
        ax.set(**{f"{which}scale": "log"})
    ax.set(**{f"{which}lim": (shown.low, shown.high)})
    few_ticks(getattr(ax, f"{which}axis"), most=3 if ticks else 0, overhang=0.3)


def _legend(figure: Figure, labels: Sequence[str]) -> None:
    from matplotlib.patches import Patch

    hues = [colour(RUNS[run]) for run in range(len(labels))]
    figure.legend(
        [Patch(facecolor=(hue, FILL), edgecolor=hue, linewidth=0.9) for hue in hues],
        [plain(label, 24) for label in labels],
        loc="upper right",
        title="filled 50 %, outline 90 % of the draws, within the law",
        alignment="left",
    )
