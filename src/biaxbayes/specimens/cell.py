"""One cell of a text file: its number, or why it is none."""

from __future__ import annotations

import math
import re

__all__ = ["fault_of", "number_in", "one_line"]

DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
NUMBER_WITH_UNIT = re.compile(r"[+-]?\d+\.?\d*([eE][+-]?\d+)?\s*[^\W\d_%]*[%\w/^°]*")


def number_in(text: str) -> float:
    """The finite number that a cell holds.

    Raises
    ------
    ValueError
        If it holds anything else. Python's own reading is too generous with ``1_000``.
    """
    if "_" in text:
        raise ValueError("not a plain number")
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("not finite")
    return value


def fault_of(text: str) -> tuple[str, str]:
    """What is wrong with a cell that holds no finite number, and what to do about it."""
    cell = text.strip()
    shown = repr(cell[:40])
    if not cell:
        return "the cell is empty", "fill it in or remove the row"
    if cell.startswith("="):
        return f"{shown} is a formula, not a number", "save the values in place of formulas"
    if DECIMAL_COMMA.fullmatch(cell):
        return f"{shown} has a decimal comma", "write it with a decimal point"
    try:
        value = float(cell.replace("_", "x"))
    except ValueError:
        if NUMBER_WITH_UNIT.fullmatch(cell):
            return f"{shown} is not a plain number", "write it without unit or separators"
        return f"{shown} is not a number", "mend the value or remove the row"
    if math.isnan(value):
        return f"{shown} is not a finite number: the reading is missing", "remove the row"
    return f"{shown} is not a finite number", "mend the value or remove the row"


def one_line(text: str) -> str:
    """Text of a name: printable, in one line, with single spaces, none at the ends."""
    return " ".join("".join(ch if ch.isprintable() else " " for ch in text).split())
