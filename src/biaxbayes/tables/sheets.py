"""A file of any format as sheets of text cells, read with limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from biaxbayes.errors import InputError, printable
from biaxbayes.text_files import SIGNATURES, read_bytes

MAX_BYTES = 64_000_000
MAX_ROWS = 500_000
MAX_CELLS = 8_000_000
MAX_UNPACKED = 200_000_000
"""Bytes of what a compressed file holds."""


@dataclass(frozen=True)
class Sheet:
    """Rows of text cells.

    Attributes
    ----------
    rows : list of list of str
        Those that are neither blank nor comments.
    lines : list of int
        Line of the file (row of the sheet) of each, from 1.
    notes : list of str
        How the file was read.
    names : list of str
        Column names that stand in a comment line, as NumPy writes them.
    text : bool
        Whether cells were cut from lines of text, where a short row may be a file cut off.
    """

    rows: list[list[str]]
    lines: list[int]
    notes: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    text: bool = False


READERS = (
    (b"PK\x03\x04", "workbook"),
    (b"\xd0\xcf\x11\xe0", "workbook"),
    (b"MATLAB 5.0 MAT-file", "matlab"),
    (b"MATLAB 7.3 MAT-file", "matlab"),
    (b"TDSm", "tdms"),
)
"""First bytes of a file, and the module that reads it; anything else is text."""


def read_sheets(path: Path) -> dict[str, Sheet]:
    """Sheets of a file by name; a text file has one without a name.

    Raises
    ------
    InputError
        If the file cannot be read, is too large when unpacked, or a package is missing.
    """
    raw = read_bytes(path, limit=MAX_BYTES)
    module = next((name for first, name in READERS if raw.startswith(first)), "text")
    if module == "text":
        for signature, (kind, remedy) in SIGNATURES.items():
            if raw.startswith(signature):
                raise InputError(f"is {kind}, not a table", file=path, remedy=remedy)
    return import_module(f"biaxbayes.tables.{module}").sheets(raw, path)


def sheet_of(values: Sequence[Sequence[object]], note: str) -> Sheet:
    """A sheet from rows of values, as typed formats hold them."""
    rows, lines = [], []
    for number, row in enumerate(values, start=1):
        cells = [cell_text(value) for value in row]
        while cells and not cells[-1].strip():
            cells.pop()
        if cells and not cells[0].startswith("#"):
            rows.append(cells)
            lines.append(number)
    return Sheet(rows, lines, [note])


def cell_text(value: object) -> str:
    """A value as a text cell; numbers with the digits that read back the same."""
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return "" if value is None else printable(str(value))


def too_large(what: str, path: Path) -> InputError:
    """The refusal of a file that would take too much memory."""
    return InputError(what, file=path, remedy="save the rows of the test as CSV")
