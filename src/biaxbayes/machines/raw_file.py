"""Machine exports from disk: text in any usual separator, decimal comma and encoding; workbooks.

Workbooks (.xlsx) need the optional package openpyxl.
"""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from biaxbayes.errors import InputError, printable
from biaxbayes.machines.raw_table import SAMPLE, RawTable, assembled_table, is_numeric
from biaxbayes.text_files import SIGNATURES, read_bytes, rows_of

__all__ = ["ALL_SHEETS", "read_raw_tables"]

ALL_SHEETS = "all"

MAX_BYTES = 64_000_000
MAX_ROWS = 500_000
MAX_CELLS = 8_000_000
MAX_UNPACKED = 400_000_000
MAX_SHEET_CELLS = 4_000_000
CONTROL_TEXT = re.compile("[\\x00-\\x08\\x0e-\\x1f\\x7f]")
SEPARATORS = (("\t", "tabs"), (";", "semicolons"), (",", "commas"))


def read_raw_tables(path: Path, sheets: Sequence[str] = ()) -> dict[str, RawTable]:
    """Read a machine export: CSV, TSV, semicolons with decimal comma, or an Excel workbook.

    Parameters
    ----------
    path : Path
    sheets : sequence of str
        Sheets of a workbook, or ``all``; needed where more than one holds a table.

    Returns
    -------
    dict of RawTable
        By the name of the sheet, in the order asked for; text has one without a name.

    Raises
    ------
    InputError
        If the file cannot be read or holds no table with column names.
    """
    raw = read_bytes(path, limit=MAX_BYTES)
    if raw.startswith(b"PK\x03\x04"):
        return _read_workbook(path, raw, sheets)
    if sheets:
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
    if separator == " ":
        lines, separator = ["\t".join(line.split()) for line in lines], "\t"
    rows: list[list[str]] = []  # neither blank nor comments
    numbers: list[int] = []
    names: tuple[int, list[str]] | None = None
    for number, cells in rows_of(lines, path, separator=separator, of="a table"):
        if cells and cells[0].startswith("#"):
            names = (number, _uncommented(cells)) if not rows else names
        elif "".join(cells).strip():
            rows.append(cells)
            numbers.append(number)
    if names is not None and rows and len(names[1]) == len(rows[0]) and is_numeric(rows[0]):
        # As numpy.savetxt writes it: the names are a comment
        rows.insert(0, names[1])
        numbers.insert(0, names[0])
    notes = [] if encoding == "UTF-8" else [f"read as {encoding}"]
    if separator != ",":
        notes.append(f"columns separated by {word}")
    return {"": assembled_table(path, rows, numbers, notes)}


def _uncommented(cells: Sequence[str]) -> list[str]:
    """Cells of a comment line without its mark, which may stand alone."""
    first = cells[0].lstrip("#").strip()
    return [first, *cells[1:]] if first else list(cells[1:])


# --- text ----------------------------------------------------------------------------------------


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
    counts = Counter(len(line.split()) for line in sample)
    count, often = counts.most_common(1)[0] if counts else (0, 0)
    if count >= 2 and often >= 0.6 * len(sample) and is_numeric(sample[-1].split()):
        return " ", "spaces"
    shown = sample[0].strip()[:60] if sample else ""
    raise InputError(
        f"holds no table with columns; its first line reads {shown!r}",
        file=path,
        remedy="export it with commas, semicolons or tabs between the columns",
    )


# --- workbooks -----------------------------------------------------------------------------------


def _read_workbook(path: Path, raw: bytes, sheets: Sequence[str]) -> dict[str, RawTable]:
    """Read some sheets; values only, formulas are never evaluated.

    Parameters
    ----------
    path : Path
        For messages.
    raw : bytes
        Content of the file.
    sheets : sequence of str
        Needed where more than one sheet holds cells.

    Raises
    ------
    InputError
        If openpyxl is missing, the file is damaged, or the sheet is not clear.
    """
    try:
        import openpyxl
    except ImportError:
        raise InputError(
            "is an Excel workbook, and openpyxl is not installed",
            file=path,
            remedy="pip install 'biaxbayes[xlsx]', or save the sheet as CSV",
        ) from None
    wanted = () if tuple(sheets) == (ALL_SHEETS,) else tuple(sheets)
    names, tables = _sheets(openpyxl, path, raw, wanted)
    for sheet in wanted:
        if sheet not in names:
            raise InputError(
                f"no sheet {sheet[:40]!r}", file=path, remedy=f"found {', '.join(names)}"
            )
        if wanted.count(sheet) > 1:
            raise InputError(f"sheet {sheet[:40]!r} is given twice", file=path, remedy="keep one")
    filled = {name: tables[name] for name in wanted or tables if len(tables[name]) > 2}
    empty = [name for name in wanted if name not in filled]
    if not filled or empty or (len(filled) > 1 and not sheets):
        told = "no sheet holds" if not filled else "more than one sheet holds"
        raise InputError(
            f"sheet {empty[0][:40]!r} holds no table" if empty else f"{told} a table",
            file=path,
            remedy=f"choose with --sheet, once for each protocol, or --sheet {ALL_SHEETS}; found "
            f"{', '.join(names)}",
        )
    out = {}
    for name, found in filled.items():
        numbers, rows = (list(part) for part in zip(*found, strict=True))
        out[name] = assembled_table(path, rows, numbers, [f"sheet {name}"], trimmed=True)
    return out


def _sheets(
    openpyxl: Any, path: Path, raw: bytes, wanted: Sequence[str]
) -> tuple[list[str], dict[str, list[tuple[int, list[str]]]]]:
    """Names of all sheets, and the rows of the wanted ones or of all."""
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
        if unpacked > MAX_UNPACKED:
            raise InputError(
                f"unpacks to {unpacked // 1_000_000} MB", file=path, remedy="save the sheet as CSV"
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # openpyxl warns of styles that it drops
            book = openpyxl.load_workbook(io.BytesIO(raw), read_only=True, data_only=True)
            tables = {
                name: _cells(book[name], path)
                for name in book.sheetnames
                if (not wanted or name in wanted) and hasattr(book[name], "iter_rows")
            }
            names = list(book.sheetnames)
            book.close()
    except InputError:
        raise
    except Exception as error:  # a damaged archive fails in many ways inside zipfile and openpyxl
        raise InputError(
            f"is no readable Excel workbook ({type(error).__name__})",
            file=path,
            remedy="save it again as .xlsx, or as CSV",
        ) from None
    return names, tables


def _cells(sheet: Any, path: Path) -> list[tuple[int, list[str]]]:
    """Rows of a sheet that are not blank, as text, without empty cells at their end."""
    if hasattr(sheet, "reset_dimensions"):
        sheet.reset_dimensions()  # some exporters state a wrong size
    rows: list[tuple[int, list[str]]] = []
    total = 0
    for number, values in enumerate(sheet.iter_rows(values_only=True), start=1):
        total += max(len(values), 1)
        if total > MAX_SHEET_CELLS:
            raise InputError(
                f"a sheet holds more than {MAX_SHEET_CELLS:,} cells",
                file=path,
                remedy="save the rows of the test as CSV",
            )
        cells = ["" if value is None else _text(value) for value in values]
        while cells and not cells[-1].strip():
            cells.pop()
        if cells and not cells[0].startswith("#"):
            rows.append((number, cells))
    return rows


def _text(value: object) -> str:
    text = repr(value) if isinstance(value, float) else str(value)
    return printable(text)
