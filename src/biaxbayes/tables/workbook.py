"""Workbooks (.xlsx, .xlsb, .ods, .xls) through python-calamine; values only, no formula is run.

Calamine builds the whole rectangle of cells that a sheet spans, so what a file says of its cells
is counted first, in its own XML.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from functools import reduce
from pathlib import Path

from biaxbayes.tables.sheets import MAX_UNPACKED, Sheet, sheet_from, too_large

CELL = re.compile(rb"<(?:\w+:)?(?P<tag>row|c)(?=[\s/>])(?P<attributes>[^>]*)>")
CELL_REFERENCE = re.compile(rb'\br="([A-Z]{0,3})(\d{1,7})"')
STRING = re.compile(rb"<(?:\w+:)?si\b.*?</(?:\w+:)?si>", re.DOTALL)
ODS_CELL = re.compile(
    rb"<(?P<close>/?)table:(?P<tag>table|table-row|(?:covered-)?table-cell)(?=[\s/>])"
    rb"(?P<attributes>[^>]*)>"
)
REPEATED = re.compile(rb'number-(?:rows|columns)-repeated="(\d{1,9})"')
MAX_SHEET_CELLS = 2_000_000
EXCEL_COLUMNS = 16_384
"""Number of columns of a sheet in Excel."""
STRING_CELL = b"\xfd\x00\x0a\x00"
"""First bytes of a cell of .xls that shows a shared string."""
MAX_LABELS = 60_000


def sheets(raw: bytes, path: Path) -> dict[str, Sheet]:
    """All worksheets of a workbook."""
    import python_calamine

    if raw.startswith(b"PK"):
        _check_archive(raw, path)
    elif raw.count(STRING_CELL) > MAX_LABELS:
        raise too_large("holds too many cells of text", path)
    book = python_calamine.CalamineWorkbook.from_filelike(io.BytesIO(raw))
    by_name = {}
    for meta in book.sheets_metadata:
        if meta.typ != python_calamine.SheetTypeEnum.WorkSheet:
            continue
        sheet = book.get_sheet_by_name(meta.name)
        if sheet.total_height * sheet.total_width > MAX_SHEET_CELLS:
            raise too_large(f"sheet {meta.name[:40]!r} spans too many cells", path)
        rows = sheet.to_python(skip_empty_area=False)
        by_name[meta.name] = sheet_from(rows, f"sheet {meta.name}")
    return by_name


def _check_archive(raw: bytes, path: Path) -> None:
    """Refuse an archive whose sheets would take too much memory, from its own XML."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        unpacked = sum(member.file_size for member in archive.infolist())
        if unpacked > MAX_UNPACKED:
            raise too_large(f"unpacks to {unpacked // 1_000_000} MB", path)
        longest, shown = 0, 0
        for name in archive.namelist():
            if name.endswith("sharedStrings.xml"):
                strings = STRING.finditer(archive.read(name))
                longest = max((len(match[0]) for match in strings), default=0)
            elif "/worksheets/" in name and name.endswith(".xml"):
                xml = archive.read(name)
                if sum(xml.count(start) for start in (b"<c ", b"<c/>", b"<c>")) > MAX_SHEET_CELLS:
                    raise too_large(f"spans more than {MAX_SHEET_CELLS:,} cells", path)
                rows, columns, labels = _extent(xml, path)
                shown += labels
                if rows * columns > MAX_SHEET_CELLS:
                    raise too_large(f"spans {rows:,} rows of {columns:,} cells", path)
            elif name == "content.xml":
                for rows, columns in _ods_extents(archive.read(name)):
                    if rows * columns > MAX_SHEET_CELLS:
                        raise too_large(f"spans {rows:,} rows of {columns:,} cells", path)
        if shown * longest > MAX_UNPACKED:
            raise too_large(f"shows a text of {longest:,} letters in {shown:,} cells", path)


def _extent(xml: bytes, path: Path) -> tuple[int, int, int]:
    """Rows and columns that a sheet spans, and cells with a shared string."""
    row = column = rows = columns = labels = 0
    for match in CELL.finditer(xml):
        reference = CELL_REFERENCE.search(match["attributes"])
        if match["tag"] == b"row":
            row = int(reference[2]) if reference else row + 1
            column = 0
        else:
            column += 1
            if reference:
                row = int(reference[2])
                # letters of base 26, from A = 1
                column = reduce(lambda n, letter: 26 * n + letter - ord("A") + 1, reference[1], 0)
            labels += b't="s"' in match["attributes"]
        rows, columns = max(rows, row), max(columns, column)
        if columns > EXCEL_COLUMNS:
            raise too_large(f"has a row of more than {EXCEL_COLUMNS:,} cells", path)
    return rows, columns, labels


def _ods_extents(xml: bytes) -> Iterator[tuple[int, int]]:
    """Rows and columns that each sheet spans up to its last cell with a value."""
    row = repeat = column = rows = columns = 0
    for match in ODS_CELL.finditer(xml):
        times = REPEATED.search(match["attributes"])
        count = int(times[1]) if times else 1
        if match["tag"] == b"table":
            if match["close"]:
                yield rows, columns
            row = rows = columns = repeat = 0
        elif match["close"]:
            continue
        elif match["tag"] == b"table-row":
            row, repeat, column = row + repeat, count, 0
        else:
            column += count
            if b"value-type" in match["attributes"] or not match["attributes"].endswith(b"/"):
                rows, columns = max(rows, row + repeat), max(columns, column)
