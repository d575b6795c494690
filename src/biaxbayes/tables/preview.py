"""What a file holds before anything is converted: its sheets, with columns and first rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.tables.layout import table_from_sheet
from biaxbayes.tables.sheets import read_sheets

SHOWN_ROWS = 20


@dataclass(frozen=True)
class Preview:
    """A sheet as it is read."""

    names: tuple[str, ...]  # of the columns; empty where no table was found
    units: tuple[str, ...]  # of the names or the row below them; empty texts without a unit
    rows: int  # below the names
    lines: tuple[int, ...]  # line in the file, or row of the sheet, of each of `cells`, from 1
    cells: tuple[tuple[str, ...], ...]  # first rows of the table, or of a sheet without one
    problem: str = ""  # why no table was found; empty otherwise
    hidden: bool = False


def preview(path: str | Path, shown: int = SHOWN_ROWS) -> dict[str, Preview]:
    """Sheets of a file by name, as :func:`biaxbayes.convert` reads them; that of text is ``""``.

    Raises
    ------
    InputError
        For a file that cannot be read.
    """
    file, found = Path(path), {}
    for name, sheet in read_sheets(file).items():
        try:
            table = table_from_sheet(sheet, file)
        except InputError as error:
            lines, rows = tuple(sheet.lines[:shown]), tuple(map(tuple, sheet.rows[:shown]))
            found[name] = Preview((), (), 0, lines, rows, error.problem, sheet.unseen)
            continue
        units = tuple(next((u.name for u in table.units(i)), "") for i in range(len(table.names)))
        cells = tuple(zip(*(column[:shown] for column in table.columns), strict=True))
        lines = tuple(table.lines[:shown].tolist())
        found[name] = Preview(table.names, units, table.rows, lines, cells, "", sheet.unseen)
    return found
