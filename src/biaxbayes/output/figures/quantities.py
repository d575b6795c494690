"""How the quantities of a draw are called on an axis, and where physics ends them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.output.style import plain

__all__ = ["MEAN", "Quantity", "corner_columns", "quantity"]

MEAN = r"\bar{\lambda}"
"""Symbol of a mean over the mounted states."""


@dataclass(frozen=True)
class Quantity:
    """One axis of a figure.

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


_POSITIVE = (0.0, np.inf)


def _known(unit: str) -> Mapping[str, Quantity]:
    return {
        "C1": Quantity("$C_1$", "kPa", _POSITIVE, True),
        "k1": Quantity("$k_1$", "kPa", _POSITIVE, True),
        "k2": Quantity("$k_2$", "", _POSITIVE, True),
        "alpha": Quantity(r"$\alpha$", "°", (0.0, 90.0)),
        "kappa": Quantity(r"$\kappa$", "", (0.0, 1.0 / 3.0)),
        "mounting_stretch_x": Quantity(r"$\lambda_{\mathrm{m},x}$", "", _POSITIVE),
        "mounting_stretch_y": Quantity(r"$\lambda_{\mathrm{m},y}$", "", _POSITIVE),
        "mounting_force_x": Quantity(r"$p_{0,x}$", unit),
        "mounting_force_y": Quantity(r"$p_{0,y}$", unit),
        "noise_sd": Quantity("$w$", unit, _POSITIVE, True),
        "noise_growth": Quantity("$b$", "", _POSITIVE, True),
        "edge_x": Quantity("edge $x$, relative", "", _POSITIVE),
        "edge_y": Quantity("edge $y$, relative", "", _POSITIVE),
        "thickness": Quantity("thickness, relative", "", _POSITIVE),
        "load_offset_x": Quantity("offset $x$", unit),
        "load_offset_y": Quantity("offset $y$", unit),
        "lp": Quantity("log density"),
        "log_likelihood": Quantity("log likelihood"),
    }


def quantity(name: str, unit: str = "") -> Quantity:
    """Axis of a column of the draws.

    Parameters
    ----------
    name : str
        As in ``summary.csv``; a protocol in square brackets is kept in the symbol.
    unit : str
        Unit of the specimen's loads, N or kPa.
    """
    stem, _, rest = name.partition("[")
    known = _known(unit).get(stem)
    if known is None:
        return Quantity(plain(name, 24))
    if not rest:
        return known
    symbol = f"{known.symbol} {plain(rest.removesuffix(']'), 16)}"
    return Quantity(symbol, known.unit, known.edges, known.scale)


def corner_columns(draws: pd.DataFrame) -> dict[str, tuple[Quantity, np.ndarray]]:
    """Material parameters and mounting stretches that vary, with their axes.

    Where each protocol has a mounted state of its own, the mean over them stands for all, its
    symbol under a bar: the mounting figure shows them one by one.

    Parameters
    ----------
    draws : DataFrame
        One row a draw.
    """
    out: dict[str, tuple[Quantity, np.ndarray]] = {}
    for name in ("C1", "k1", "k2", "alpha", "kappa", "mounting_stretch_x", "mounting_stretch_y"):
        q = quantity(name)
        states = [str(c) for c in draws.columns if str(c) == name or str(c).startswith(f"{name}[")]
        if not states:
            continue
        values = draws[states].to_numpy(dtype=float).mean(axis=1)
        if len(states) > 1:
            q = Quantity(q.symbol.replace(r"\lambda", MEAN), q.unit, q.edges, q.scale)
        # Constant columns are fixed parameters; a tie shows as a line and stays.
        if np.ptp(values) > 1e-12 * max(float(np.abs(values).max()), 1e-300):
            out[name] = (q, values)
    return out
