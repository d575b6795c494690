"""Rows of text cells, as any format of file becomes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from biaxbayes.errors import printable
from biaxbayes.text_files import without_empty_end

MAX_CELLS = 8_000_000
MINUS = "\u2212"
"""The minus sign of typesetters."""


@dataclass
class Worksheet:
    """Rows of text cells without blank lines and comments."""

    rows: list[list[str]]
    lines: list[int]  # of the file, or rows of the sheet, from 1
    notes: list[str] = field(default_factory=list)  # how the file was read
    # column names from a comment line, as NumPy writes them
    names: list[str] = field(default_factory=list)
    hidden: list[int] = field(default_factory=list)  # lines of hidden or filtered rows
    unseen: bool = False  # a hidden sheet
    text: bool = False  # cut from lines of text, where a short row may be a truncated file


def sheet_from(values: Sequence[Sequence[object]], note: str) -> Worksheet:
    """A sheet from rows of values, as typed formats hold them."""
    rows, lines = [], []
    for number, row in enumerate(values, start=1):
        cells = without_empty_end([_cell_text(value) for value in row])
        if cells and not cells[0].startswith("#"):
            rows.append(cells)
            lines.append(number)
    return Worksheet(rows, lines, [note])


def _cell_text(value: object) -> str:
    """A value as a text cell; numbers with the digits that read back the same."""
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return "" if value is None else printable(str(value)).replace(MINUS, "-")
