"""Numbers as a figure or a page prints them: as many digits as their interval deserves.

Nothing of matplotlib is imported here.
"""

from __future__ import annotations

import math

__all__ = ["number", "range_text"]


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
