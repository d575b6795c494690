"""Few ticks with labels that cannot run into each other, for panels of a known size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.findings.bounded_density import Span
from biaxbayes.output.figures.lettering import POINT_MM, text_width

if TYPE_CHECKING:
    from matplotlib.axis import Axis

__all__ = ["Ticks", "choose_ticks", "set_ticks"]


@dataclass(frozen=True)
class Ticks:
    """Values and labels of one axis.

    Attributes
    ----------
    values : ndarray
    texts : list of str
    upright : bool
        Whether the labels of a horizontal axis have to be turned by 90 degrees.
    extent : float
        Room the labels take away from the axis, mm.
    """

    values: np.ndarray
    texts: list[str]
    upright: bool
    extent: float


def choose_ticks(
    shown: Span,
    side_mm: float,
    points: float,
    *,
    horizontal: bool,
    overhang: float = 0.0,
    most: int = 3,
) -> Ticks:
    """A few round values whose labels fit.

    Parameters
    ----------
    shown : Span
        What the axis shows.
    side_mm : float
        Length of the axis in print.
    points : float
        Font size.
    horizontal : bool
        Labels stand side by side; turned by 90 degrees where fewer than two fit.
    overhang : float
        How far a label may stand beyond the end of the axis, mm.
    most : int
        Largest number of values.
    """
    height = points * POINT_MM
    candidates = [(v, _texts(v, log=shown.log)) for v in _candidates(shown)]
    best: tuple[np.ndarray, list[str]] | None = None
    for turned in (False, True) if horizontal else (True,):
        for every in range(1, 10):
            for values, texts in candidates:
                widest = max((text_width(t, points) for t in texts), default=0.0)
                size, apart = (height, 0.3 * height) if turned else (widest, 0.6 * height)
                places = shown.forward(values) * side_mm
                inset = max(0.5 * size - overhang, 0.0)
                inner = (places >= inset - 1e-9) & (places <= side_mm - inset + 1e-9)
                picked = _spread(places[inner], every, size + apart, most)
                if picked is not None and (best is None or len(picked) > len(best[0])):
                    best = values[inner][picked], _texts(values[inner][picked], log=shown.log)
                    if every > 1:
                        break  # ever finer steps would only make the values less round
            if best is not None:
                break
        if best is not None:
            break
    if best is None:
        values = shown.back(np.array([0.5]))
        best = values, [f"{values[0]:.3g}"]
    widest = max(text_width(t, points) for t in best[1])
    upright = horizontal and turned
    return Ticks(*best, upright, height if horizontal and not turned else widest)


def set_ticks(axis: Axis, ticks: Ticks, *, labels: bool) -> None:
    """Put ticks on an axis, with or without their labels."""
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

    axis.set_major_locator(FixedLocator([float(v) for v in ticks.values]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FixedFormatter(ticks.texts if labels else [""] * len(ticks.texts)))
    if labels and ticks.upright:
        axis.set_tick_params(labelrotation=90.0)


def _spread(places: np.ndarray, every: int, need: float, most: int) -> np.ndarray | None:
    """Indices of two to ``most`` places, every so many, if they keep their distance."""
    if len(places) <= every:
        return None
    picked = np.arange((len(places) - 1) % every // 2, len(places), every)
    if len(picked) > most or np.diff(places[picked]).min() < need:
        return None
    return picked


def _candidates(shown: Span) -> Iterator[np.ndarray]:
    """Round values inside a span, the roundest first."""
    if shown.log:
        low, high = np.log10([shown.low, shown.high])
        powers = 10.0 ** np.arange(np.floor(low), np.ceil(high) + 1)
        sets = [powers, np.outer(powers, [1.0, 3.0]).ravel(), np.outer(powers, [1, 2, 5]).ravel()]
        if shown.high < 20.0 * shown.low:
            sets.append(np.outer(powers, np.arange(1, 10)).ravel())
        for values in sets:
            yield values[(values >= shown.low) & (values <= shown.high)]
        return
    size = shown.high - shown.low
    magnitude = 10.0 ** np.floor(np.log10(size))
    for step in np.outer([1.0, 0.1, 0.01], [5.0, 2.0, 1.0]).ravel() * magnitude:
        first, last = np.ceil(shown.low / step - 1e-9), np.floor(shown.high / step + 1e-9)
        yield np.arange(first, last + 1) * step + 0.0  # no negative zero


def _texts(values: np.ndarray, *, log: bool) -> list[str]:
    """Labels with as many digits as tell the values apart."""
    if not len(values):
        return []
    largest = float(np.abs(values).max())
    if log:
        return [f"{v:g}" if 1e-3 <= v < 1e4 else _power(v) for v in values]
    if largest >= 1e5 or 0.0 < largest < 1e-4:
        texts = [f"{v:g}" for v in values]
    else:
        for digits in range(12):
            texts = [f"{v:.{digits}f}" for v in values]
            if all(abs(float(t) - v) <= 1e-9 * largest for t, v in zip(texts, values, strict=True)):
                break
    return [t.replace("-", "\N{MINUS SIGN}") for t in texts]


def _power(value: float) -> str:
    """A value as a multiple of a power of ten, in mathematical text."""
    exponent = int(np.floor(np.log10(value) + 1e-9))
    lead = f"{value / 10.0**exponent:.3g}"
    return ("$" if lead == "1" else rf"${lead}\cdot") + f"10^{{{exponent}}}$"
