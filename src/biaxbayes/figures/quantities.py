"""Quantities as figures and pages print them: their names, where physics ends them, their digits.

A number has as many digits as its interval deserves. Nothing of matplotlib is imported here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.figures.style import plain
from biaxbayes.laws import all_parameters
from biaxbayes.parameters import MATERIAL, STRETCH, Quantities, Quantity

MEAN = r"\bar{\lambda}"
"""Symbol of a mean over the mounted states."""
OTHERS = {"lp": "log density", "log_likelihood": "log likelihood"}


@dataclass(frozen=True)
class AxisText:
    """What an axis says of its quantity.

    Attributes
    ----------
    symbol : str
        In mathematical text.
    unit : str
        Empty for pure numbers.
    edges : (float, float)
        Physical range.
    scale : bool
        Whether the quantity is a positive scale, which may need a logarithmic axis.
    """

    symbol: str
    unit: str = ""
    edges: tuple[float, float] = (-np.inf, np.inf)
    scale: bool = False

    @property
    def label(self) -> str:
        """Symbol with unit, for an axis."""
        return f"{self.symbol} ({self.unit})" if self.unit else self.symbol


def known_or_default(known: Quantities | None, unit: str = "") -> Quantities:
    """The quantities of a run; those of all laws with one mounted state if not given."""
    return known or Quantities(all_parameters(), load_unit=unit)


def axis_text(q: Quantity) -> AxisText:
    """Symbol, unit and range of a quantity; its mounted state behind the symbol."""
    p = q.parameter
    symbol = f"${p.symbol}$" if p.symbol else p.words
    if q.state:
        symbol = f"{symbol} {plain(q.state, 16)}"
    return AxisText(symbol, p.unit_symbol(q.load_unit), p.range, p.logarithmic)


def quantity(name: str, unit: str = "", known: Quantities | None = None) -> AxisText:
    """Axis of a column of the draws.

    Parameters
    ----------
    name : str
        As in ``summary.csv``; what is not known stands as it is.
    unit : str
        Unit of the specimen's loads, N or kPa.
    known : Quantities, optional
        What each name is; default those of all laws with one mounted state.
    """
    match = known_or_default(known, unit).get(name)
    if match is not None:
        return axis_text(match)
    return AxisText(OTHERS.get(name) or plain(name, 24))


def corner_columns(
    draws: pd.DataFrame, known: Quantities | None = None
) -> dict[str, tuple[AxisText, np.ndarray]]:
    """Material parameters and mounting stretches that vary, with their axes.

    Where each protocol has a mounted state of its own, the mean over them stands for all, its
    symbol under a bar: the mounting figure shows them one by one.

    Parameters
    ----------
    draws : DataFrame
        One row a draw.
    known : Quantities, optional
        What each name is; default those of all laws with one mounted state.
    """
    out: dict[str, tuple[AxisText, np.ndarray]] = {}
    judged = known_or_default(known).of_kind(MATERIAL, STRETCH)
    for p in dict.fromkeys(q.parameter for q in judged):
        states = [q.name for q in judged if q.parameter == p and q.name in draws]
        if not states:
            continue
        values = draws[states].to_numpy(dtype=float).mean(axis=1)
        shown = axis_text(Quantity(p))
        if len(states) > 1:
            mean = shown.symbol.replace(r"\lambda", MEAN)
            shown = AxisText(mean, shown.unit, shown.edges, shown.scale)
        # Constant columns are fixed parameters; a tie shows as a line and stays.
        if np.ptp(values) > 1e-12 * max(float(np.abs(values).max()), 1e-300):
            out[p.name] = (shown, values)
    return out


# --- numbers, with as many digits as their interval deserves -------------------------------------


def number(value: float, low: float, high: float, *, log: bool = False) -> str:
    """A value with two digits of the width of its interval.

    Parameters
    ----------
    value, low, high : float
        The value and its interval.
    log : bool
        Two significant digits of the value itself, for quantities that span decades.
    """
    width = abs(high - low)
    if log or not (width > 0.0 and math.isfinite(width)):
        text = f"{value:.{2 if log else 4}g}"
        return _signed(f"{float(text):g}" if 1e-3 <= abs(value) < 1e5 else text)
    digits = 1 - math.floor(math.log10(width))
    if digits > 8 or digits < -4:
        return _signed(f"{value:.4g}")
    return _signed(f"{round(value, digits):.{max(digits, 0)}f}")


def range_text(low: float, high: float, piled: tuple[bool, bool], *, log: bool = False) -> str:
    """An interval; one-sided where the draws pile up at its (low, high) end."""
    first, last = (number(v, low, high, log=log) for v in (low, high))
    if piled == (True, False):
        return f"< {last}"
    if piled == (False, True):
        return f"> {first}"
    return f"{first}–{last}"


def _signed(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}")
