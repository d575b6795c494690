"""Machine exports as text: any usual separator, decimal comma, encoding."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.cell import DECIMAL_COMMA, number_in, one_line
from biaxbayes.specimens.raw_table import RawTable
from biaxbayes.specimens.text_file import SIGNATURES, read_bytes

__all__ = ["assemble_table", "read_raw_table"]

MAX_BYTES = 64_000_000
MAX_COLUMNS = 2_000
MAX_ROWS = 500_000
MAX_CELLS = 8_000_000
SAMPLE = 200
CONTROL_TEXT = re.compile("[\\x00-\\x08\\x0e-\\x1f\\x7f]")
DECIMAL_POINT = re.compile(r"[+-]?\d+\.\d+([eE][+-]?\d+)?")
SEPARATORS = (("\t", "tabs"), (";", "semicolons"), (",", "commas"))


def read_raw_table(path: Path, *, sheet: str | None = None) -> RawTable:
    """Read a machine export: CSV, TSV, semicolons with decimal comma, or an Excel workbook.

    Parameters
    ----------
    path : Path
    sheet : str, optional
        Sheet of a workbook; needed where more than one holds a table.

    Returns
    -------
    RawTable

    Raises
    ------
    InputError
        If the file cannot be read or holds no table with column names.
    """
    raw = read_bytes(path, limit=MAX_BYTES)
    if raw.startswith(b"PK\x03\x04"):
        from biaxbayes.specimens.workbook import read_workbook

        return read_workbook(path, raw, sheet)
    if sheet is not None:
        raise InputError("is no workbook and has no sheets", file=path, remedy="leave out --sheet")
    for signature, (kind, remedy) in SIGNATURES.items():
        if raw.startswith(signature):
            raise InputError(f"is {kind}, not a table", file=path, remedy=remedy)
    text, encoding = _decoded(raw, path)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    separator, word = _separator(lines, path)
    if len(lines) > MAX_ROWS or text.count(separator) > MAX_CELLS:
        raise InputError(
            f"has more than {MAX_ROWS:,} lines or {MAX_CELLS:,} cells",
            file=path,
            remedy="cut out the cycle of interest",
        )
    rows, numbers = _rows(lines, separator, path)
    notes = [] if encoding == "UTF-8" else [f"read as {encoding}"]
    if separator != ",":
        notes.append(f"columns separated by {word}")
    return assemble_table(path, rows, numbers, notes)


def _rows(lines: Sequence[str], separator: str, path: Path) -> tuple[list[list[str]], list[int]]:
    """Rows that are neither blank nor comments, and their lines."""
    rows: list[list[str]] = []
    numbers: list[int] = []
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    last = 0
    try:
        for cells in reader:
            if reader.line_num > last + 1:
                raise csv.Error("a quotation mark is not closed")
            last = reader.line_num
            if any(cell.strip() for cell in cells) and not cells[0].startswith("#"):
                rows.append(cells)
                numbers.append(last)
    except csv.Error as error:
        raise InputError(
            f"not a row of a table: {error}",
            file=path,
            row=last + 1,
            remedy="look for a stray quotation mark",
        ) from None
    return rows, numbers


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
            # Instrument software on Windows writes its own code page; only names hold such
            # letters.
            text, encoding = raw.decode("cp1252", errors="replace"), "Windows-1252"
    found = CONTROL_TEXT.search(text)
    if found:
        row = text[: found.start()].count("\n") + 1
        raise InputError("is binary, not text", file=path, row=row, remedy="export it as CSV")
    return text, encoding


def _separator(lines: Sequence[str], path: Path) -> tuple[str, str]:
    """The separator that cuts most lines into the same number of cells."""
    sample = [line for line in lines if line.strip() and not line.startswith("#")][:SAMPLE]
    for separator, word in SEPARATORS:
        counts = Counter(line.count(separator) for line in sample)
        count, often = counts.most_common(1)[0] if counts else (0, 0)
        # A decimal comma cuts as evenly as a separator does: commas are asked last.
        if count >= 1 and often >= 0.6 * len(sample):
            return separator, word
    shown = sample[0].strip()[:60] if sample else ""
    raise InputError(
        f"holds no table with columns; its first line reads {shown!r}",
        file=path,
        remedy="export it with commas, semicolons or tabs between the columns",
    )


def assemble_table(
    path: Path,
    rows: list[list[str]],
    numbers: list[int],
    notes: Sequence[str],
    *,
    trimmed: bool = False,
) -> RawTable:
    """Find names, an optional line of units, and the body of a table.

    Parameters
    ----------
    path : Path
    rows : list of list of str
        All rows that are not blank.
    numbers : list of int
        Their lines in the file.
    notes : sequence of str
    trimmed : bool
        Whether rows lack the empty cells at their end, as those of a sheet do.

    Raises
    ------
    InputError
        If there are no names, or a row has other cells than there are names.
    """
    start = _line_of_names(path, rows, numbers)
    names = [one_line(name) for name in rows[start]]
    while names and not names[-1]:
        names.pop()
    units: dict[str, str] = {}
    body = start + 1
    if _numeric(rows[body]) == 0 and _numeric(rows[body + 1]) > 0:
        units = dict(zip(names, (cell.strip() for cell in rows[body]), strict=False))
        body += 1
    if trimmed:
        rows = [cells + [""] * (len(names) - len(cells)) for cells in rows]
    for cells, number in zip(rows[body:], numbers[body:], strict=True):
        if len(cells) < len(names) or any(cell.strip() for cell in cells[len(names) :]):
            raise InputError(
                f"{len(cells)} cells where the columns are {len(names)}",
                file=path,
                row=number,
                remedy="the file may be cut off here, or holds more than one table",
            )
    columns = tuple(tuple(cells[i] for cells in rows[body:]) for i in range(len(names)))
    comma = _decimal_comma(rows[body : body + 10 * SAMPLE], path)
    if comma:
        notes = [*notes, "decimal commas"]
    return RawTable(
        path, tuple(names), columns, np.array(numbers[body:]), comma, units, tuple(notes)
    )


def _line_of_names(path: Path, rows: list[list[str]], numbers: list[int]) -> int:
    """The first row that is as wide as most rows are; what stands above is a preamble."""
    width = Counter(map(len, rows[:SAMPLE])).most_common(1)[0][0] if rows else 0
    start = next((i for i, cells in enumerate(rows) if len(cells) == width), 0)
    if width < 2 or width > MAX_COLUMNS or len(rows) < start + 3:
        raise InputError(
            f"holds no table: {len(rows)} rows, most of {width} cells",
            file=path,
            remedy="a table has a line of column names and at least two rows",
        )
    if _numeric(rows[start]) > 0:
        shown = ", ".join(rows[start])[:60]
        raise InputError(
            f"has no line of column names: {shown!r} stands in their place",
            file=path,
            row=numbers[start],
            remedy="add a line that names the columns, with their units",
        )
    return start


def _numeric(cells: Sequence[str]) -> int:
    count = 0
    for cell in cells:
        try:
            number_in(cell.replace(",", "."))
        except ValueError:
            continue
        count += 1
    return count


def _decimal_comma(rows: Sequence[Sequence[str]], path: Path) -> bool:
    commas = points = 0
    for cells in rows:
        for cell in cells:
            stripped = cell.strip()
            commas += DECIMAL_COMMA.fullmatch(stripped) is not None
            points += DECIMAL_POINT.fullmatch(stripped) is not None
    if commas and points:
        raise InputError(
            "mixes decimal commas and decimal points (or has thousands separators)",
            file=path,
            remedy="export it with one of them and no thousands separators",
        )
    return commas > 0
