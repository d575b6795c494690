"""Quantities as figures and pages print them: symbol, unit, physical range.

Pages need them without drawing, so nothing of matplotlib is imported here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from biaxbayes.identifiability.bounded_density import Span, span
from biaxbayes.laws import all_parameters
from biaxbayes.parameters import MATERIAL, STRETCH, Parameter, PieceLabels, Quantities, Quantity
from biaxbayes.report_table import truncate

MEAN = r"\bar{\lambda}"
"""Symbol of a mean over the mounted states."""
OTHERS = {"lp": "log density", "log_likelihood": "log likelihood"}
DERIVED_SYMBOLS = {"H": "$H_{0}$", "stiffness_": "$c_{{{0}{0}}}$", "cauchy_": r"$\sigma_{0}$"}
"""Symbols of derived quantities by name without the direction."""
LOG_AXIS_RATIO = 8.0
"""Ratio of the 99.5 % to the 0.5 % point above which a positive scale gets a logarithmic axis."""


class AxisText(NamedTuple):
    """Symbol, unit and range of an axis; ``scale``: may be logarithmic; its parameter, if known."""

    symbol: str
    unit: str = ""
    limits: tuple[float, float] = (-np.inf, np.inf)
    scale: bool = False
    parameter: Parameter | None = None

    @property
    def label(self) -> str:
        """Symbol with unit, for an axis."""
        return f"{self.symbol} ({self.unit})" if self.unit else self.symbol

    def is_log(self, low: float, high: float) -> bool:
        """True if an axis with values from low to high is logarithmic."""
        return bool(self.scale and low > 0.0 and high > LOG_AXIS_RATIO * low)


def plain(text: object, length: int = 40) -> str:
    """Text from a file, safe to draw: one line, at most ``length`` long, no mathematics."""
    return truncate(text, length).replace("$", r"\$")


def known_or_default(known: Quantities | None, unit: str = "") -> Quantities:
    """The quantities of a run; those of all laws with one mounted state if not given."""
    return known or Quantities(all_parameters(), [PieceLabels(load_unit=unit)])


def axis_text(q: Quantity) -> AxisText:
    """Symbol, unit and range of a quantity; its mounted state behind the symbol."""
    p = q.parameter
    symbol = f"${p.symbol}$" if p.symbol else p.words
    if q.state:
        symbol = f"{symbol} {plain(q.state, 16)}"
    return AxisText(symbol, p.unit_symbol(q.load_unit), p.range, p.logarithmic, p)


def quantity(name: str, unit: str = "", known: Quantities | None = None) -> AxisText:
    """Axis of a column of the draws, or of what follows from them, such as ``cauchy_x at 1.2``."""
    match = known_or_default(known, unit).get(name)
    if match is not None:
        return axis_text(match)
    stem, at, stretch = name.partition(" at ")
    if stem[:-1] in DERIVED_SYMBOLS:
        symbol, stress = DERIVED_SYMBOLS[stem[:-1]].format(stem[-1]), stem[:-1] != "H"
        limits = (0.0, np.inf if stress else 1.0)
        return AxisText(f"{symbol}{at}{stretch}", "kPa" if stress else "", limits, stress)
    return AxisText(OTHERS.get(name) or plain(name, 24))


def axis_span(q: AxisText, *values: np.ndarray, include: tuple[float, ...] = ()) -> Span:
    """Axis that shows the draws of one or more runs; logarithmic where a scale spreads widely."""
    low, high = np.quantile(np.concatenate(values), [0.005, 0.995])
    return span(*values, limits=q.limits, log=q.is_log(low, high), include=include)


def corner_columns(
    draws: pd.DataFrame, known: Quantities | None = None
) -> dict[str, tuple[AxisText, np.ndarray]]:
    """Parameters, and mounting stretches of the first piece (the mean over several), that vary."""
    out: dict[str, tuple[AxisText, np.ndarray]] = {}
    chosen = known_or_default(known)
    first = ("", *chosen.pieces[0].states)
    judged = [q for q in chosen.of_kind(MATERIAL, STRETCH) if q.state in first]
    for p in dict.fromkeys(q.parameter for q in judged):
        states = [q.name for q in judged if q.parameter == p and q.name in draws]
        if not states:
            continue
        values = draws[states].to_numpy(dtype=float).mean(axis=1)
        shown = axis_text(Quantity(p))
        if len(states) > 1:
            shown = shown._replace(symbol=shown.symbol.replace(r"\lambda", MEAN))
        # Constant columns are fixed parameters; a tie shows as a line and stays.
        if np.ptp(values) > 1e-12 * max(float(np.abs(values).max()), 1e-300):
            out[p.name] = (shown, values)
    return out
