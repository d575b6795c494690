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

from biaxbayes.csv_tables import rows_of
from biaxbayes.errors import InputError
from biaxbayes.machines.raw_table import SAMPLE, RawTable, assembled_table
from biaxbayes.text_files import SIGNATURES, read_bytes

__all__ = ["read_raw_table"]

MAX_BYTES = 64_000_000
MAX_ROWS = 500_000
MAX_CELLS = 8_000_000
MAX_UNPACKED = 400_000_000
MAX_SHEET_CELLS = 4_000_000
CONTROL_TEXT = re.compile("[\\x00-\\x08\\x0e-\\x1f\\x7f]")
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
        return _read_workbook(path, raw, sheet)
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
    rows, numbers = [], []  # neither blank nor comments
    for number, cells in rows_of(lines, path, separator=separator, of="a table"):
        if "".join(cells).strip() and not cells[0].startswith("#"):
            rows.append(cells)
            numbers.append(number)
    notes = [] if encoding == "UTF-8" else [f"read as {encoding}"]
    if separator != ",":
        notes.append(f"columns separated by {word}")
    return assembled_table(path, rows, numbers, notes)


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
    shown = sample[0].strip()[:60] if sample else ""
    raise InputError(
        f"holds no table with columns; its first line reads {shown!r}",
        file=path,
        remedy="export it with commas, semicolons or tabs between the columns",
    )


# --- workbooks -----------------------------------------------------------------------------------


def _read_workbook(path: Path, raw: bytes, sheet: str | None) -> RawTable:
    """Read one sheet; values only, formulas are never evaluated.

    Parameters
    ----------
    path : Path
        For messages.
    raw : bytes
        Content of the file.
    sheet : str or None
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
    names, tables = _sheets(openpyxl, path, raw, sheet)
    filled = {name: rows for name, rows in tables.items() if len(rows) > 2}
    if sheet is not None and sheet not in names:
        raise InputError(f"no sheet {sheet[:40]!r}", file=path, remedy=f"found {', '.join(names)}")
    if len(filled) != 1:
        raise InputError(
            "no sheet holds a table" if not filled else "more than one sheet holds a table",
            file=path,
            remedy=f"choose with --sheet; found {', '.join(names)}",
        )
    ((name, found),) = filled.items()
    numbers, rows = (list(part) for part in zip(*found, strict=True))
    return assembled_table(path, rows, numbers, [f"sheet {name}"], trimmed=True)


def _sheets(
    openpyxl: Any, path: Path, raw: bytes, wanted: str | None
) -> tuple[list[str], dict[str, list[tuple[int, list[str]]]]]:
    """Names of all sheets, and the rows of the wanted one or of all."""
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
                if wanted in (None, name) and hasattr(book[name], "iter_rows")
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
    return "".join(ch if ch.isprintable() else " " for ch in text)
