"""The table of a specimen file, and paths of stretches."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.experiments import EXPERIMENTS
from biaxbayes.experiments.experiment import STRETCH_RANGE
from biaxbayes.specimens.keys import COLUMNS, STRETCHES
from biaxbayes.specimens.protocol import STRETCH_REMEDY
from biaxbayes.tables.table import Table, in_lines
from biaxbayes.tables.units import likely_name
from biaxbayes.text_files import cells_of, one_line, read_lines, rows_of, without_empty_end

MAX_SPECIMEN_COLUMNS = 50
MAX_PROTOCOLS = 1_000


@dataclass(frozen=True)
class SpecimenTable:
    """Numbers by column, and their places in the file."""

    path: Path
    columns: dict[str, np.ndarray]
    lines: np.ndarray  # of the file, from 1, for each row
    groups: tuple[tuple[str, slice], ...]  # rows of each protocol, in the order of the file
    names_line: int
    notes: tuple[str, ...] = ()  # on rows left out

    def error(self, problem: str, remedy: str, column: str | None = None) -> InputError:
        """An error of the line of column names."""
        return InputError(
            problem, file=self.path, row=self.names_line, column=column, remedy=remedy
        )


def read_table(
    lines: Sequence[str], first: int, path: Path, needed: tuple[str, ...], *, drop_missing: bool
) -> SpecimenTable:
    """Read the table with its column names in line `first`; an error names row and column."""
    names = _column_names(lines[first], first + 1, needed, path)
    table = _filled_rows(rows_of(lines, path, first=first + 1), names, path)
    if table.rows < 2:
        problem = "only 1 row of data" if table.rows else "no row of data below the column names"
        remedy = "a test needs the mounted state and at least one stretched state"
        row = int(table.lines[0]) if table.rows else first + 1
        raise InputError(problem, file=path, row=row, remedy=remedy)
    numeric = [index for index, name in enumerate(names) if name != "protocol"]
    remedy = "leave such rows out with a line '# missing_rows: drop' at the top"
    lacking = table.lacking(numeric, np.arange(table.rows), drop=drop_missing, remedy=remedy)
    if lacking.size:
        lines = in_lines(table.lines[lacking], shown=20)
        note = f"{lacking.size} of {table.rows} rows without a reading left out (lines {lines})"
        table = table.without(lacking, note)
    labels = table.text(names.index("protocol")) if "protocol" in names else ["1"] * table.rows
    return SpecimenTable(
        path,
        columns={names[index]: table.values(index, np.arange(table.rows)) for index in numeric},
        lines=table.lines,
        groups=_protocol_rows(labels, table.lines, path),
        names_line=first + 1,
        notes=table.notes,
    )


def _column_names(line: str, row: int, needed: tuple[str, ...], path: Path) -> list[str]:
    """Names of the columns, all known, none twice, with those needed."""

    def error(problem: str, remedy: str, column: str | None = None) -> InputError:
        return InputError(problem, file=path, row=row, column=column, remedy=remedy)

    names = without_empty_end([name.strip() for name in cells_of(line)])
    for separator, word in ((";", "semicolons"), ("\t", "tabs"), ("|", "bars")):
        if any(part.strip().strip('"') in COLUMNS for part in line.split(separator)[1:]):
            raise error(
                f"the columns are separated by {word}",
                "save it with commas and decimal points, or use "
                "'biaxbayes convert --machine generic'",
            )
    if len(names) > MAX_SPECIMEN_COLUMNS:
        problem = f"not a specimen CSV: {len(names)} columns"
        raise error(problem, "'biaxbayes convert' reads exports")
    if not any(name in COLUMNS for name in names):
        raise error(
            "not a specimen CSV: no column of the first line after the header is known",
            "expected comma-separated column names such as "
            "stretch_x,stretch_y,force_x_N,force_y_N ('biaxbayes convert' reads machine exports)",
        )
    for name in names:
        if not name:
            raise error("a column without a name", "write the table without row names or indices")
        if names.count(name) > 1:
            raise error("column appears twice", "keep one", name[:60])
        if name not in COLUMNS:
            remedy = f"{likely_name(name, COLUMNS)[1]}known columns are {', '.join(COLUMNS)}"
            raise error("unknown column", remedy, name[:60])
    for name in needed:
        if name not in names:
            remedy = "stretches are relative to the mounted state; another kind of test is stated "
            remedy += f"at the top, by '# test: ...' ({', '.join(list(EXPERIMENTS)[1:])})"
            raise error("missing column", remedy, name)
    return names


def _filled_rows(rows: Iterable[tuple[int, list[str]]], names: list[str], path: Path) -> Table:
    """The rows that have a cell with text."""
    filled = [(row, _row(cells, names, row, path)) for row, cells in rows if "".join(cells).strip()]
    columns = tuple(zip(*(cells for _, cells in filled), strict=True))
    return Table(path, tuple(names), columns, np.array([row for row, _ in filled], dtype=int))


def _row(cells: list[str], names: list[str], row: int, path: Path) -> list[str]:
    """A row without empty cells after its last column; refuses one of another length."""
    if len(cells) >= len(names) and not any(cell.strip() for cell in cells[len(names) :]):
        return cells[: len(names)]
    problem = f"{len(cells)} {'cell' if len(cells) == 1 else 'cells'} for {len(names)} columns"
    numbers = len(names) - ("protocol" in names)
    if cells[0].startswith("#"):
        problem = "a header line below the column names"
        remedy = "header and comment lines belong above the table"
    elif len(cells) == len(names) + numbers:
        remedy = "the file seems to have decimal commas: write decimal points"
    elif len(cells) == 1:
        remedy = "the file may be cut off here, or use another separator than a comma"
    elif len(cells) < len(names):
        remedy = "the file may be cut off here; complete or remove the row"
    else:
        remedy = "one number per column, with decimal points and no thousands separators"
    raise InputError(problem, file=path, row=row, remedy=remedy)


def _protocol_rows(
    labels: Sequence[str], lines: np.ndarray, path: Path
) -> tuple[tuple[str, slice], ...]:
    """Rows of each protocol, which must be together."""

    def error(problem: str, start: int, remedy: str) -> InputError:
        row = int(lines[start])
        return InputError(problem, file=path, row=row, column="protocol", remedy=remedy)

    groups: dict[str, slice] = {}
    start = 0
    for label, rows in groupby(labels):
        name, stop = one_line(label), start + len(list(rows))
        if not name:
            raise error("the name is empty", start, "fill it in")
        if name in groups:
            problem = f"the rows of the protocols {', '.join(groups)[:200]} are mixed: protocol "
            problem += f"{name[:40]!r} comes back after another one"
            remedy = "keep its rows together in the order of the test, or give each loading path "
            raise error(problem, start, f"{remedy}its own name")
        if len(groups) == MAX_PROTOCOLS:
            remedy = "the column names the loading path, the same in all its rows"
            raise error(f"more than {MAX_PROTOCOLS} protocols", start, remedy)
        groups[name] = slice(start, stop)
        start = stop
    for name, where in groups.items():
        if where.stop - where.start < 2:
            remedy = "give the mounted state and at least one stretched state"
            raise error(f"protocol {name[:40]!r} has one row", where.start, remedy)
    return tuple(groups.items())


def read_stretches(path: str | os.PathLike) -> np.ndarray:
    """Stretches, shape (n, 2), from the columns stretch_x and stretch_y of a CSV."""
    path = Path(path)
    lines = ["" if line.lstrip().startswith("#") else line for line in read_lines(path)]
    rows = [(row, cells) for row, cells in rows_of(lines, path) if "".join(cells).strip()]
    if len(rows) < 2:
        raise InputError("has no rows", file=path, remedy="give stretch_x,stretch_y and numbers")
    names = [cell.strip() for cell in rows[0][1]]
    for column in STRETCHES:
        if names.count(column) != 1:
            problem = "missing column" if column not in names else "column appears twice"
            remedy = "name the columns stretch_x,stretch_y"
            raise InputError(problem, file=path, row=rows[0][0], column=column, remedy=remedy)
    table = _filled_rows(rows[1:], names, path)
    places = [names.index(column) for column in STRETCHES]
    stretches = np.column_stack([table.values(k, np.arange(table.rows)) for k in places])
    low, high = STRETCH_RANGE
    for row, k in np.argwhere((stretches < low) | (stretches > high)):
        problem = f"{stretches[row, k]:g} is not a stretch"
        raise table.error(problem, STRETCH_REMEDY, column=places[k], row=row)
    return stretches
