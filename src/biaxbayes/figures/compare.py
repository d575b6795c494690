"""Runs and specimens side by side: the matrix of verdicts and the forests of intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from biaxbayes.comparison.compare import Comparison
from biaxbayes.figures.labels import few_ticks
from biaxbayes.figures.quantities import AxisText, axis_text, known_or_default, quantity
from biaxbayes.figures.run.identifiability import VERDICT_COLOURS
from biaxbayes.figures.style import (
    MM,
    PAGE_MM,
    RUNS,
    blank_figure,
    colour,
    font_points,
    layout,
    plain,
    print_style,
    settle,
)
from biaxbayes.identifiability.bounded_density import Span, at_edges, curve, interval, span
from biaxbayes.identifiability.determined import STRESS
from biaxbayes.identifiability.identify import ParameterVerdict
from biaxbayes.identifiability.mounting_stretch.stated import Stated
from biaxbayes.identifiability.verdict_names import (
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    PRIOR,
)
from biaxbayes.parameters import Quantity
from biaxbayes.studies.groups import KNOWN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LABEL_MM, ROW_MM, HEAD_MM, FOOT_MM = 27.0, 9.5, 8.0, 7.0
SHORT = {COMBINATION: "in combination", FIXED: "fixed"}
FOREST_COLUMNS = 4
PANEL_MM, GAP_MM = 4.2, 12.0
STATED_BELOW = 0.3
"""Rows by which what is stated of the tissue stands below an interval."""
TAIL_STRETCH = 8.0
"""Ratio of quantiles from which a positive scale gets a logarithmic axis."""


def matrix_figure(
    found: Comparison, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Verdict and contraction of every parameter of every run.

    Parameters
    ----------
    found : Comparison
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    judged, more = _judged(found), _any_stated(found)
    names = [n for n in judged if any(_verdict(v.parameters, n) for v in found.verdicts)]
    rows = len(found.members)
    height = HEAD_MM + ROW_MM * rows + FOOT_MM
    with print_style(style):
        figure = blank_figure(width_mm * MM, height * MM)
        ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        ax.set_axis_off()
        ax.set(xlim=(0.0, width_mm), ylim=(height, 0.0))
        cell = (width_mm - LABEL_MM - 1.0) / len(names)
        for j, name in enumerate(names):
            x = LABEL_MM + (j + 0.5) * cell
            ax.text(x, 0.55 * HEAD_MM, axis_text(judged[name]).label, ha="center", va="center")
        for i, verdicts in enumerate(found.verdicts):
            y = HEAD_MM + ROW_MM * i
            label = plain(found.labels[i], 20)
            ax.text(LABEL_MM - 2.0, y + 0.5 * ROW_MM, label, ha="right", va="center")
            for j, name in enumerate(names):
                verdict = _verdict(verdicts.parameters, name)
                if verdict is not None:
                    _cell(ax, (LABEL_MM + j * cell, y), (cell, ROW_MM), verdict)
        ax.text(
            LABEL_MM,
            height - 0.4 * FOOT_MM,
            "per cent: contraction of the variance from prior to posterior"
            + ("; below: what is stated of the tissue, whatever its law" if more else ""),
            va="center",
            color="0.35",
            fontsize=7.0,
        )
    return figure


def _any_stated(found: Comparison) -> bool:
    return any(m.stated for m in found.members)


def _verdict(parameters: tuple[ParameterVerdict, ...], name: str) -> ParameterVerdict | None:
    return next((p for p in parameters if p.name == name), None)


def _cell(
    ax: Axes, corner: tuple[float, float], size: tuple[float, float], found: ParameterVerdict
) -> None:
    from matplotlib.patches import Rectangle

    face = VERDICT_COLOURS[found.verdict]
    (x, y), (width, height) = corner, size
    ax.add_patch(
        Rectangle((x + 0.4, y + 0.4), width - 0.8, height - 0.8, facecolor=face, linewidth=0.0)
    )
    hue = "white" if found.verdict in (IDENTIFIED, PRIOR, NO_VERDICT) else "black"
    text, stated = SHORT.get(found.verdict, found.verdict), ""
    if found.evidence is not None:
        share = 100.0 * max(found.evidence.contraction, 0.0)
        if found.stated is not None:
            said = found.stated.in_words(found.scale.parameter).replace(" to ", "–")
            stated = "\n" + said.replace("above", ">").replace("nothing", "–")
        text += f"\n{min(share, 99.9):.1f} %" if share > 99.0 else f"\n{share:.0f} %"
    centre = (x + 0.5 * width, y + 0.5 * height)
    how: dict[str, Any] = {"ha": "center", "va": "center", "color": hue, "linespacing": 1.1}
    ax.text(*centre, text + stated, fontsize=6.5, **how)


class _Row(NamedTuple):
    """A quantity of the forest: its label, its draws run by run and whether each is determined."""

    label: str
    edges: tuple[float, float]
    log: bool
    draws: list[np.ndarray | None]
    determined: list[bool]
    stated: list[Stated | None]


def forest_figure(
    found: Comparison, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians with intervals of 50 and 90 % of every run, a panel a quantity.

    Open symbols stand for what a run does not determine.

    Parameters
    ----------
    found : Comparison
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    panels = _parameters(found) + _derived(found)
    note = "filled: determined in that run; open: not determined, no difference of tissue"
    if _any_stated(found):
        note += (
            "\nmounting stretches: within the law; below in grey what is stated of the tissue, "
            "whatever its law (arrow: above)"
        )
    tall = PANEL_MM * len(found.members) + 1.0
    names = [plain(label, 16) for label in found.labels]
    with print_style(style):
        figure, axes = panel_rows(len(panels), tall, width_mm, note)
        for k, (ax, row) in enumerate(zip(axes, panels, strict=True)):
            _panel(ax, row)
            labels = [] if k % FOREST_COLUMNS else names
            ax.set_yticks(range(len(labels)), labels)
        settle(figure)
    return figure


def panel_rows(count: int, tall: float, width_mm: float, note: str) -> tuple[Figure, list[Axes]]:
    """A figure of equal panels, four a row and ``tall`` mm high, with a note at its foot."""
    lines = max(-(-count // FOREST_COLUMNS), 1)
    height = lines * (tall + GAP_MM) + FOOT_MM
    room = layout(across_mm=1.2, down_mm=0.8)
    figure = blank_figure(width_mm * MM, height * MM, room)
    places = figure.add_gridspec(lines, FOREST_COLUMNS)
    axes = [figure.add_subplot(places[divmod(k, FOREST_COLUMNS)]) for k in range(count)]
    for ax in axes:
        ax.tick_params(axis="y", length=0.0)
        ax.spines["left"].set_visible(False)
    size = font_points("legend.fontsize")
    figure.supxlabel(note, x=0.995, ha="right", color="0.35", fontsize=size)
    return figure, axes


def _judged(found: Comparison) -> dict[str, Quantity]:
    """Material parameters and mounting stretches of a shared state, of all runs."""
    judged = (q for m in found.members for q in m.posterior.quantities.judged())
    return {q.name: q for q in judged if not q.state}


def _parameters(found: Comparison) -> list[_Row]:
    out = []
    for name, known_quantity in _judged(found).items():
        q = axis_text(known_quantity)
        draws = [
            m.draws[name].to_numpy(dtype=float) if name in m.draws else None for m in found.members
        ]
        if any(d is not None for d in draws):
            known = [d.get(name, False) for d in found.determined]
            stated = [m.stated.get(name) for m in found.members]
            out.append(_Row(q.label, q.edges, q.scale, draws, known, stated))
    return out


def _derived(found: Comparison) -> list[_Row]:
    """Structure tensor, stiffness and the stresses at the largest common stretch."""
    out = []
    for quantities in zip(*found.derived, strict=True):
        first = quantities[0]
        if first.kind == STRESS and first.stretch != found.stretches[-1]:
            continue
        axis = first.name[-1]
        symbol = {"H": f"$H_{axis}$", "s": f"$c_{{{axis}{axis}}}$", "c": rf"$\sigma_{axis}$"}
        label = symbol[first.name[0]]
        if first.stretch is not None:
            label += f" at {first.stretch:.4g} (kPa)"
        edges = (0.0, 1.0) if first.stretch is None else (0.0, np.inf)
        known = [d[first.key] for d in found.determined]
        log = first.stretch is not None
        values = [q.values for q in quantities]
        out.append(_Row(label, edges, log, values, known, [None] * len(values)))
    return out


def _panel(ax: Axes, row: _Row) -> None:
    axis = _axis(row)
    for i, (values, known) in enumerate(zip(row.draws, row.determined, strict=True)):
        if values is None:
            continue
        hue = colour(RUNS[i % len(RUNS)])
        median = float(np.median(values))
        if np.ptp(values) > 0.0:
            _, density = curve(values, axis)
            piled = at_edges(density, axis)
            # One-sided where the draws pile up at a physical edge; the middle half is central.
            for content, ends, line in ((0.9, piled, 0.9), (0.5, (False, False), 2.2)):
                ax.plot(interval(values, ends, content), [i, i], color=hue, linewidth=line)
        face = hue if known else "white"
        ax.plot(
            median, i, "o", color=hue, markerfacecolor=face, markersize=3.6, markeredgewidth=0.9
        )
    for i, stated in enumerate(row.stated):
        if stated is not None and np.isfinite(stated.low):
            _stated(ax, stated, i + STATED_BELOW, axis.high)
    ax.set_ylim(len(row.draws) - 0.4, -0.6)
    if axis.log:
        ax.set_xscale("log")
    ax.set_xlim(axis.low, axis.high)
    few_ticks(ax.xaxis, most=4, overhang=2.0)
    ax.set_xlabel(row.label, labelpad=2.0)


def _stated(ax: Axes, stated: Stated, y: float, end: float) -> None:
    """What is stated of the tissue: both ends, or the low one and an arrow."""
    grey: dict[str, Any] = {"color": "0.45", "linewidth": 0.9, "markersize": 3.0}
    high = stated.high if stated.is_value else end
    ax.plot([stated.low, high], [y, y], solid_capstyle="butt", **grey)
    ax.plot(stated.low, y, "|", **grey)
    ax.plot(high, y, "|" if stated.is_value else ">", clip_on=stated.is_value, **grey)


def _axis(row: _Row) -> Span:
    draws = [d for d in row.draws if d is not None]
    low, high = np.quantile(np.concatenate(draws), [0.005, 0.995])
    log = row.log and low > 0.0 and high > TAIL_STRETCH * low
    ends = [v for s in row.stated if s is not None for v in (s.low, s.high)]
    seen = tuple(v for v in ends if np.isfinite(v))
    return span(*draws, edges=row.edges, log=bool(log), include=seen)


# --- all specimens of a study, quantity by quantity, ordered by layer ----------------------------


CURVES = {
    "Hx": AxisText("$H_x$", "", (0.0, 1.0)),
    "Hy": AxisText("$H_y$", "", (0.0, 1.0)),
    "stiffness_x at 1": AxisText("$c_{xx}$ at 1", "kPa", (0.0, np.inf), True),
    "stiffness_y at 1": AxisText("$c_{yy}$ at 1", "kPa", (0.0, np.inf), True),
}
TALLEST_ROW_MM, TALLEST_PANEL_MM, LEAST_LABEL_MM = 4.2, 62.0, 2.6
LABEL_LENGTH = 18
MARKERS = ("o", "s", "^", "D", "v", "P")


class _Specimen(NamedTuple):
    """A specimen in the figure."""

    label: str
    layer: int


def study_figure(
    table: pd.DataFrame, *, width_mm: float = PAGE_MM, style: Mapping[str, Any] | None = None
) -> Figure:
    """Medians and 90 % intervals of every specimen, a panel a quantity.

    Open symbols stand for parameters that the specimen does not determine.

    Parameters
    ----------
    table : DataFrame
        The study table.
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.
    """
    known = table[np.isfinite(table["q50"].astype(float))]
    layers = list(dict.fromkeys(table["layer"]))
    first = table.drop_duplicates("specimen")
    rows = sorted(
        (
            _Specimen(str(s), layers.index(k))
            for s, k in zip(first["specimen"], first["layer"], strict=True)
        ),
        key=lambda row: row.layer,
    )
    judged = [q.name for q in known_or_default(None).judged()]
    panels = [n for n in (*judged, *CURVES) if (known["quantity"] == n).any()]
    row_mm = min(TALLEST_ROW_MM, TALLEST_PANEL_MM / max(len(rows), 1))
    tall = row_mm * len(rows) + 1.0
    names = _names(rows, layers, row_mm)
    note = "within the law; filled: determined; open: not determined; cross: fixed"
    with print_style(style):
        figure, axes = panel_rows(len(panels), tall, width_mm, note)
        for k, (ax, name) in enumerate(zip(axes, panels, strict=True)):
            _specimens(ax, known[known["quantity"] == name], name, rows)
            shown = [] if k % FOREST_COLUMNS else names
            ax.set_yticks([at for at, _ in shown], [plain(n, LABEL_LENGTH) for _, n in shown])
        drawn = [k for k, layer in enumerate(layers) if (known["layer"] == layer).any()]
        _layers(figure, layers, drawn)
        settle(figure)
    return figure


def _names(rows: list[_Specimen], layers: list[str], row_mm: float) -> list[tuple[float, str]]:
    """What stands at the rows: the specimens, or the layers where specimens lie too close."""
    if row_mm >= LEAST_LABEL_MM:
        return [(float(i), row.label) for i, row in enumerate(rows)]
    out = []
    for k, layer in enumerate(layers):
        places = [i for i, row in enumerate(rows) if row.layer == k]
        out.append((float(np.mean(places)), layer or "no layer"))
    return out


def _specimens(ax: Axes, part: pd.DataFrame, name: str, rows: list[_Specimen]) -> None:
    shown = CURVES.get(name) or quantity(name)
    axis = _study_axis(part, shown)
    found = {str(r["specimen"]): r for r in part.to_dict("records")}
    for i, row in enumerate(rows):
        record = found.get(row.label)
        if record is None:
            continue
        hue = colour(RUNS[row.layer % len(RUNS)])
        known = record["state"] == "converged" and record["verdict"] in KNOWN
        if record["verdict"] == FIXED:
            ax.plot(record["q50"], i, "x", color="0.35", markersize=3.4, markeredgewidth=0.8)
            continue
        ends = np.clip([record["q05"], record["q95"]], axis.low, axis.high)
        ax.plot(ends, [i, i], color=hue, linewidth=1.0)
        ax.plot(
            record["q50"],
            i,
            MARKERS[row.layer % len(MARKERS)],
            color=hue,
            markerfacecolor=hue if known else "white",
            markersize=3.4,
            markeredgewidth=0.8,
            clip_on=False,
        )
    ax.set_ylim(len(rows) - 0.4, -0.6)
    if axis.log:
        ax.set_xscale("log")
    ax.set_xlim(axis.low, axis.high)
    few_ticks(ax.xaxis, most=4, overhang=2.0)
    ax.set_xlabel(shown.label, labelpad=2.0)


def _study_axis(part: pd.DataFrame, shown: AxisText) -> Span:
    """Range of all medians and intervals."""
    ends = part[["q05", "q50", "q95"]].to_numpy(dtype=float).ravel()
    log = shown.scale and ends.min() > 0.0 and ends.max() > TAIL_STRETCH * ends.min()
    return span(ends, edges=shown.edges, log=bool(log))


def _layers(figure: Figure, layers: list[str], drawn: list[int]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            color=colour(RUNS[k % len(RUNS)]),
            marker=MARKERS[k % len(MARKERS)],
            markersize=3.4,
            linewidth=1.0,
            label=plain(layers[k] or "no layer", LABEL_LENGTH),
        )
        for k in drawn
    ]
    if len(drawn) > 1:
        figure.legend(
            handles=handles,
            loc="outside lower left",
            ncols=min(len(handles), 6),
            borderaxespad=0.0,
        )
