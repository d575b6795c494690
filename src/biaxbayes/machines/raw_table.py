"""A table as a machine exported it: columns, their units, and cells that are still text."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.units import Unit, stem_of, unit_named, unit_of_column
from biaxbayes.text_files import DECIMAL_COMMA, bad_cell, number_in, one_line

__all__ = [
    "SAMPLE",
    "RawTable",
    "assembled_table",
    "is_numeric",
]


# --- a table as a machine exported it: names, units, and cells that are still text ---------------

SHOWN_COLUMNS = 30
MAX_COLUMNS = 2_000
SAMPLE = 200
"""Rows that tell the form of a table."""
DECIMAL_POINT = re.compile(r"[+-]?\d+\.\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class RawTable:
    """A table of text cells.

    Attributes
    ----------
    path : Path
    names : tuple of str
    columns : tuple of sequence of str
        Cells by column.
    lines : ndarray of int, shape (n,)
        Line (or row of the sheet) that each row stands in, from 1.
    decimal_comma : bool
    units : dict of str to str
        Units from a line of their own below the names.
    notes : tuple of str
        What was noticed while reading: encoding, separator, decimal comma.
    """

    path: Path
    names: tuple[str, ...]
    columns: tuple[Sequence[str], ...]
    lines: np.ndarray
    decimal_comma: bool = False
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.lines)

    @property
    def found(self) -> str:
        """The column names in one line, for messages."""
        shown = ", ".join(self.names[:SHOWN_COLUMNS])
        more = len(self.names) - SHOWN_COLUMNS
        return f"found {shown}" + (f" and {more} more" if more > 0 else "")

    def column(self, wanted: str) -> int:
        """Index of a column by its name; letter case and spaces do not matter.

        Raises
        ------
        InputError
            If no column or more than one has the name; the message lists what was found.
        """
        for key in (str.strip, _bare):
            matches = [i for i, name in enumerate(self.names) if key(name) == key(wanted)]
            if len(matches) == 1:
                return matches[0]
            if len(matches) > 1:
                places = " and ".join(str(i + 1) for i in matches)
                raise InputError(
                    f"column {wanted[:60]!r} is ambiguous: columns {places} have this name",
                    file=self.path,
                    remedy=f"rename one; {self.found}",
                )
        raise InputError(f"no column {wanted[:60]!r}", file=self.path, remedy=self.found)

    def by_stem(self, stem: str) -> int | None:
        """Index of the column whose name without its unit is ``stem``; None where none is.

        Raises
        ------
        InputError
            If there are several.
        """
        matches = [i for i, name in enumerate(self.names) if stem_of(name) == stem]
        if len(matches) > 1:
            names = " and ".join(self.names[i] for i in matches)
            raise InputError(
                f"{names} are ambiguous: each could be {stem}",
                file=self.path,
                remedy=f"rename one; {self.found}",
            )
        return matches[0] if matches else None

    def unit(self, index: int) -> Unit | None:
        """The unit of a column, from its name or from the line of units."""
        name = self.names[index]
        return unit_of_column(name) or unit_named(self.units.get(name, "").strip("[]() "))

    def is_numeric(self, index: int) -> bool:
        """Whether all cells of a column are numbers."""
        try:
            self.numbers(index)
        except InputError:
            return False
        return True

    def text(self, index: int, rows: np.ndarray | None = None) -> list[str]:
        """Cells of a column, stripped."""
        cells = self.columns[index]
        chosen = cells if rows is None else [cells[i] for i in rows]
        return [cell.strip() for cell in chosen]

    def numbers(self, index: int, rows: np.ndarray | None = None) -> np.ndarray:
        """Numbers of a column, of all rows or of some.

        Raises
        ------
        InputError
            Naming row and column of a cell that is no number.
        """
        values = self.sparse_numbers(index, rows)
        missing = np.flatnonzero(np.isnan(values))
        if missing.size:
            at = int(missing[0])
            row = int(self.lines[at if rows is None else rows[at]])
            raise bad_cell("", self.path, row, self.names[index])
        return values

    def sparse_numbers(self, index: int, rows: np.ndarray | None = None) -> np.ndarray:
        """As :meth:`numbers`, with NaN where a cell is empty."""
        cells = self.text(index, rows)
        plain = [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells
        try:
            quick = np.fromiter(map(float, plain), dtype=float, count=len(plain))
        except ValueError:
            return self._carefully(cells, index, rows)
        # float() takes 'inf', and '1_000' for a number
        if np.isfinite(quick).all() and "_" not in "".join(cells):
            return quick
        return self._carefully(cells, index, rows)

    def _carefully(self, cells: list[str], index: int, rows: np.ndarray | None) -> np.ndarray:
        """Numbers of cells one by one, so that the first fault can be named."""
        values = np.empty(len(cells))
        for at, cell in enumerate(cells):
            if not cell or cell.lower() == "nan":
                values[at] = np.nan
                continue
            try:
                values[at] = number_in(cell.replace(",", ".") if self.decimal_comma else cell)
            except ValueError:
                row = int(self.lines[at if rows is None else rows[at]])
                raise bad_cell(cell, self.path, row, self.names[index]) from None
        return values


def _bare(name: str) -> str:
    return re.sub(r"\s+", "", name).lower()


# --- from rows of cells --------------------------------------------------------------------------


def assembled_table(
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
        if len(cells) != len(names) and not _padded(cells, len(names)):
            raise InputError(
                f"{len(cells)} cells where the columns are {len(names)}",
                file=path,
                row=number,
                remedy="the file may be cut off here, or holds more than one table",
            )
    columns = tuple(zip(*rows[body:], strict=False))[: len(names)]
    comma = _decimal_comma(rows[body : body + 10 * SAMPLE], path)
    if comma:
        notes = [*notes, "decimal commas"]
    return RawTable(
        path, tuple(names), columns, np.array(numbers[body:]), comma, units, tuple(notes)
    )


def _padded(cells: Sequence[str], width: int) -> bool:
    """Whether a row has some cells and blank ones behind them."""
    return len(cells) >= width and not "".join(cells[width:]).strip()


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


def is_numeric(cells: Sequence[str]) -> bool:
    """Whether a row holds a number."""
    return _numeric(cells) > 0


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
