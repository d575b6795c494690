"""Excel workbooks (.xlsx) as raw tables; needs the optional package openpyxl."""

from __future__ import annotations

import io
import warnings
import zipfile
from pathlib import Path
from typing import Any

from biaxbayes.errors import InputError
from biaxbayes.specimens.raw_file import assemble_table
from biaxbayes.specimens.raw_table import RawTable

__all__ = ["read_workbook"]

MAX_UNPACKED = 400_000_000
MAX_CELLS = 4_000_000


def read_workbook(path: Path, raw: bytes, sheet: str | None) -> RawTable:
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
    ((name, rows),) = filled.items()
    return assemble_table(
        path,
        [cells for _, cells in rows],
        [number for number, _ in rows],
        [f"sheet {name}"],
        trimmed=True,
    )


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
        if total > MAX_CELLS:
            raise InputError(
                f"a sheet holds more than {MAX_CELLS:,} cells",
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
