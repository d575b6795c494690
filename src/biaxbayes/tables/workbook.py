"""Workbooks (.xlsx, .xlsb, .ods, .xls) through python-calamine; values only, no formula is run."""

from __future__ import annotations

import contextlib
import zipfile
from pathlib import Path

from biaxbayes.tables.worksheet import MAX_CELLS, Worksheet, sheet_from


def sheets(path: Path) -> dict[str, Worksheet]:
    """All worksheets of a workbook."""
    import python_calamine as calamine

    book = calamine.CalamineWorkbook.from_path(str(path))
    by_name, cells = {}, 0
    for meta in book.sheets_metadata:
        if meta.typ == calamine.SheetTypeEnum.WorkSheet:
            content = book.get_sheet_by_name(meta.name)
            if content.total_height * content.total_width > MAX_CELLS:
                raise MemoryError
            rows = content.to_python(skip_empty_area=False)
            by_name[meta.name] = sheet = sheet_from(rows, f"sheet {meta.name}")
            sheet.unseen = meta.visible != calamine.SheetVisibleEnum.Visible
            cells += sum(map(len, rows))
    hidden = _hidden_rows(path) if cells <= 400_000 else None  # which takes its time
    for name, sheet in by_name.items():
        if hidden is None:
            sheet.notes.append("hidden rows, if there are any, are read: they cannot be told")
        else:
            sheet.hidden += hidden.get(name, [])
    return by_name


def _hidden_rows(path: Path) -> dict[str, list[int]] | None:
    """Hidden and filtered rows of an .xlsx by sheet, which calamine does not tell."""
    if not zipfile.is_zipfile(path) or "xl/workbook.xml" not in zipfile.ZipFile(path).namelist():
        return None
    with contextlib.suppress(Exception):  # it fails on styles that calamine does not read
        import openpyxl

        return {
            sheet.title: [row for row, how in sheet.row_dimensions.items() if how.hidden]
            for sheet in openpyxl.load_workbook(path).worksheets
        }
    return None
