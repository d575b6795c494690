"""A table as a machine exported it: names, and cells that are still text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.cell import fault_of, number_in
from biaxbayes.specimens.units import Unit, stem_of, unit_named, unit_of_column

__all__ = ["RawTable"]

SHOWN_COLUMNS = 30


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
            raise InputError(
                "the cell is empty",
                file=self.path,
                row=row,
                column=self.names[index],
                remedy="fill it in or remove the row",
            )
        return values

    def sparse_numbers(self, index: int, rows: np.ndarray | None = None) -> np.ndarray:
        """As :meth:`numbers`, with NaN where a cell is empty."""
        cells = self.text(index, rows)
        joined = "\n".join(cells)
        if self.decimal_comma:
            joined = joined.replace(",", ".")
        if "_" not in joined:
            try:
                quick = np.array([float(cell) for cell in joined.split("\n")])
            except ValueError:
                quick = np.array([np.inf])
            if np.isfinite(quick).all() and quick.size == len(cells):
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
                problem, remedy = fault_of(cell)
                raise InputError(
                    problem,
                    file=self.path,
                    row=int(self.lines[at if rows is None else rows[at]]),
                    column=self.names[index],
                    remedy=remedy,
                ) from None
        return values


def _bare(name: str) -> str:
    return re.sub(r"\s+", "", name).lower()
