"""Tables as comma-separated text: one reader for the files of others, one writer for our own.

Specimens, paths of stretches and machine exports are read row by row with the csv module. Pandas
was tried: it tells neither the line of a bad cell nor a missing cell from an empty one; as text
it takes 1.2 times as long for 50,000 rows and 3 times for 500,000, half a second of import comes
before any refusal, and its own numbers differ in the last digit between its versions.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.text_files import atomic_write_text

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "DECIMAL_COMMA",
    "bad_cell",
    "cells_of",
    "csv_text",
    "fault_of",
    "number_in",
    "one_line",
    "read_csv",
    "rows_of",
    "rows_text",
    "write_csv",
]


# --- one cell: its number, or why it is none ----------------------------------------------------


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


def bad_cell(text: str, path: Path, row: int, column: str) -> InputError:
    """The refusal of a cell that holds no finite number."""
    problem, remedy = fault_of(text)
    return InputError(problem, file=path, row=row, column=column, remedy=remedy)


def one_line(text: str) -> str:
    """Text of a name: printable, in one line, with single spaces, none at the ends."""
    return " ".join("".join(ch if ch.isprintable() else " " for ch in text).split())


# --- rows of cells ------------------------------------------------------------------------------


def cells_of(line: str) -> list[str]:
    """Cells of a single line; spaces before a cell are no part of it."""
    return next(csv.reader([line], skipinitialspace=True), [])


def rows_of(
    lines: Sequence[str],
    path: Path,
    *,
    first: int = 0,
    separator: str = ",",
    of: str = "a CSV",
) -> Iterator[tuple[int, list[str]]]:
    """Number of each line, from 1 as an editor counts, and its cells.

    Parameters
    ----------
    lines : sequence of str
        All lines of the file.
    path : Path
        For messages.
    first : int
        Index of the line to start from.
    separator : str
    of : str
        What the file should be, for messages.

    Raises
    ------
    InputError
        For a line that is no row, such as one with an open quotation mark.
    """
    # Lines that the csv module took together had a quotation mark open between them.
    number = first
    reader = csv.reader(islice(lines, first, None), delimiter=separator, skipinitialspace=True)
    try:
        for cells in reader:
            if first + reader.line_num > number + 1:
                raise csv.Error("a quotation mark is not closed")
            number += 1
            yield number, cells
    except csv.Error as error:
        raise InputError(
            f"not a row of {of}: {error}",
            file=path,
            row=number + 1,
            remedy="look for a stray quotation mark",
        ) from None


# --- reading a table that this program wrote -----------------------------------------------------


def read_csv(path: Path, **how: Any) -> pd.DataFrame:
    """A table of this program; lines of comment before the names, as it once wrote, are left out.

    Parameters
    ----------
    path : Path
    **how
        As for :func:`pandas.read_csv`.
    """
    import pandas as pd

    with path.open(encoding="utf-8") as lines:
        head = sum(1 for _ in takewhile(lambda line: line.startswith("#"), lines))
    return pd.read_csv(path, skiprows=head, **how)


# --- writing ------------------------------------------------------------------------------------


def rows_text(rows: Iterable[Sequence]) -> str:
    """Rows as CSV text; numbers with the digits that read back the same."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def csv_text(table: pd.DataFrame, *, digits: int | None = None, quoted: bool = False) -> str:
    r"""A table as CSV text with column names, without an index, with ``\n`` at the line ends.

    Parameters
    ----------
    table : DataFrame
    digits : int, optional
        Significant digits of floating-point numbers; as many as read back the same without it.
    quoted : bool
        Whether text stands in quotation marks.
    """
    return table.to_csv(
        index=False,
        float_format=None if digits is None else f"%.{digits}g",
        quoting=csv.QUOTE_NONNUMERIC if quoted else csv.QUOTE_MINIMAL,
        lineterminator="\n",
    )


def write_csv(path: Path, table: pd.DataFrame, *, digits: int | None = None) -> None:
    """Write :func:`csv_text` so that the name never shows half a file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    atomic_write_text(path, csv_text(table, digits=digits))
