"""Comparisons of runs, and of laws."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.comparison.compare import Comparison
from biaxbayes.comparison.law_weights import MIXTURE, LawComparison
from biaxbayes.derived.determined import STRESS
from biaxbayes.figures import style
from biaxbayes.figures.identifiability import VERDICT_COLOURS
from biaxbayes.figures.panels import draw_cells, row_panels, set_panel
from biaxbayes.figures.quantities import AxisText, axis_span, axis_text, plain, quantity
from biaxbayes.parameters import STRETCH, Quantities, Quantity
from biaxbayes.prediction.percentiles import tails

# --- runs: the matrix of verdicts and the forest of intervals ------------------------------------

CELL_MM, FOREST_ROW_MM = 9.5, 4.2
FOREST_NOTE = (
    "filled: identified or bounded in that run; open: not, so differences are not of the tissue"
)


@style.print_style()
def matrix_figure(comparison: Comparison) -> Figure:
    """Verdict and reported interval of every parameter of every run."""
    runs = [{row.name: row for row in reported} for reported in comparison.reported]
    quantities = _judged(comparison)
    names = [name for name in quantities if any(name in run for run in runs)]
    cells = [[run.get(name) for name in names] for run in runs]
    figure = style.blank_figure(style.PAGE_MM, 15.0 + CELL_MM * len(runs))
    draw_cells(
        figure.subplots(),
        [  # "only in combination" would not fit
            [f"{r.verdict.removeprefix('only ')}\n{r.interval}" if r else "" for r in rows]
            for rows in cells
        ],
        [[VERDICT_COLOURS[r.verdict] if r else "white" for r in rows] for rows in cells],
        rows=[plain(label, 20) for label in comparison.labels],
        columns=[axis_text(quantities[name]).label for name in names],
    )
    style.add_note(figure, "below the verdict: reported 90 % interval or 95 % bound")
    return figure


def _judged(comparison: Comparison) -> dict[str, Quantity]:
    """Material parameters and mounting stretches of a shared state, of all runs."""
    judged = (q for m in comparison.members for q in m.posterior.quantities.assessed())
    return {q.name: q for q in judged if not q.state}


@style.print_style()
def forest_figure(comparison: Comparison) -> Figure:
    """Draw medians with 50 and 90 % intervals of every run; open symbols are not identified."""
    rows: list[tuple[AxisText, dict[int, np.ndarray], list[bool]]] = []
    for name, known in _judged(comparison).items():
        of_runs = [m.draws for m in comparison.members]
        draws = {i: run[name].to_numpy(float) for i, run in enumerate(of_runs) if name in run}
        if draws:
            identified = [d.get(name, False) for d in comparison.identified]
            rows.append((axis_text(known), draws, identified))
    by_key = [{q.key: q for q in derived} for derived in comparison.derived]
    for key, first in by_key[0].items():
        # of stresses those at the largest stretch
        at_end = first.kind != STRESS or first.stretch == comparison.stretches[-1]
        if at_end and all(key in of_run for of_run in by_key):  # else of one law alone
            at = "" if first.stretch is None else f" at {first.stretch:.4g}"
            draws = {i: of_run[key].values for i, of_run in enumerate(by_key)}
            identified = [d[key] for d in comparison.identified]
            rows.append((quantity(first.name + at), draws, identified))
    labels = [plain(label, 16) for label in comparison.labels]
    tall = FOREST_ROW_MM * len(labels) + 1.0
    figure, axes = row_panels(len(rows), tall, range(len(labels)), labels, FOREST_NOTE)
    for ax, (text, draws, identified) in zip(axes, rows, strict=True):
        for i, values in draws.items():
            hue = style.colour(i)
            if np.ptp(values) > 0.0:
                ax.plot(np.quantile(values, tails(0.9)), [i, i], color=hue, linewidth=0.9)
                ax.plot(np.quantile(values, tails(0.5)), [i, i], color=hue, linewidth=2.2)
            face = hue if identified[i] else "white"
            ax.plot(np.median(values), i, "o", color=hue, mfc=face, ms=3.6, mew=0.9)
        set_panel(ax, axis_span(text, *draws.values()), text.label, len(labels))
    return figure


# --- laws: misfit and prediction, mounting stretches ---------------------------------------------

LAW_ROW_MM, HEAD_MM = 5.5, 14.0


def by_weight(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of laws, the largest weight on top and the mixture below."""
    laws = table[table["law"] != MIXTURE].sort_values("weight", ascending=False, kind="stable")
    return pd.concat([laws, table[table["law"] == MIXTURE]])


def _weighted_rows(compared: LawComparison) -> tuple[pd.DataFrame, np.ndarray]:
    """Laws with a weight and the mixture, and their heights."""
    rows = by_weight(compared.table[compared.table["left_out_rms_kPa"].notna()])
    return rows, -np.arange(len(rows), dtype=float)


def _label_laws(ax: Axes, rows: pd.DataFrame, positions: np.ndarray) -> None:
    ax.set_yticks(positions, rows["law"])
    ax.set_ylim(positions[-1] - 0.7, 0.7)
    ax.tick_params(axis="y", length=0)


@style.print_style()
def law_misfit_figure(compared: LawComparison) -> Figure:
    """Misfit of the record beside that of left-out parts, and the weights."""
    rows, positions = _weighted_rows(compared)
    laws = rows["law"] != MIXTURE
    blue = style.colour(0)
    figure = style.blank_figure(style.PAGE_MM, HEAD_MM + 6.0 + LAW_ROW_MM * (len(rows) + 0.4))
    misfit, weights = figure.subplots(1, 2, sharey=True, width_ratios=(1.7, 1.0))
    fit, left_out = rows["rms_kPa"], rows["left_out_rms_kPa"]
    misfit.hlines(positions, fit, left_out, color="0.75", linewidth=0.8)
    misfit.plot(fit, positions, "o", ms=4.0, mec=blue, mfc="white", label="of the fit to all")
    misfit.plot(left_out, positions, "o", ms=4.0, mec=blue, mfc=blue, label="of parts left out")
    misfit.set_xlim(left=0.0)
    misfit.set_xlabel("rms misfit (kPa)")
    _label_laws(misfit, rows, positions)
    misfit.axhline(positions[-1] + 0.5, color="0.6", linewidth=0.5)
    weights.barh(positions[laws], rows["weight"][laws], height=0.5, color=blue, alpha=0.5)
    ends = rows["weight_low"][laws], rows["weight_high"][laws]
    weights.hlines(positions[laws], *ends, color="0.2")
    weights.set_xlim(0.0, 1.0)
    weights.set_xlabel("weight, and range with a part dropped")
    for ax in (misfit, weights):
        style.limit_ticks(ax.xaxis)
    figure.legend(loc="outside upper left", ncols=2)
    return figure


@style.print_style()
def law_mounting_figure(compared: LawComparison) -> Figure | None:
    """Draw the mounting stretches by law; None if none is inferred."""
    rows, positions = _weighted_rows(compared)
    rows, positions = rows[:-1], positions[:-1]  # of the mixture there is none
    names = [q.name for q in Quantities(()).of_kind(STRETCH) if f"{q.name}_q50" in rows]
    if not names:
        return None
    figure = style.blank_figure(style.PAGE_MM, HEAD_MM + LAW_ROW_MM * (len(rows) + 0.4))
    panels = np.atleast_1d(figure.subplots(1, len(names), sharey=True))
    for ax, name in zip(panels, names, strict=True):
        low, median, high = (rows[f"{name}_q{q}"].to_numpy() for q in ("05", "50", "95"))
        # a law that hardly predicts is drawn lightly
        hues = np.where(rows["weight"] >= 0.05, style.colour(0), "0.65")
        ax.hlines(positions, low, high, color=hues, linewidth=1.6)
        for position, m, hue in zip(positions, median, hues, strict=True):
            ax.plot(m, position, "o", ms=3.5, color=hue)
        ax.axvline(1.0, color="0.6", linewidth=0.5, linestyle=":")
        ax.set_xlabel(quantity(name).label)
        style.limit_ticks(ax.xaxis)
    _label_laws(panels[0], rows, positions)
    return figure
