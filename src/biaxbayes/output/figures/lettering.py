"""How wide a text prints, before there is anything to measure, and texts that fit."""

from __future__ import annotations

import unicodedata

from biaxbayes.output.style import plain

__all__ = ["POINT_MM", "shortened", "text_width"]

POINT_MM = 25.4 / 72.0
"""Millimetres in a point."""
# Widths of characters as shares of the font size; DejaVu Sans, which is a wide font.
_WIDTHS = (
    (".,;:!|'ijl `", 0.34),
    ('()[]{}"/\\ftrI-', 0.46),
    ("mwMW@%", 1.0),
)
_WIDTH = {character: width for characters, width in _WIDTHS for character in characters}
_UNPRINTED = str.maketrans("", "", "$^{}")


def text_width(text: str, points: float) -> float:
    """Width of a line in print, mm, rather over- than underestimated."""
    if text.startswith("$"):
        text = text.replace(r"\cdot", ".").translate(_UNPRINTED)
    return sum(map(_share, text.replace(r"\$", "$"))) * points * POINT_MM


def shortened(text: object, width_mm: float, points: float) -> str:
    """A text from a file, made safe to draw and cut to a width."""
    for length in range(60, 2, -1):
        line = plain(text, length)
        if text_width(f" {line}", points) <= width_mm:
            return line
    return plain(text, 2)


def _share(character: str) -> float:
    """Width of one character as a share of the font size."""
    known = _WIDTH.get(character)
    if known is not None:
        return known
    if unicodedata.east_asian_width(character) in "WF":
        return 1.0
    return 0.8 if character.isupper() else 0.64
