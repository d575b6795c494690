"""Comparison of laws: misfit and prediction, mounting stretches, the bands of their mixture."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from biaxbayes.comparison.law_weights import STACKED, LawComparison
from biaxbayes.figures.quantities import quantity
from biaxbayes.figures.run.bands import figure_from_bands, shown_protocols
from biaxbayes.figures.style import PAGE_MM, blank_figure, colour, few_ticks, print_style
from biaxbayes.parameters import STRETCH, Quantities
from biaxbayes.specimens.specimen import Specimen

ROW_MM, HEAD_MM = 5.5, 14.0


def _weighted_rows(compared: LawComparison) -> tuple[pd.DataFrame, np.ndarray]:
    """Laws with a weight, the largest on top, the mixture below; and their heights."""
    table = compared.table[compared.table["left_out_rms_kPa"].notna()]
    laws = table[table["law"] != STACKED].sort_values("weight", ascending=False, kind="stable")
    rows = pd.concat([laws, table[table["law"] == STACKED]])
    return rows, -np.arange(len(rows), dtype=float)


def _label_rows(ax: Axes, rows: pd.DataFrame, places: np.ndarray) -> None:
    ax.set_yticks(places, rows["law"])
    ax.set_ylim(places[-1] - 0.7, 0.7)
    ax.tick_params(axis="y", length=0)
    ax.axhline(places[-1] + 0.5, color="0.6", linewidth=0.5)


def law_misfit_figure(compared: LawComparison) -> Figure:
    """Misfit of the record beside that of left-out parts, and the weights."""
    rows, places = _weighted_rows(compared)
    laws = rows["law"] != STACKED
    with print_style():
        blue = colour("run")
        figure = blank_figure(PAGE_MM, HEAD_MM + 6.0 + ROW_MM * (len(rows) + 0.4))
        misfit, weights = figure.subplots(1, 2, sharey=True, width_ratios=(1.7, 1.0))
        misfit.hlines(
            places, rows["rms_kPa"], rows["left_out_rms_kPa"], color="0.75", linewidth=0.8
        )
        for column, face, label in (
            ("rms_kPa", "white", "of the fit to all"),
            ("left_out_rms_kPa", blue, "of parts left out"),
        ):
            misfit.plot(rows[column], places, "o", ms=4.0, mfc=face, mec=blue, label=label)
        misfit.set_xlim(left=0.0)
        misfit.set_xlabel("rms misfit (kPa)")
        _label_rows(misfit, rows, places)
        weights.barh(places[laws], rows["weight"][laws], height=0.5, color=blue, alpha=0.5)
        ends = rows["weight_low"][laws], rows["weight_high"][laws]
        weights.hlines(places[laws], *ends, color="0.2")
        weights.set_xlim(0.0, 1.0)
        weights.set_xlabel("weight, and range with a part dropped")
        for ax in (misfit, weights):
            few_ticks(ax.xaxis)
        figure.legend(loc="outside upper left", ncols=2)
    return figure


def law_mounting_figure(compared: LawComparison) -> Figure | None:
    """Draw the mounting stretches by law, grey the reported interval; None if none is inferred."""
    rows, places = _weighted_rows(compared)
    names = [q.name for q in Quantities(()).of_kind(STRETCH) if f"{q.name}_q50" in rows]
    if not names:
        return None
    reported = {row.name: row for row in compared.reported}
    with print_style():
        figure = blank_figure(PAGE_MM, HEAD_MM + ROW_MM * (len(rows) + 0.4))
        panels = np.atleast_1d(figure.subplots(1, len(names), sharey=True))
        for ax, name in zip(panels, names, strict=True):
            low, median, high = (rows[f"{name}_q{q}"].to_numpy() for q in ("05", "50", "95"))
            # a law that hardly predicts is drawn lightly
            hues = np.where(rows["weight"] >= 0.05, colour("run"), "0.65")
            ax.hlines(places, low, high, color=hues, linewidth=1.6)
            for place, m, hue in zip(places, median, hues, strict=True):
                ax.plot(m, place, "o", markersize=3.5, color=hue)
            ax.axvline(1.0, color="0.6", linewidth=0.5, linestyle=":")
            first, last = reported[name].low, reported[name].high
            if np.isfinite(first):
                # an open end reaches as far as the panel does
                left, right = ax.get_xlim()
                end = last if np.isfinite(last) else max(right, first + 0.1)
                ax.axvspan(first, end, color="0.9", linewidth=0.0, zorder=-5)
                ax.set_xlim(min(left, first), max(right, last if np.isfinite(last) else 0.0))
            ax.set_xlabel(quantity(name).label)
            few_ticks(ax.xaxis)
        _label_rows(panels[0], rows, places)
    return figure


def law_bands_figure(compared: LawComparison, specimen: Specimen) -> Figure:
    """Bands of the mixture over the record."""
    names = [p.name for p in specimen.protocols[: shown_protocols(specimen, PAGE_MM)]]
    table = compared.bands[compared.bands["protocol"].isin(names)]
    return figure_from_bands(specimen, table)
