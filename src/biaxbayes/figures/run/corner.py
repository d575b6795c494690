"""The joint posterior at a glance: every pair of quantities, every quantity alone, of several runs.

The corner package draws the panels. Ours is what it leaves open: ranges that end at physical edges
(SciPy's filter reflects there, so no mass leaks over an edge), a width of smoothing for each pair
and run, wider where few draws lie, the table in the free corner and the size in print.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.integrate import trapezoid
from scipy.ndimage import gaussian_filter

from biaxbayes.errors import InputError
from biaxbayes.figures.labels import few_ticks, number, range_text, shortened
from biaxbayes.figures.quantities import MEAN, AxisText, corner_columns
from biaxbayes.figures.run.free_corner import Heading, write_table
from biaxbayes.figures.style import (
    MM,
    PAGE_MM,
    RUNS,
    blank_figure,
    colour,
    font_points,
    plain,
    print_style,
)
from biaxbayes.identifiability.bounded_density import (
    Span,
    at_edges,
    curve,
    interval,
    robust_sd,
    span,
)
from biaxbayes.options import CONTENT
from biaxbayes.parameters import Quantities, mounting_names
from biaxbayes.prediction.bands import evenly_chosen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["CONTENTS", "axis_span", "corner_figure", "overlay_figure", "regions"]

CONTENTS = (0.5, 0.9, 0.99)
"""Shares of the draws that the regions hold."""
SHADES = (0.18, 0.42, 0.78)
"""Their darkness, the widest first."""
FILL = 0.3
"""Opacity of the region of 50 % and of the marginal in an overlay."""
VISIBLE, VISIBLE_PAIR = 40_000, 20_000
"""Draws of a quantity and of a pair that are looked at; more would change nothing to the eye."""
WIDE_SPREAD = 8.0
"""Ratio of the 99.5 % to the 0.5 % point from which a scale gets a logarithmic axis."""
PANEL_MM, LEAST_PANEL_MM = 46.0, 8.0
"""Largest panel, for few quantities, and the smallest that can be read."""
GAP = 0.09
"""Space between panels, as a share of a panel."""
NARROW_MM = 120.0
"""Below this width symbol and unit stand one above the other."""
CELLS, CELLS_1D = 1.5, 3.0
"""Width (sd) of the smoothing kernel in cells of the histograms."""
WIDER = 1.25
"""Width of the kernel of a pair, relative to Scott's."""
WIDEST = 1.5
"""Times that the kernel of a pair is doubled at most, for draws beyond the region of 90 %."""
DASHES = (0, (3, 2))
MOST_NAME_MM = 32.0
"""Width of the name of a run in the table."""


class Column(NamedTuple):
    """One quantity of the figure: its axis, and run by run its draws (None: not varied).

    Those that are drawn, and all, which the table in the corner tells the numbers of.
    """

    name: str
    quantity: AxisText
    axis: Span
    draws: list[np.ndarray | None]
    every: list[np.ndarray | None]
    own: list[Span | None]


class Found(NamedTuple):
    """Median and interval of one quantity in one run."""

    median: float
    low: float
    high: float
    piled: tuple[bool, bool]

    def cells(self, *, log: bool) -> list[str]:
        """As two cells of the table."""
        if self.low == self.high:
            return [f"{self.median:.4g}", "fixed"]
        median = number(self.median, self.low, self.high, log=log)
        return [median, range_text(self.low, self.high, self.piled, log=log)]


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
        _tabulate(figure, columns, rows, true_values, legend, probability, width_mm)
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


def regions(
    ax: Axes,
    draws: Sequence[np.ndarray],
    axes: Sequence[Span],
    hue: str,
    *,
    filled: bool | None,
) -> None:
    """Draw a joint posterior as regions of stated content.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    draws : two ndarrays, shape (n,)
    axes : two Spans
        Ranges that the draws are smoothed on.
    hue : str
    filled : bool or None
        Three shaded regions, or the outline of the one that holds 90 %, or None: the region of
        50 % in that outline.
    """
    chosen = evenly_chosen(len(draws[0]), VISIBLE_PAIR)
    draws = [d[chosen] for d in draws]
    bins = _bins(draws, axes)
    centres = [a.back((np.arange(n) + 0.5) / n) for a, n in zip(axes, bins, strict=True)]
    density, at_draws = _smooth(draws, axes, bins)
    look = _look(hue, filled)
    # corner counts the mass of the density; smoothing has spread that of the draws
    edges = np.quantile(at_draws, 1.0 - np.array(look["levels"]))
    look["levels"] = [density[density >= edge].sum() / density.sum() for edge in edges]
    _corner().hist2d(
        *(c.ravel() for c in np.meshgrid(*centres, indexing="ij")),
        weights=density.ravel(),
        ax=ax,
        range=[(a.low, a.high) for a in axes],
        axes_scale=["log" if a.log else "linear" for a in axes],
        bins=bins,
        **look,
    )


def _smooth(
    draws: Sequence[np.ndarray], axes: Sequence[Span], bins: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Draws of a pair counted in cells and smoothed, the wider the fewer lie about a draw.

    The density in the cells, and at the draws. Width of the kernel (Abramson 1982):
    h (f90 / f)^(1/2) where the density f is below that at the edge of the region of 90 %. One
    width for all leaves islands of single draws.
    """
    at = [a.forward(d) * n for a, d, n in zip(axes, draws, bins, strict=True)]
    seen = np.all([(u >= 0.0) & (u <= n) for u, n in zip(at, bins, strict=True)], axis=0)
    cell = [np.minimum(u[seen].astype(int), n - 1) for u, n in zip(at, bins, strict=True)]
    counts = np.bincount(np.ravel_multi_index(cell, bins), minlength=bins[0] * bins[1])
    counts = counts.reshape(bins).astype(float)
    pilot = gaussian_filter(counts, CELLS)
    edge = np.quantile(pilot[tuple(cell)], 1.0 - CONTENTS[1])
    # log2 of the width; between two powers of two a cell's draws are shared by both kernels
    wider = np.clip(0.5 * np.log2(edge / np.maximum(pilot, 1e-300)), 0.0, WIDEST)
    density = np.zeros_like(counts)
    for k in range(math.ceil(WIDEST) + 1):
        share = counts * np.maximum(1.0 - np.abs(wider - k), 0.0)
        density += gaussian_filter(share, CELLS * 2.0**k)
    return density, density[tuple(cell)]


# --- draws into panels, by corner ----------------------------------------------------------------


class _Panel(NamedTuple):
    """One panel: what corner asks of a figure of one quantity."""

    axes: list[Axes]

    def subplots_adjust(self, **places: float) -> None:
        """Leave the panel where it is."""


@cache
def _corner() -> Any:
    """The corner package, without its way into ArviZ: no figure takes it, the import takes seconds.

    Who imports corner after this gets it whole.
    """
    if "corner" in sys.modules or "arviz" in sys.modules:
        return import_module("corner")
    sys.modules["arviz"] = None  # type: ignore[assignment]
    try:
        found = import_module("corner")
    finally:
        del sys.modules["arviz"]
        for name in [n for n in sys.modules if n.split(".")[0] == "corner"]:
            del sys.modules[name]
    return found


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
    hue = colour(RUNS[run])
    for i, up in enumerate(columns):
        draws, axis = up.draws[run], up.own[run]
        if draws is None or axis is None:
            continue
        _corner().corner(
            draws[:, None],
            fig=_Panel([grid[i, i]]),
            range=[(axis.low, axis.high)],
            axes_scale=["log" if axis.log else "linear"],
            bins=_bins([draws], [axis]),
            weights=np.ones(len(draws)),  # counts without weights are smoothed as integers
            smooth1d=CELLS_1D,
            hist_kwargs={"color": hue, "linewidth": 0.9},
            max_n_ticks=0,
        )
        for j, across in enumerate(columns[:i]):
            first, other = across.draws[run], across.own[run]
            if first is not None and other is not None:
                regions(grid[i, j], (first, draws), (other, axis), hue, filled=filled)


def _look(hue: str, filled: bool | None) -> dict[str, Any]:
    """Colours and levels of :func:`corner.hist2d`."""
    from matplotlib.colors import to_rgb

    look: dict[str, Any] = {"color": hue, "plot_datapoints": False, "plot_density": False}
    look |= {"quiet": True, "no_fill_contours": True, "fill_contours": filled is not False}
    if filled is False:
        return look | {"levels": (0.9,), "contour_kwargs": {"linewidths": 0.9}}
    if filled is None:
        fills: dict[str, Any] = {"colors": ["none", "none", (*to_rgb(hue), FILL)]}
        edges: dict[str, Any] = {"linewidths": [0.8, 0.0]}
        return look | {"levels": CONTENTS[:2], "contourf_kwargs": fills, "contour_kwargs": edges}
    # Shades are mixed with white, not made transparent: panels stay small in a vector file.
    shades = [tuple(1.0 - s * (1.0 - np.array(to_rgb(hue)))) for s in SHADES]
    fills = {"colors": ["none", *shades], "antialiased": True}
    edges = {"colors": shades, "linewidths": 0.3}
    return look | {"levels": CONTENTS, "contourf_kwargs": fills, "contour_kwargs": edges}


def _bins(values: Sequence[np.ndarray], axes: Sequence[Span]) -> list[int]:
    """Cells of each axis, such that a kernel of so many cells is as wide as it should be.

    Silverman's h = 0.9 sd n^(-1/5) for one quantity, Scott's h = sd n^(-1/6) for a pair, narrower
    on a ridge so that it stays narrow.
    """
    moved = [a.forward(v) for a, v in zip(axes, values, strict=True)]
    sd, n = np.array([max(robust_sd(u), 1e-6) for u in moved]), min(len(moved[0]), 20_000)
    if len(moved) == 1:
        return [int(np.clip(CELLS_1D / h, 60, 1000)) for h in 0.9 * sd * n**-0.2]
    r = np.corrcoef(np.clip(moved, 0.0, 1.0))[0, 1] if n > 2 else 0.0
    # sd of one quantity where the other is known: sd sqrt(1 - r^2); halfway to it, in logs
    ridge = (1.0 - min(abs(np.nan_to_num(r)), 0.999) ** 2) ** 0.25
    return [int(np.clip(CELLS / h, 30, 250)) for h in WIDER * ridge * sd * n ** (-1.0 / 6.0)]


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
        _show(ax, columns[j].axis, "x")
        ax.tick_params(labelbottom=i == last)
        if i == last:
            ax.set_xlabel(labels[j], labelpad=2.0)
        if i == j:
            ax.set_yticks([])
            ax.spines["left"].set_visible(False)
            continue
        _show(ax, columns[i].axis, "y")
        ax.tick_params(labelleft=j == 0)
        if j == 0:
            ax.set_ylabel(labels[i], linespacing=1.1, labelpad=2.0)
    side = _square(figure, grid, width_mm)
    if any(len(ax.get_xticks()) < 2 for ax in grid[last]):
        for i, j in np.argwhere(np.tri(last + 1)).tolist():
            few_ticks(grid[i, j].xaxis, overhang=0.3, upright=True)
        side = _square(figure, grid, width_mm)
    if side < LEAST_PANEL_MM:
        raise InputError(
            f"{last + 1} quantities do not fit a width of {width_mm:g} mm",
            remedy="name fewer with --parameter, or ask for --width-mm 180",
        )
    # those that have labels: each panel of a group asks all others for their boxes
    figure.align_xlabels(list(grid[-1]))
    figure.align_ylabels(list(grid[:, 0]))


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


def _show(ax: Axes, shown: Span, which: str) -> None:
    if shown.log:
        ax.set(**{f"{which}scale": "log"})
    ax.set(**{f"{which}lim": (shown.low, shown.high)})
    few_ticks(getattr(ax, f"{which}axis"), overhang=0.3)


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


# --- the table in the free corner ----------------------------------------------------------------


def _tabulate(
    figure: Figure,
    columns: list[Column],
    rows: list[list[Found | None]],
    truth: list[float | None],
    names: tuple[str, str] | None,
    probability: float,
    width_mm: float,
) -> None:
    """Medians and intervals; the headings are the legend."""
    wide, size = width_mm >= NARROW_MM, font_points("legend.fontsize")
    content = f"{100 * probability:g} %"
    headings = []
    for run in range(len(rows[0])):
        hue = colour(RUNS[run])
        name = "" if names is None else shortened(names[run], MOST_NAME_MM, size)
        head = f"{content} interval" if wide and names is None else content
        headings += [
            Heading("median", 3 * run + 1, hue, name),
            Heading(head, 3 * run, hue, name),
        ]
    known = any(v is not None for v in truth)
    if known:
        headings.append(Heading("truth", 2))
    table = []
    for column, found, value in zip(columns, rows, truth, strict=True):
        q = column.quantity
        cells = [q.label if wide else q.symbol]
        for one in found:
            cells += ["", ""] if one is None else one.cells(log=column.axis.log)
        table.append([*cells, "" if value is None else f"{value:.5g}"][: len(headings) + 1])
    notes = [(f"regions: {', '.join(f'{100 * c:g}' for c in CONTENTS)} % of the draws", "0.3")]
    if any(c.name in mounting_names("stretch") for c in columns):
        notes.append(("all within the law", "0.3"))
    if names is not None:
        other = shortened(names[1], MOST_NAME_MM if wide else 18.0, size)
        notes.append((f"outlines: {other}{', 90 %' if wide else ''}", colour(RUNS[1])))
    if known:
        notes.append(("dashed: truth", "0.3"))
    if any(MEAN in c.quantity.symbol for c in columns):
        notes.append(("bar: mean over protocols" if wide else "bar: mean", "0.3"))
    write_table(figure, headings, table, notes, 1.45 if wide else 1.25)
