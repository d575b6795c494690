"""Workbooks made for tests, and files read as tables."""

import io
from pathlib import Path

from biaxbayes.tables.layout import tables_in
from biaxbayes.tables.sheets import read_sheets


def read_tables(path: Path, sheets=()):
    return tables_in(read_sheets(path), path, sheets)


def xlsx(sheets: dict[str, list[list[object]]]) -> bytes:
    import openpyxl

    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()
