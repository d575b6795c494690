"""explore.html: a page to brush the posterior, and to reweight it to other priors.

Bokeh draws it: all panels of the corner have one source of draws, so a selection in one is a
selection in all. A script (``explore.js``) computes percentiles of the selected draws and
importance weights. Every other number on the page is computed here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from bokeh.document import Document
from bokeh.embed import file_html
from bokeh.layouts import gridplot
from bokeh.models import BoxSelectTool, ColumnDataSource, CustomJS, PlainText, Range1d, Title
from bokeh.plotting import figure
from bokeh.resources import INLINE
from markupsafe import Markup

from biaxbayes.errors import InputError
from biaxbayes.figures.bands import abscissa, load_panels, residual_unit, shown_protocols
from biaxbayes.figures.quantities import MEAN, axis_span, corner_columns
from biaxbayes.figures.style import BAND_OPACITY, PAGE_MM, colour, print_style
from biaxbayes.identifiability.bounded_density import Span
from biaxbayes.identifiability.reported import quantile_texts
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import FAMILIES, PRIOR_NUMBERS, Prior, prior_text
from biaxbayes.options import CONTENT
from biaxbayes.parameters import STRETCH, Quantities, Quantity
from biaxbayes.prediction.bands import DrawnCurves, curves_of_draws
from biaxbayes.prediction.percentiles import evenly_chosen, tails
from biaxbayes.reports.templates import page_template
from biaxbayes.reports.text import as_html, tests_in_words, truncate
from biaxbayes.specimens.specimen import Specimen

LEAST_EFFECTIVE = 200
"""Effective draws (Kish) below which another prior is refused."""
MAX_DRAWS = 700
"""Draws on the page."""
MAX_STATES, MAX_STATES_PER_PROTOCOL, LEAST_STATES = 130, 41, 7
"""Largest number of states of all protocols together, and of one; least number of one."""
HISTOGRAM_BINS = 24
PANEL_PX, CURVE_PX = 105, 380
"""Width of a panel of the corner, and of the curves of a protocol, pixels."""
GREY = "#4a525c"
UUID = r"[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}"


def thinned_draws(draws: pd.DataFrame) -> pd.DataFrame:
    """The draws that the page holds, evenly chosen."""
    return draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)].reset_index(drop=True)


def explore_page(posterior: Posterior, draws: pd.DataFrame, state: str, *, report: str = "") -> str:
    """The page as HTML, with scripts and data inside; InputError if there is nothing to explore."""
    if state == "unusable" or not corner_columns(draws, posterior.quantities):
        raise InputError(
            "this run has no posterior to explore",
            remedy="sample until it converges, with a free parameter",
        )
    thinned = thinned_draws(draws)
    with print_style():
        hues = {"x": colour("x"), "y": colour("y"), "selected": colour(2)}
    axes = _axes(posterior.quantities, draws, thinned)
    priors = _prior_controls(posterior, thinned)
    # draws for all panels: axes of the corner, quantities with a prior, weights
    columns: dict[str, Any] = {f"axis {a.name}": a.values for a in axes}
    columns |= {n: thinned[n].to_numpy(dtype=float) for p in priors for n in p["data"]["columns"]}
    source = ColumnDataSource(columns | {"opacity": np.full(len(thinned), 0.5)}, name="draws")
    corner, histograms = _corner(axes, source, hues)
    panels, curves = _curve_panels(posterior, thinned, source, hues)
    script = CustomJS(
        args={
            "draws": source,
            "histograms": histograms,
            "curves": [band for band, _ in curves.values()],
            "axes": [{"column": f"axis {a.name}", "unit": a.unit, "log": a.ratio} for a in axes],
            "loads": [{"column": c, "factor": factor} for c, (_, factor) in curves.items()],
            "priors": [p["data"] for p in priors],
            "levels": [0.5, *tails(CONTENT)],
            "least": LEAST_EFFECTIVE,
        },
        code=(Path(__file__).parent / "explore.js").read_text(encoding="utf-8"),
    )
    document = Document()
    document.add_root(corner)
    document.add_root(panels)
    document.js_on_event("document_ready", script)
    page = file_html(
        document,
        INLINE,
        title=f"{truncate(posterior.specimen.name)} – explore the posterior",
        template=page_template("explore.html.jinja"),
        template_variables={
            "name": truncate(posterior.specimen.name),
            "tests_in_words": tests_in_words(posterior.specimen),
            "law": posterior.law.title,
            "law_called": posterior.law.short_name,
            "report": report,
            "state": state,
            "draws": len(thinned),
            "total": len(draws),
            "least": LEAST_EFFECTIVE,
            "percent": f"{100 * CONTENT:g}",
            "axes": axes,
            "priors": priors,
            "hues": hues,
            "width": PANEL_PX * len(axes) + 80,
            "protocols": sum(shown_protocols(s, PAGE_MM) for s in posterior.specimen.pieces),
            "all_protocols": sum(len(s.protocols) for s in posterior.specimen.pieces),
            "directions": _directions(posterior.specimen),
        },
    )
    return _numbered_in_order(page)


def _directions(specimen: Specimen) -> list[tuple[str, str, str | None]]:
    """The directions with readings, what these are called, and the direction of the tissue."""
    read = {k for piece in specimen.pieces for k in piece.experiment.axes}
    words = zip("xy", specimen.experiment.curves, (specimen.axis_x, specimen.axis_y), strict=True)
    return [each for k, each in enumerate(words) if k in read]


def _numbered_in_order(page: str) -> str:
    """Renumber Bokeh's ids, which otherwise depend on earlier pages of the process."""
    models = dict.fromkeys(re.findall(r'"id":"(p\d+)"', page))
    number = {name: f"p{1001 + k}" for k, name in enumerate(models)}
    page = re.sub(r'(?<!"text":)"(p\d+)"', lambda m: f'"{number.get(m[1], m[1])}"', page)
    elements = dict.fromkeys(re.findall(UUID, page))
    order = {name: f"bokeh-{k}" for k, name in enumerate(elements)}
    return re.sub(UUID, lambda m: order[m[0]], page)


# --- the corner ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class ExploredAxis:
    """A quantity with panels of its own."""

    name: str
    symbol: Markup  # HTML
    unit: str
    values: np.ndarray  # of the draws on the page; the mean over mounted states
    span: Span
    ratio: bool  # shifts on a logarithmic scale
    all_draws: str  # median and interval of all draws, as in the report


def _axes(quantities: Quantities, draws: pd.DataFrame, thinned: pd.DataFrame) -> list[ExploredAxis]:
    axes = []
    whole = corner_columns(draws, quantities)
    for name, (text, values) in corner_columns(thinned, quantities).items():
        parameter = text.parameter
        assert parameter is not None  # corner_columns gives it
        symbol = as_html(Quantity(parameter))
        if MEAN in text.symbol:
            symbol = Markup("mean {}").format(symbol)
        shown = axis_span(text, values)
        ratio = parameter.logarithmic and bool((values > 0.0).all())
        q50, q05, q95 = np.quantile(whole[name][1], [0.5, *tails(CONTENT)]).tolist()
        median, low, high = quantile_texts(q50, q05, q95, parameter)
        interval = f"{median} ({low} to {high})"
        axes.append(ExploredAxis(name, symbol, text.unit, values, shown, ratio, interval))
    return axes


def _corner(axes: list[ExploredAxis], source: Any, hues: dict[str, str]) -> tuple[Any, list[Any]]:
    """Panels of pairs and histograms, and the sources of the histograms."""
    ranges = [Range1d(a.span.low, a.span.high) for a in axes]
    kinds: Any = ["log" if a.span.log else "linear" for a in axes]
    last = len(axes) - 1
    grid: list[list[Any]] = [[None] * len(axes) for _ in axes]
    histograms = []
    for i, j in np.argwhere(np.tri(len(axes))).tolist():
        diagonal = i == j
        panel = figure(
            width=PANEL_PX + (55 if j == 0 else 0),
            height=PANEL_PX + (45 if i == last else 0),
            x_range=ranges[j],
            x_axis_type=kinds[j],
            y_axis_type="linear" if diagonal else kinds[i],
            x_axis_location="below" if i == last else None,
            y_axis_location="left" if j == 0 and not diagonal else None,
            tools=[] if diagonal else [BoxSelectTool()],
            min_border=2,
        )
        panel.center = []  # no grid
        if diagonal:
            histograms.append(_histogram(panel, axes[i], hues["selected"]))
        else:
            panel.y_range = ranges[i]
            panel.scatter(
                f"axis {axes[j].name}",
                f"axis {axes[i].name}",
                source=source,
                size=3,
                line_color=None,
                fill_color=GREY,
                fill_alpha="opacity",
                selection_fill_color=hues["selected"],
                selection_fill_alpha=0.9,
                nonselection_fill_alpha=0.1,
            )
        for panel_axes, quantity in ((panel.below, axes[j]), (panel.left, axes[i])):
            for axis in panel_axes:
                unit = f" ({quantity.unit})" if quantity.unit else ""
                axis.axis_label = quantity.name + unit
                axis.axis_label_text_font_size, axis.major_label_text_font_size = "11px", "10px"
                axis.axis_label_text_font_style = "normal"
                axis.ticker.desired_num_ticks = 3
                axis.ticker.num_minor_ticks = 0
        grid[i][j] = panel
    return gridplot(grid, toolbar_location="right", merge_tools=True), histograms


def _histogram(panel: Any, axis: ExploredAxis, hue: str) -> Any:
    """Draw all draws as a line, the selected ones as bars; return the source of both."""
    bin_edges = axis.span.back(np.linspace(0.0, 1.0, HISTOGRAM_BINS + 1))
    counts = np.histogram(axis.values, bin_edges)[0] / len(axis.values)
    source = ColumnDataSource(
        {"left": bin_edges[:-1], "right": bin_edges[1:], "all": counts, "selected": counts}
    )
    bars = {"left": "left", "right": "right", "bottom": 0, "source": source}
    panel.quad(top="selected", color=hue, **bars)
    panel.quad(top="all", fill_alpha=0, line_width=0.7, line_color=GREY, **bars)
    return source


# --- the curves ----------------------------------------------------------------------------------


def _curve_panels(
    posterior: Posterior, thinned: pd.DataFrame, source: Any, hues: dict[str, str]
) -> tuple[Any, dict[str, tuple[Any, float]]]:
    """Loads of each protocol of all pieces, and the residuals about the median of all draws.

    Returns the panels, and by the column of its loads among the draws the source of each band and
    the factor of its residuals.
    """
    counts = [shown_protocols(piece.specimen, PAGE_MM) for piece in posterior.pieces]
    max_rows = min(MAX_STATES_PER_PROTOCOL, max(MAX_STATES // sum(counts), LEAST_STATES))
    curves: dict[str, tuple[Any, float]] = {}
    panels: list[list[Any]] = []
    for i, (piece, count) in enumerate(zip(posterior.pieces, counts, strict=True)):
        specimen = piece.specimen
        drawn = curves_of_draws(posterior, thinned, piece=i, max_rows=max_rows)[:count]
        tables = [_table(each, specimen.experiment.axes) for each in drawn]
        for p, (protocol, table) in enumerate(zip(drawn, tables, strict=True)):
            test = {str(axis): part for axis, part in table.groupby("direction")}
            abscissas, over = abscissa(test, specimen.experiment.stretches)
            for name, directions in load_panels(specimen):
                axes, unit = ["xy"[k] for k in directions], specimen.units[directions[0]]
                of_unit = [each[each["direction"].isin(axes)] for each in tables]
                factor, finer = residual_unit(pd.concat(of_unit), unit)
                title = Title(text=PlainText(truncate(piece.title(protocol.protocol), 60)))
                load = figure(width=CURVE_PX, height=230, tools=[], title=title)
                residual = figure(width=CURVE_PX, height=150, tools=[], x_range=load.x_range)
                load.xaxis.visible = False
                residual.xaxis.axis_label = over
                load.yaxis.axis_label = name.replace("\n", " ")
                residual.yaxis.axis_label = f"less median ({finer})"
                for panel in (load, residual):
                    panel.axis.axis_label_text_font_style = "normal"
                    panel.min_border_left = 70
                for k, axis in zip(directions, axes, strict=True):
                    order = np.argsort(abscissas[axis], kind="stable")
                    column, loads = f"load {i} {p} {axis}", protocol.load[:, order, k]
                    source.data[column] = loads.astype(np.float32)
                    x, measured = abscissas[axis][order], protocol.measured[order, k]
                    look = {"marker": "square" if k else "circle", "hue": hues[axis]}
                    band = _draw_curve((load, residual), x, loads, measured, factor, **look)
                    curves[column] = band, factor
                panels += [[load], [residual]]
    return gridplot(panels, toolbar_location=None, sizing_mode="stretch_width"), curves


def _table(curves: DrawnCurves, axes: Sequence[int]) -> pd.DataFrame:
    """The directions of a protocol in one table, with the median of all draws."""
    parts = []
    for k in axes:
        columns = {"direction": "xy"[k], "row": curves.rows, "stretch": curves.stretch[:, k]}
        columns |= {"measured": curves.measured[:, k]}
        columns |= {"credible_median": np.median(curves.load[:, :, k], axis=0)}
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def _draw_curve(
    panels: tuple[Any, Any],
    x: np.ndarray,
    loads: np.ndarray,
    measured: np.ndarray,
    factor: float,
    *,
    marker: str,
    hue: str,
) -> Any:
    """Band, median and readings as loads and as residuals; return the source of the band."""
    median, low, high = np.quantile(loads, [0.5, *tails(CONTENT)], axis=0)
    columns = {"x": x, "all": median, "low": low, "median": median, "high": high}
    columns |= {f"{n}_residual": factor * (columns[n] - median) for n in ("low", "median", "high")}
    band = ColumnDataSource(columns)
    readings = (measured, factor * (measured - median))
    opaque = BAND_OPACITY["credible"]
    for panel, end, y in zip(panels, ("", "_residual"), readings, strict=True):
        panel.varea("x", f"low{end}", f"high{end}", source=band, color=hue, alpha=opaque)
        panel.line("x", f"median{end}", source=band, color=hue)
        panel.scatter(x, y, marker=marker, size=4, line_color=hue, fill_color="white")
    panels[0].line("x", "all", source=band, color="black", line_dash="dashed", line_width=0.8)
    return band


# --- other priors --------------------------------------------------------------------------------


def _prior_controls(posterior: Posterior, draws: pd.DataFrame) -> list[dict[str, Any]]:
    """Text and sliders of the priors of varying quantities, and ``data`` for the script.

    Equal priors of mounting stretches are merged and come first.
    """
    groups: dict[tuple[Any, ...], list[Quantity]] = {}
    for name, prior in posterior.priors.items():
        if isinstance(prior, Prior) and name in draws and np.ptp(draws[name]) > 0.0:
            q = posterior.quantities[name]
            shared = "" if q.parameter.kind == STRETCH else name
            groups.setdefault((prior, shared), []).append(q)
    controls = []
    for (prior, _), members in groups.items():
        first, flat = members[0], prior.family in ("uniform", "loguniform")
        symbols = dict.fromkeys(as_html(Quantity(q.parameter)) for q in members)
        control = {
            "symbol": Markup(", ").join(symbols),
            "words": " and ".join(dict.fromkeys(q.parameter.words for q in members)),
            "run": prior_text(prior, first.unit),
            "numbers": [PRIOR_NUMBERS.get(k, k) for k in FAMILIES[prior.family]],
            "data": {
                "columns": [q.name for q in members],
                "unit": first.parameter.unit_symbol(first.load_unit),
                "family": prior.family,
                "run": [prior.low, prior.high] if flat else [prior.location, prior.scale],
            },
        }
        controls.append((first.parameter.kind != STRETCH, control))
    return [control for _, control in sorted(controls, key=lambda c: c[0])]
