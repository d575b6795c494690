"""Predicted inflation of a tube: pressure against outer diameter, with both bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.figures.predicted_bands import add_legend, draw_bands, draw_median
from biaxbayes.figures.style import (
    COLUMN_MM,
    CREDIBLE,
    PREDICTIVE,
    blank_figure,
    colour,
    print_style,
)
from biaxbayes.options import CONTENT
from biaxbayes.prediction.inflation import MMHG_PER_KPA

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def inflation_figure(
    table: pd.DataFrame,
    *,
    probability: float = CONTENT,
    width_mm: float = COLUMN_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Pressure against outer diameter with both bands; dashed where nothing was tested.

    Below, or beside, the bands less their median, which they hardly leave on the scale of the test.

    Parameters
    ----------
    table : DataFrame
        From :func:`biaxbayes.prediction.inflation.predict_pressure` or
        :func:`biaxbayes.prediction.inflation.predict_diameter`.
    probability : float
        Content of its bands.
    width_mm : float
        Width in print.
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with print_style(style):
        tint = colour("run")
        figure = blank_figure(width_mm, 0.85 * width_mm)
        if "pressure_kPa_median" in table:
            ax, strip = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
            across = table["outer_diameter_mm"].to_numpy()
            middle: Any = table["pressure_kPa_median"]
            about = {c: table[c] - middle for c in table if str(c).startswith("pressure_kPa_")}
            draw_bands(ax, across, table, "pressure_kPa", tint)
            draw_median(ax, across, middle, table, tint)
            draw_bands(strip, across, pd.DataFrame(about), "pressure_kPa", tint)
            strip.axhline(0.0, color=tint)
            strip.set(xlabel="outer diameter (mm)", ylabel="less median\n(kPa)")
            right = ax
        else:
            ax, strip = figure.subplots(1, 2, sharey=True, width_ratios=(3.0, 1.0))
            up = table["pressure_kPa"].to_numpy()
            middle = table["outer_diameter_mm_median"].to_numpy()
            for kind, opacity in (("predictive", PREDICTIVE), ("credible", CREDIBLE)):
                ends = np.array([table[f"outer_diameter_mm_{kind}_{e}"] for e in ("low", "high")])
                for panel, (low, high) in ((ax, ends), (strip, ends - middle)):
                    panel.fill_betweenx(up, low, high, color=tint, alpha=opacity, linewidth=0.0)
            draw_median(ax, middle, up, table, tint)
            strip.axvline(0.0, color=tint)
            ax.set_xlabel("outer diameter (mm)")
            strip.set_xlabel("less median\n(mm)")
            right = strip
        strip.locator_params(nbins=3, axis="y" if right is ax else "x")
        ax.set_ylabel("pressure (kPa)")
        ax.margins(y=0.0)
        mercury = right.secondary_yaxis("right", functions=(_mmHg, _kPa))
        mercury.set_ylabel("pressure (mmHg)")
        mercury.spines["right"].set_visible(True)
        ax.plot([], [], color=tint, label="median")
        add_legend(ax, table, probability, bands=True)
    return figure


def _mmHg(kPa: Any) -> Any:
    return kPa * MMHG_PER_KPA


def _kPa(mmHg: Any) -> Any:
    return mmHg / MMHG_PER_KPA
