"""A file of any format as sheets of text cells; text files are read here."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from biaxbayes.errors import InputError, printable
from biaxbayes.text_files import SIGNATURES, is_number, read_bytes, rows_of, without_empty_end

MAX_WORKBOOK_BYTES = 64_000_000
MAX_ROWS = 500_000
MAX_CELLS = 8_000_000
MAX_UNPACKED = 200_000_000
"""Bytes of the contents of a compressed file."""
CONTROL_CHARACTERS = re.compile("[\\x00-\\x08\\x0e-\\x1f\\x7f]")
SEPARATORS = {"\t": "tabs", ";": "semicolons", "|": "bars", " ": "spaces", ",": "commas"}
SEPARATOR_LINES = 200
"""Lines at the end of the file from which its separator is read; a preamble is at the start."""


@dataclass(frozen=True)
class Sheet:
    """Rows of text cells without blank lines and comments."""

    rows: list[list[str]]
    lines: list[int]  # of the file, or rows of the sheet, from 1
    notes: list[str] = field(default_factory=list)  # how the file was read
    # column names from a comment line, as NumPy writes them
    names: list[str] = field(default_factory=list)
    hidden: list[int] = field(default_factory=list)  # lines of hidden or filtered rows
    text: bool = False  # cut from lines of text, where a short row may be a truncated file


class Reader(NamedTuple):
    """A module of this package that reads a format, and the words of its refusals."""

    module: str
    kind: str
    damaged: str  # what to do with a damaged file
    package: str
    without: str  # what to do without the package


WORKBOOK = Reader(
    "workbook",
    "workbook",
    "save it again as .xlsx, or as CSV",
    "python-calamine",
    "save the sheet as CSV",
)
MATLAB = Reader(
    "matlab", "MATLAB file", "save it again, or write the table as CSV", "h5py", "write it as CSV"
)
TDMS = Reader("tdms", "LabVIEW TDMS file", "export it as CSV", "npTDMS", "export it as CSV")
READERS = {
    b"PK\x03\x04": WORKBOOK,
    b"\xd0\xcf\x11\xe0": WORKBOOK,
    b"MATLAB 5.0 MAT-file": MATLAB,
    b"MATLAB 7.3 MAT-file": MATLAB,
    b"TDSm": TDMS,
}
"""Readers by the first bytes of a file; anything else is text."""


def read_sheets(path: Path) -> dict[str, Sheet]:
    """Sheets of a file by name; a text file has one without a name."""
    raw = read_bytes(path, limit=MAX_WORKBOOK_BYTES)
    reader = next((r for first, r in READERS.items() if raw.startswith(first)), None)
    if reader is None:
        for signature, (kind, remedy) in SIGNATURES.items():
            if raw.startswith(signature):
                raise InputError(f"is {kind}, not a table", file=path, remedy=remedy)
        return {"": _text_sheet(raw, path)}
    try:
        return import_module(f"biaxbayes.tables.{reader.module}").sheets(raw, path)
    except (InputError, KeyboardInterrupt, SystemExit):
        raise
    except ImportError:
        problem = f"is a {reader.kind}, and {reader.package} is not installed"
        remedy = f"pip install 'biaxbayes[tables]', or {reader.without}"
        raise InputError(problem, file=path, remedy=remedy) from None
    except BaseException as error:  # a damaged file fails in many ways; a panic of Rust is one
        problem = f"is not a readable {reader.kind} ({type(error).__name__})"
        raise InputError(problem, file=path, remedy=reader.damaged) from None


def sheet_from(values: Sequence[Sequence[object]], note: str) -> Sheet:
    """A sheet from rows of values, as typed formats hold them."""
    rows, lines = [], []
    for number, row in enumerate(values, start=1):
        cells = without_empty_end([_cell_text(value) for value in row])
        if cells and not cells[0].startswith("#"):
            rows.append(cells)
            lines.append(number)
    return Sheet(rows, lines, [note])


def _cell_text(value: object) -> str:
    """A value as a text cell; numbers with the digits that read back the same."""
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return "" if value is None else printable(str(value))


def too_large(what: str, path: Path) -> InputError:
    """Error for a file that would take too much memory."""
    return InputError(what, file=path, remedy="save the rows of the test as CSV")


# --- text files -----------------------------------------------------------------------------------


def _text_sheet(raw: bytes, path: Path) -> Sheet:
    """The cells of a text file in any usual separator and encoding."""
    text, encoding = _decoded(raw, path)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    separator = _separator(lines, path)
    if len(lines) > MAX_ROWS or text.count(separator) > MAX_CELLS:
        problem = f"has more than {MAX_ROWS:,} lines or {MAX_CELLS:,} cells"
        raise InputError(problem, file=path, remedy="cut out the cycle of interest")
    if separator == " ":
        lines = ["\t".join(line.split()) for line in lines]
    sheet = Sheet([], [], [] if encoding == "UTF-8" else [f"read as {encoding}"], text=True)
    if separator != ",":
        sheet.notes.append(f"columns separated by {SEPARATORS[separator]}")
    cut = "\t" if separator == " " else separator
    for number, cells in rows_of(lines, path, separator=cut, kind="a table"):
        if cells and cells[0].startswith("#"):
            first = cells[0].lstrip("#").strip()
            if not sheet.rows:
                sheet.names[:] = [first, *cells[1:]] if first else cells[1:]
        elif "".join(cells).strip():
            sheet.rows.append(cells)
            sheet.lines.append(number)
    return sheet


def _decoded(raw: bytes, path: Path) -> tuple[str, str]:
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            text, encoding = raw.decode("utf-16"), "UTF-16"
        except UnicodeDecodeError:
            raise InputError(
                "is damaged UTF-16 text", file=path, remedy="export it again"
            ) from None
    else:
        try:
            text, encoding = raw.decode("utf-8-sig"), "UTF-8"
        except UnicodeDecodeError:
            # Instrument software on Windows writes its own code page, in names only.
            text, encoding = raw.decode("cp1252", errors="replace"), "Windows-1252"
    control = CONTROL_CHARACTERS.search(text)
    if control:
        row = text[: control.start()].count("\n") + 1
        raise InputError("is binary, not text", file=path, row=row, remedy="export it as CSV")
    return text, encoding


def _separator(lines: Sequence[str], path: Path) -> str:
    """The separator that cuts most lines into the same number of cells."""
    sample = [line for line in lines if line.strip() and not line.startswith("#")][
        -SEPARATOR_LINES:
    ]
    for separator in SEPARATORS:
        if separator == " ":
            # Only where all is numbers: decimal commas between spaces look like separators.
            cells = (line.split() for line in sample)
            counts = Counter(len(c) - 1 for c in cells if len(c) > 1 and all(map(is_number, c)))
        else:
            counts = Counter(line.count(separator) for line in sample)
        count, often = counts.most_common(1)[0] if counts else (0, 0)
        if count >= 1 and often >= 0.6 * len(sample):
            return separator
    counts = Counter(len(line.split()) for line in sample)
    count, often = counts.most_common(1)[0] if counts else (0, 0)
    if count >= 2 and often >= 0.6 * len(sample) and any(map(is_number, sample[-1].split())):
        return " "
    shown = sample[0].strip()[:60] if sample else ""
    problem = f"holds no table with columns; its first line reads {shown!r}"
    remedy = "export it with commas, semicolons or tabs between the columns"
    raise InputError(problem, file=path, remedy=remedy)
