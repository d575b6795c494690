"""A table of another program: named columns with units, and cells that are still text."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.tables.question import Question
from biaxbayes.tables.units import Unit, split_units, stem_of, unit_named, unknown_unit
from biaxbayes.text_files import cell_fault, first_few, number_in

SHOWN_COLUMNS = 30
GROUPED = {
    False: re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d+"),
    True: re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+"),
}
"""Numbers with marks between thousands and a decimal mark, by whether that is a comma."""
MARK_OF_THOUSANDS = re.compile("(?<=\\d)['\u2019\u00a0\u202f](?=\\d{3}(?!\\d))")
"""A narrow space or an apostrophe between thousands."""
NUMBER_AS_TEXT = re.compile(r'="([-+.,\deE]+)"')
"""A number as ="1.5", which spreadsheets leave as text."""
NUMBER_AND_UNIT = re.compile(r"([+-]?\d+(?:[.,]\d*)?(?:[eE][+-]?\d+)?)\s*([^\W\d_][\w/^²°%]*|%)")
ERROR_WORDS = (
    "#div/0!", "#value!", "#ref!", "#num!", "#name?", "#null!", "#wert!", "ovld", "ovl", "over",
    "overload", "overrange", "overflow", "ol", "err", "error", "sat", "saturated",
)  # fmt: skip
"""Words of spreadsheets and machines in place of a reading, in lower case."""
MISSING = ("", "nan", "na", "n/a", "#n/a", "-", "--", "---", "null", "none", *ERROR_WORDS)
"""Cells of a missing reading, in lower case."""


@dataclass(frozen=True)
class Table:
    """A table of text cells."""

    path: Path
    names: tuple[str, ...]
    columns: tuple[Sequence[str], ...]  # cells by column
    lines: np.ndarray  # of the file, or rows of the sheet, from 1
    decimal_comma: bool = False
    unit_row: tuple[str, ...] = ()  # below the names, if there is one
    hidden: np.ndarray = field(default_factory=lambda: np.array([], dtype=int))  # rows to drop
    notes: tuple[str, ...] = ()  # encoding, separator, decimal comma, lines left out
    blocks: tuple[int, ...] = ()  # number of the block of each row, where names are repeated
    cell_units: tuple[str, ...] = ()  # by column, where each cell has its unit
    parsed: dict[int, np.ndarray] = field(default_factory=dict, compare=False)  # by column

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.lines)

    @property
    def listing(self) -> str:
        """The column names in one line, for messages."""
        named = [name or f"#{place}" for place, name in enumerate(self.names, start=1)]
        return f"columns are {first_few(named, SHOWN_COLUMNS)}"

    def reference(self, index: int) -> str:
        """What a column is called: its name, or its position where that is not the only one."""
        name = self.names[index]
        alone = name and sum(bare_name(other) == bare_name(name) for other in self.names) == 1
        return name if alone else f"#{index + 1}"

    def error(
        self, problem: str, remedy: str, *, column: int | None = None, row: int | None = None
    ) -> InputError:
        """An error of the table, at a column and a row of it."""
        return InputError(
            problem,
            file=self.path,
            row=None if row is None else int(self.lines[row]),
            column=None if column is None else self.names[column],
            remedy=remedy,
        )

    def column(self, wanted: str) -> int:
        """Index of the only column of a name, or of a position such as ``#3``."""
        position = re.fullmatch(r"\s*#(\d+)\s*", wanted)
        if position and 0 < int(position[1]) <= len(self.names):
            return int(position[1]) - 1
        for key in (str.strip, bare_name):
            matches = [i for i, name in enumerate(self.names) if key(name) == key(wanted)]
            if len(matches) == 1:
                return matches[0]
            if len(matches) > 1:
                numbers = " and ".join(str(i + 1) for i in matches)
                problem = f"column {wanted[:60]!r} is ambiguous: columns {numbers} have this name"
                remedy = f"give it by position, as #{matches[0] + 1}; {self.listing}"
                raise self.error(problem, remedy)
        raise self.error(f"no column {wanted[:60]!r}", self.listing)

    def has_column(self, name: str) -> bool:
        """True if :meth:`column` gives a column."""
        try:
            self.column(name)
        except InputError:
            return False
        return True

    def by_stem(self, stem: str) -> int | None:
        """Index of the only column whose name without its unit is ``stem``; None without one."""
        matches = [i for i, name in enumerate(self.names) if stem_of(name) == stem]
        if len(matches) > 1:
            names = " and ".join(self.names[i] for i in matches)
            problem = f"{names} are ambiguous: each could be {stem}"
            raise self.error(problem, f"rename one; {self.listing}")
        return matches[0] if matches else None

    def units(self, index: int) -> list[Unit]:
        """All units that the name of a column and the row of units give for it."""
        cells = self.cell_units[index] if self.cell_units else ""
        others = [unit_named(text) for text in (self.below(index), cells)]
        return [*split_units(self.names[index])[1], *(unit for unit in others if unit)]

    def below(self, index: int) -> str:
        """The cell of a column in the row of units."""
        return self.unit_row[index].strip() if index < len(self.unit_row) else ""

    def unit(self, index: int) -> Unit | None:
        """The unit of a column; two of one quantity, as ``Force [N] (lbf)``, are refused."""
        units = self.units(index)
        for first, second in combinations(units, 2):
            if first.quantity == second.quantity and first.factor != second.factor:
                problem = f"{self.names[index]!r} has two units, {first.name} and {second.name}"
                remedy = "give the right one after a colon in `columns`, or rename the column"
                raise self.error(problem, remedy, column=index)
        return units[0] if units else None

    def unknown_unit(self, index: int) -> str:
        """Text in place of a unit that is not a known one; empty otherwise."""
        below = self.below(index)
        return unknown_unit(self.names[index]) or unknown_unit(f"[{below.strip('[](){}')}]")

    def text(self, index: int, rows: np.ndarray | None = None) -> list[str]:
        """Cells of a column, stripped."""
        cells = self.columns[index]
        return [cell.strip() for cell in (cells if rows is None else [cells[i] for i in rows])]

    def values(self, index: int, rows: np.ndarray) -> np.ndarray:
        """Numbers of a column; NaN for any other cell, which is refused in some rows."""
        values = self.sparse_numbers(index, texts=True)
        missing = rows[np.isnan(values[rows])]
        if missing.size:
            at = missing[0]
            raise self.error(*cell_fault(self.columns[index][at]), column=index, row=at)
        return values

    def labels(self, index: int, fill: bool = False) -> list[str]:
        """Labels of a column; `fill`: one holds for the empty cells below it."""
        labels = self.text(index)
        empty = [row for row, label in enumerate(labels) if not label]
        if empty and not fill and len(empty) < len(labels):
            raise Question(
                f"{len(empty)} of {len(labels)} cells of {self.names[index]!r} are empty, from "
                f"line {self.lines[empty[0]]} on",
                {"fill_labels=True": "a label holds for the cells below it, as in merged cells"},
                file=self.path,
            )
        filled = ""
        for row, label in enumerate(labels):
            labels[row] = filled = label or filled
        return labels

    def sparse_numbers(
        self, index: int, rows: np.ndarray | None = None, *, texts: bool = False
    ) -> np.ndarray:
        """Numbers of a column, NaN where a reading is missing and, with `texts`, for a text."""
        if index not in self.parsed:
            numbers = np.full(self.rows, np.nan)
            unit = self.cell_units[index] if self.cell_units else ""
            for row, cell in enumerate(self.columns[index]):
                text = plain(cell)
                if unit and (match := NUMBER_AND_UNIT.fullmatch(text)) and match[2] == unit:
                    text = match[1]
                if GROUPED[self.decimal_comma].fullmatch(text):
                    text = text.replace("." if self.decimal_comma else ",", "")
                if self.decimal_comma:
                    # A point among decimal commas separates thousands: 1.034 is 1034.
                    text = text.replace(".", "x").replace(",", ".")
                with contextlib.suppress(ValueError):
                    numbers[row] = number_in(text)
            self.parsed[index] = numbers
        values = self.parsed[index] if rows is None else self.parsed[index][rows]
        places = np.arange(self.rows) if rows is None else rows
        for row in [] if texts else places[np.isnan(values)].tolist():
            if (cell := self.columns[index][row].strip()).lower() not in MISSING:
                raise self.error(*cell_fault(cell), column=index, row=row)
        return values.copy()

    def finite(self, index: int) -> np.ndarray:
        """All numbers of a column."""
        values = self.sparse_numbers(index, texts=True)
        return values[np.isfinite(values)]

    def lacking(
        self, indices: Sequence[int], rows: np.ndarray, *, drop: bool, remedy: str = ""
    ) -> np.ndarray:
        """Rows that lack a reading of these columns; unless `drop`, asked about or refused."""
        lacks = np.array([np.isnan(self.sparse_numbers(i, rows)) for i in indices])
        at = np.flatnonzero(lacks.any(axis=0))
        if not at.size or (drop and at.size < rows.size):
            return rows[at]
        first, column = rows[at[0]], indices[int(np.argmax(lacks[:, at[0]]))]
        cells = {
            self.lines[rows[k]]: self.columns[i][rows[k]].strip()
            for i, lack in zip(indices, lacks, strict=True)
            for k in np.flatnonzero(lack)
        }
        words = [f"{cell!r} in line {line}" for line, cell in cells.items()
                 if cell.lower() in ERROR_WORDS]  # fmt: skip
        problem, mend = cell_fault(self.columns[column][first])
        if words or at.size not in (1, rows.size):
            why = f"the cell is empty or not a finite number: rows {in_lines([*cells], shown=20)}"
            problem = f"{at.size} of {rows.size} rows lack a reading: "
            problem, mend = problem + (", ".join(words)[:200] or why), "remove the rows"
        if not remedy and not drop and at.size < rows.size:
            gives = {"drop_missing=True": "without these rows, which are counted"}
            problem = f"column {self.names[column]}: {problem}"
            raise Question(problem, gives, file=self.path, likely=False)
        remedy = remedy or "see --drop-missing"
        raise self.error(problem, f"{mend}, or {remedy}", column=column, row=first)

    def without(self, rows: np.ndarray, *notes: str) -> Table:
        """The table without some rows."""
        kept = np.setdiff1d(np.arange(self.rows), rows)
        return replace(
            self,
            columns=tuple([cells[i] for i in kept.tolist()] for cells in self.columns),
            parsed={},
            lines=self.lines[kept],
            hidden=np.flatnonzero(np.isin(kept, self.hidden)),
            blocks=tuple(self.blocks[i] for i in kept.tolist()) if self.blocks else (),
            notes=(*self.notes, *notes),
        )


def plain(cell: str) -> str:
    """A number without what programs write around it or between its thousands."""
    text = NUMBER_AS_TEXT.sub(r"\1", cell.strip()).strip("'")
    return MARK_OF_THOUSANDS.sub("", text)


def bare_name(name: str) -> str:
    """A name as it is compared: without spaces and capitals, µ as u."""
    return re.sub(r"\s+", "", name.replace("µ", "u").replace("μ", "u")).lower()


def in_lines(lines: Sequence[int] | np.ndarray, shown: int = 6) -> str:
    """Lines of a file as text, such as ``5, 9-14 and 3 more``."""
    numbers = np.sort(np.asarray(lines))
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    text = ", ".join(f"{r[0]}-{r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs[:shown])
    return text + (f" and {sum(map(len, runs[shown:]))} more" if len(runs) > shown else "")
