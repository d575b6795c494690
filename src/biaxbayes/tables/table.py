"""A table of another program: named columns with units, and cells that are still text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.tables.question import Question
from biaxbayes.tables.sheets import Worksheet, read_sheets
from biaxbayes.tables.units import Unit, split_units, stem_of, unit_named, unknown_unit
from biaxbayes.text_files import (
    DECIMAL_COMMA,
    DECIMAL_POINT,
    cell_fault,
    first_few,
    is_number,
    number_in,
    one_line,
    without_empty_end,
)

ALL_SHEETS = "all"
SHOWN_COLUMNS = 30
SAMPLE_ROWS = 200
"""Rows from which the form of a table is read."""
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
MISSING = ("", "nan", "na", "n/a", "#n/a", "-", "--", "---", "null", "none")
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
    notes: tuple[str, ...] = ()  # encoding, separator, decimal comma

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.lines)

    @property
    def listing(self) -> str:
        """The column names in one line, for messages."""
        return f"columns are {first_few(self.names, SHOWN_COLUMNS)}"

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
        for key in (str.strip, _bare):
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
        below = unit_named(self.below(index))
        return [*split_units(self.names[index])[1], *([below] if below else [])]

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

    def numbers(self, index: int, rows: np.ndarray | None = None) -> np.ndarray:
        """Numbers of a column, of all rows or of some; any other cell is refused."""
        values = self.sparse_numbers(index, rows)
        missing = np.flatnonzero(np.isnan(values))
        if missing.size:
            at = missing[0] if rows is None else rows[missing[0]]
            raise self.error(*cell_fault(self.columns[index][at]), column=index, row=at)
        return values

    def values(self, index: int, rows: np.ndarray) -> np.ndarray:
        """Numbers of a column; NaN for any other cell, which is refused in some rows."""
        values = self.sparse_numbers(index, texts=True)
        values[rows] = self.numbers(index, rows)
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
        values = []
        for at, cell in enumerate(self.text(index, rows)):
            plain = cell
            if self.decimal_comma:
                # A point among decimal commas separates thousands: 1.034 is 1034.
                plain = cell.replace(".", "x").replace(",", ".")
            try:
                values.append(number_in(plain))
            except ValueError:
                if not texts and cell.lower() not in MISSING:
                    row = at if rows is None else rows[at]
                    raise self.error(*cell_fault(cell), column=index, row=row) from None
                values.append(np.nan)
        return np.array(values)

    def lacking(
        self, indices: Sequence[int], rows: np.ndarray, *, drop: bool, remedy: str
    ) -> np.ndarray:
        """Those of some rows that lack a reading of these columns; refuses them unless `drop`."""
        lacks = np.array([np.isnan(self.sparse_numbers(i, rows)) for i in indices])
        at = np.flatnonzero(lacks.any(axis=0))
        if not at.size or (drop and at.size < rows.size):
            return rows[at]
        first, column = rows[at[0]], indices[int(np.argmax(lacks[:, at[0]]))]
        if at.size in (1, rows.size):
            problem, mend = cell_fault(self.columns[column][first])
        else:
            problem = f"{at.size} of {rows.size} rows lack a reading (the cell is empty or not a "
            problem += f"finite number): rows {in_lines(self.lines[rows[at]], shown=20)}"
            mend = "remove the rows"
        raise self.error(problem, f"{mend}, or {remedy}", column=column, row=first)

    def without(self, rows: np.ndarray, *notes: str) -> Table:
        """The table without some rows."""
        kept = np.setdiff1d(np.arange(self.rows), rows)
        return replace(
            self,
            columns=tuple([cells[i] for i in kept.tolist()] for cells in self.columns),
            lines=self.lines[kept],
            hidden=np.flatnonzero(np.isin(kept, self.hidden)),
            notes=(*self.notes, *notes),
        )


def _bare(name: str) -> str:
    return re.sub(r"\s+", "", name).lower()


def in_lines(lines: Sequence[int] | np.ndarray, shown: int = 6) -> str:
    """Lines of a file as text, such as ``5, 9-14 and 3 more``."""
    numbers = np.sort(np.asarray(lines))
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    text = ", ".join(f"{r[0]}-{r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs[:shown])
    return text + (f" and {sum(map(len, runs[shown:]))} more" if len(runs) > shown else "")


# --- tables of a file -----------------------------------------------------------------------------


def read_tables(
    path: Path, sheets: Sequence[str] = (), hidden: str | None = None
) -> tuple[dict[str, Table], dict[str, str]]:
    """Tables by sheet, and why other sheets hold none.

    `sheets` selects by name, or ``all``; `hidden` is what to do with hidden rows, keep or drop.
    """
    available = read_sheets(path)
    listing = f"sheets are {', '.join(available)[:300]}"
    wanted = () if tuple(sheets) == (ALL_SHEETS,) else tuple(sheets)
    if sheets and "" in available:
        raise InputError("is text and has no sheets", file=path, remedy="leave out `sheets`")
    for name in wanted:
        if name not in available:
            raise InputError(f"no sheet {name[:40]!r}", file=path, remedy=listing)
        if wanted.count(name) > 1:
            raise InputError(f"sheet {name[:40]!r} is given twice", file=path, remedy="keep one")
    tables: dict[str, Table] = {}
    available, others = _seen(available, wanted, hidden, path)
    for name in wanted or available:
        try:
            tables[name] = table_from_sheet(available[name], path)
        except InputError as error:
            if wanted or len(available) == 1:
                label = f"sheet {name[:40]!r} " if name else ""
                raise InputError(
                    label + error.problem, file=path, row=error.row, remedy=error.remedy
                ) from None
            others[name] = error.problem
    if not tables:
        raise InputError("no sheet holds a table", file=path, remedy=listing)
    if len(tables) > 1 and not sheets:
        gives = {f"sheets={name}": f"{t.rows} rows; {t.listing}" for name, t in tables.items()}
        gives[f"sheets={ALL_SHEETS}"] = "each a protocol"
        raise Question("more than one sheet holds a table", gives, file=path)
    return tables, others


def _seen(
    sheets: dict[str, Worksheet], wanted: Sequence[str], hidden: str | None, path: Path
) -> tuple[dict[str, Worksheet], dict[str, str]]:
    """Sheets without the hidden ones, and why those are left out; asks about them."""
    unseen = {k: "hidden" for k, s in sheets.items() if s.unseen and (not wanted or k in wanted)}
    rows = {k: len(s.hidden) for k, s in sheets.items() if s.hidden and (not wanted or k in wanted)}
    if hidden is None and (unseen or rows):
        found = [f"sheet {k!r} is hidden" for k in unseen]
        found += [f"{count} rows of {k!r} are hidden or filtered" for k, count in rows.items()]
        gives = {"hidden=drop": "without them", "hidden=keep": "with them"}
        raise Question("; ".join(found)[:300], gives, file=path)
    if hidden == "drop":
        return {k: s for k, s in sheets.items() if k not in unseen}, unseen
    return {k: replace(s, hidden=[]) for k, s in sheets.items()}, {}


def table_from_sheet(sheet: Worksheet, path: Path) -> Table:
    """Names, an optional row of units, and the body of a table, below any preamble."""
    rows, lines = sheet.rows, sheet.lines
    start = _first_row_of_numbers(rows, path)
    numeric = _numeric_columns(rows[start:])
    at_names = start - 1
    units_row: tuple[str, ...] = ()
    if start > 1 and _is_row_of_units(rows[start - 1], rows[start - 2], numeric):
        at_names, units_row = start - 2, tuple(rows[start - 1])
    if start == 0 and len(sheet.names) == len(rows[0]):
        names = list(sheet.names)  # as numpy.savetxt writes them, in a comment
    elif start == 0 or not _are_names(rows[at_names], numeric):
        shown = ", ".join(rows[max(at_names, 0)])[:60]
        problem = f"has no line of column names, but {shown!r}"
        remedy = "add a line that names the columns, with their units"
        raise InputError(problem, file=path, row=lines[max(at_names, 0)], remedy=remedy)
    else:
        names = list(rows[at_names])
    names = without_empty_end([one_line(name) for name in names])
    body = _squared(rows[start:], lines[start:], len(names), sheet, path)
    comma = _decimal_comma(body[: 10 * SAMPLE_ROWS], numeric, path)
    notes = [*sheet.notes, "decimal commas"] if comma else sheet.notes
    columns = tuple(zip(*body, strict=True))
    return Table(
        path,
        tuple(names),
        columns,
        np.array(lines[start:]),
        comma,
        units_row,
        np.flatnonzero(np.isin(lines[start:], sheet.hidden)),
        tuple(notes),
    )


def _numeric_columns(rows: Sequence[Sequence[str]]) -> list[int]:
    """Columns that hold a number in at least half of the rows about the middle."""
    middle = rows[len(rows) // 3 :][:SAMPLE_ROWS]
    width = max(map(len, middle), default=0)
    counts = [sum(j < len(r) and is_number(r[j]) for r in middle) for j in range(width)]
    return [j for j, count in enumerate(counts) if 2 * count >= len(middle)]


def _first_row_of_numbers(rows: Sequence[Sequence[str]], path: Path) -> int:
    """The first of three rows that hold numbers where the middle of the table does."""
    numeric = _numeric_columns(rows)

    def of_numbers(cells: Sequence[str]) -> bool:
        present = [cells[j] for j in numeric if j < len(cells)]
        numbers = sum(map(is_number, present))
        texts = sum(cell.strip().lower() not in MISSING for cell in present) - numbers
        return numbers >= 2 and texts <= 0.25 * len(numeric)

    if len(rows) > 1:
        for start in range(len(rows)):
            if all(map(of_numbers, rows[start : start + 3])):
                return start
    width = max(map(len, rows), default=0)
    raise InputError(
        f"holds no table: {len(rows)} rows of up to {width} cells, no three of them with two "
        "numbers below each other",
        file=path,
        remedy="a table has a line of column names and at least two rows",
    )


def _are_names(cells: Sequence[str], numeric: Sequence[int]) -> bool:
    """True if most columns of numbers have text in this row."""
    named = sum(j < len(cells) and bool(cells[j].strip()) for j in numeric)
    numbers = sum(j < len(cells) and is_number(cells[j]) for j in numeric)
    return not numbers and named >= max(2, 0.6 * len(numeric))


def _is_row_of_units(cells: Sequence[str], above: Sequence[str], numeric: Sequence[int]) -> bool:
    """True if a row below names holds units: known ones, or the same text several times."""
    filled = [cell.strip() for cell in cells if cell.strip()]
    if not filled or not _are_names(above, numeric) or any(map(is_number, cells)):
        return False
    units = sum(unit_named(cell) is not None or not re.search(r"\w", cell) for cell in filled)
    names = [cell.strip() for cell in above if cell.strip()]
    repeated = len(set(filled)) < len(filled) and len(set(names)) == len(names)
    return 2 * units >= len(filled) or repeated


def _squared(
    rows: Sequence[Sequence[str]], lines: Sequence[int], width: int, sheet: Worksheet, path: Path
) -> list[list[str]]:
    """Rows of equal width; in text, one that lacks more than sparse columns may be cut off."""
    sample = rows[:: max(1, len(rows) // SAMPLE_ROWS)]
    needed = 0
    for j in range(width):
        if 2 * sum(j < len(r) and bool(r[j].strip()) for r in sample) >= len(sample):
            needed = j + 1
    out = []
    for cells, line in zip(rows, lines, strict=True):
        too_many = len(cells) > width and "".join(cells[width:]).strip()
        if sheet.text and (too_many or len(cells) < needed):
            problem = f"{len(cells)} cells where the columns are {width}"
            remedy = "the file may be cut off here, or holds more than one table"
            raise InputError(problem, file=path, row=line, remedy=remedy)
        out.append([*cells[:width], *[""] * (width - len(cells))])
    return out


def _decimal_comma(rows: Sequence[Sequence[str]], numeric: Sequence[int], path: Path) -> bool:
    """True for decimal commas; mixed ones and thousands separators are refused."""
    cells = [row[j].strip() for row in rows for j in numeric if j < len(row)]
    commas = [cell for cell in cells if DECIMAL_COMMA.fullmatch(cell)]
    problem = ""
    if commas and any(map(DECIMAL_POINT.fullmatch, cells)):
        problem = "mixes decimal commas and decimal points (or has thousands separators)"
    elif commas and all(map(THOUSANDS.fullmatch, commas)):
        problem = f"writes numbers like {commas[0]!r}, which may be decimals or thousands"
    if problem:
        remedy = "export it with decimal points and no thousands separators"
        raise InputError(problem, file=path, remedy=remedy)
    return bool(commas)
