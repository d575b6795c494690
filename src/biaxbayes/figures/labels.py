"""Labels of figures: texts that fit, ticks that keep apart.

Widths are those of matplotlib's own typesetting. Its locators take every tick label for three times
as wide as high, which in panels of a centimetre lets labels such as 0.995 run into each other and
into the next panel; :class:`FewTicks` asks for the labels' widths instead.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.ticker import Formatter, Locator, NullFormatter, NullLocator

from biaxbayes.figures.style import MM, font_points, plain

POINT_MM = 1.0 / 72.0 / MM


# --- texts that fit ------------------------------------------------------------------------------


def text_mm(text: str, points: float) -> float:
    """Width of a line in the font of the style, mm."""
    import matplotlib as mpl

    return _width(text, points, tuple(mpl.rcParams["font.family"]))


@lru_cache(4096)
def _width(text: str, points: float, family: tuple[str, ...]) -> float:
    from matplotlib.cbook import is_math_text
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    mathematics = is_math_text(text)
    shown = text if mathematics else text.replace(r"\$", "$")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        font = FontProperties(family=list(family), size=points)
        width, _, _ = text_to_path.get_text_width_height_descent(shown, font, mathematics)
    return float(width) * POINT_MM


def shortened(text: object, width_mm: float, points: float) -> str:
    """A text from a file, made safe to draw and cut to a width."""
    for length in range(60, 2, -1):
        line = plain(text, length)
        if text_mm(line, points) <= width_mm:
            return line
    return plain(text, 2)


# --- ticks that keep apart -----------------------------------------------------------------------


def few_ticks(axis: Any, *, most: int = 3, overhang: float = 0.0, upright: bool = False) -> None:
    """Give an axis a few ticks at round values, labels in full, none over another.

    Parameters
    ----------
    axis : matplotlib.axis.Axis
    most : int
        Largest number of ticks; of 0 also their labels and minor ticks go.
    overhang : float
        How far a label may stand beyond the end of the axis, mm.
    upright : bool
        Whether the labels of a horizontal axis are turned by 90 degrees.
    """
    across = axis.axis_name == "x"
    points = font_points(f"{axis.axis_name}tick.labelsize")
    if most == 0:
        axis.set_major_locator(NullLocator())
        axis.set_minor_locator(NullLocator())
        return
    axis.set_major_locator(FewTicks(most, points, overhang, turned=upright or not across))
    axis.set_major_formatter(PlainNumbers())
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())
    axis.set_tick_params(labelrotation=90.0 if upright and across else 0.0)


class FewTicks(Locator):
    """Two to ``most`` round values whose labels fit, or one where no two do.

    Parameters
    ----------
    most : int
    points : float
        Font size of the labels.
    overhang : float
        How far a label may stand beyond the end of the axis, mm.
    turned : bool
        Whether the height of a label has to fit, not its width.
    """

    axis: Any

    def __init__(self, most: int, points: float, overhang: float, *, turned: bool) -> None:
        self.most, self.points, self.overhang, self.turned = most, points, overhang, turned

    def __call__(self) -> Any:
        """Values in the view of the axis."""
        return self.tick_values(*sorted(self.axis.get_view_interval()))

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Values between two ends."""
        axes, across = self.axis.axes, self.axis.axis_name == "x"
        length = (axes.bbox.width if across else axes.bbox.height) / axes.figure.dpi / MM
        shown = (float(vmin), float(vmax), self.axis.get_scale() == "log")
        return _choose(shown, round(length, 3), self.most, self.points, self.overhang, self.turned)


MOST_OF_STEP = 4
"""Values in a range, over the ticks to be had of them, beyond which no label is measured."""


@lru_cache(1024)
def _choose(
    shown: tuple[float, float, bool],
    length: float,
    most: int,
    points: float,
    overhang: float,
    turned: bool,
) -> np.ndarray:
    """The most values whose labels fit, the roundest of these; of finer steps every so many."""
    low, high, log = shown
    move = np.log if log else np.asarray
    height = points * POINT_MM
    best: np.ndarray = np.array([])
    for every in range(1, 10):
        for values in _powers(low, high) if log else _round(low, high):
            if len(values) > MOST_OF_STEP * every * most:
                continue  # labels at either end that do not fit are never so many
            texts = plain_numbers(values, log=log)
            widths = np.array([height if turned else text_mm(t, points) for t in texts])
            places = (move(values) - move(low)) / (move(high) - move(low)) * length
            inset = np.maximum(0.5 * widths - overhang, 0.0)
            inner = np.flatnonzero((places > inset - 1e-6) & (places < length - inset + 1e-6))
            picked = inner[max(len(inner) - 1, 0) % every // 2 :: every]
            if not max(len(best), 1) < len(picked) <= most:
                continue
            apart = np.diff(places[picked]) - 0.5 * (widths[picked][1:] + widths[picked][:-1])
            if apart.min() >= (0.3 if turned else 0.6) * height:
                best = values[picked]
                if every > 1:
                    break  # finer steps are less round
        if len(best):
            return best
    return np.array([float(f"{np.sqrt(low * high) if log else 0.5 * (low + high):.3g}")])


class PlainNumbers(Formatter):
    """Labels with as many digits as tell the values apart."""

    axis: Any

    def __call__(self, x: float, pos: int | None = None) -> str:
        """One value alone."""
        return plain_numbers(np.array([x]), log=True)[0]

    def format_ticks(self, values: list[float]) -> list[str]:
        """All values of an axis, with the same digits."""
        return plain_numbers(np.asarray(values, float), log=self.axis.get_scale() == "log")


def _round(low: float, high: float) -> Iterator[np.ndarray]:
    """Round values inside a range, the roundest first."""
    magnitude = 10.0 ** np.floor(np.log10(high - low))
    for step in np.outer([1.0, 0.1, 0.01], [5.0, 2.0, 1.0]).ravel() * magnitude:
        first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
        yield np.arange(first, last + 1) * step


def _powers(low: float, high: float) -> Iterator[np.ndarray]:
    """Round values inside a positive range, the roundest first."""
    powers = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    sets = [powers, np.outer(powers, [1.0, 3.0]).ravel(), np.outer(powers, [1, 2, 5]).ravel()]
    if high < 20.0 * low:
        sets.append(np.outer(powers, np.arange(1, 10)).ravel())
    for values in sets:
        yield values[(values >= low) & (values <= high)]


def plain_numbers(values: np.ndarray, *, log: bool) -> list[str]:
    """Labels with as many digits as tell the values apart; decades on a logarithmic axis."""
    largest = float(np.abs(values).max()) if len(values) else 0.0
    values = np.where(np.abs(values) <= 1e-12 * largest, 0.0, values)  # no negative zero
    if log:
        texts = [f"{v:g}" if 1e-3 <= v < 1e4 else _power(v) for v in values]
    elif largest >= 1e5 or 0.0 < largest < 1e-4:
        texts = [f"{v:g}" for v in values]
    else:
        for digits in range(12):
            texts = [f"{v:.{digits}f}" for v in values]
            if all(abs(float(t) - v) <= 1e-9 * largest for t, v in zip(texts, values, strict=True)):
                break
    return [t.replace("-", "\N{MINUS SIGN}") if "$" not in t else t for t in texts]


def _power(value: float) -> str:
    """A value as a multiple of a power of ten, in mathematical text."""
    exponent = int(np.floor(np.log10(value) + 1e-9))
    lead = f"{value / 10.0**exponent:.3g}"
    return ("$" if lead == "1" else rf"${lead}\cdot") + f"10^{{{exponent}}}$"
