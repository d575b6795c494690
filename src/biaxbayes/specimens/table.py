"""Tables in a specimen's terms: the columns of a specimen file, and paths of stretches."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.keys import COLUMNS
from biaxbayes.specimens.protocol import STRETCH_RANGE, STRETCH_REMEDY
from biaxbayes.tables.table import Table as CellTable
from biaxbayes.tables.units import likely_name
from biaxbayes.text_files import cells_of, number_in, one_line, read_lines, rows_of

# --- which column names are known, and what a wrong line of them means ---------------------------


STRETCHES = ("stretch_x", "stretch_y")
KNOWN_COLUMNS = tuple(COLUMNS)
MAX_COLUMNS = 50


def column_names(line: str, row: int, path: Path) -> list[str]:
    """Names of the columns, each known and there once, both stretches among them.

    Parameters
    ----------
    line : str
        The first line below the header.
    row : int
        Its number, from 1.
    path : Path
        For messages.

    Raises
    ------
    InputError
    """
    names = [name.strip() for name in cells_of(line)]
    while names and not names[-1]:
        names.pop()  # separators at the end of the line
    _check_separator(line, row, path)
    if len(names) > MAX_COLUMNS or not any(name in KNOWN_COLUMNS for name in names):
        shown = line.strip()[:60]
        found = f" ({len(names)} columns)" if len(names) > MAX_COLUMNS else ""
        raise InputError(
            f"not a specimen CSV: the first line after the header reads {shown!r}{found}",
            file=path,
            row=row,
            remedy="expected comma-separated column names such as "
            "stretch_x,stretch_y,force_x_N,force_y_N ('biaxbayes convert' reads machine exports)",
        )
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                "column appears twice", file=path, row=row, column=name[:60], remedy="keep one"
            )
        if name not in KNOWN_COLUMNS:
            raise _unknown_column(name, row, path)
    for name in STRETCHES:
        if name not in names:
            raise InputError(
                "missing column",
                file=path,
                row=row,
                column=name,
                remedy="stretches are relative to the mounted state",
            )
    return names


def _check_separator(line: str, row: int, path: Path) -> None:
    for separator, word in ((";", "semicolons"), ("\t", "tabs"), ("|", "bars")):
        if any(part.strip().strip('"') in KNOWN_COLUMNS for part in line.split(separator)[1:]):
            raise InputError(
                f"the columns are separated by {word}",
                file=path,
                row=row,
                remedy="save it with commas and decimal points, "
                "or use 'biaxbayes convert --machine generic'",
            )


def _unknown_column(name: str, row: int, path: Path) -> InputError:
    if not name:
        return InputError(
            "a column without a name",
            file=path,
            row=row,
            remedy="write the table without row names or indices",
        )
    _, hint = likely_name(name, KNOWN_COLUMNS)
    return InputError(
        "unknown column",
        file=path,
        row=row,
        column=name[:60],
        remedy=f"{hint}known columns are {', '.join(KNOWN_COLUMNS)}",
    )


# --- the table of a specimen file: named columns of numbers, each row with its line --------------


MAX_PROTOCOLS = 1_000


@dataclass(frozen=True)
class Table:
    """Numbers by column, and where they stand.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n,)
    lines : ndarray of int, shape (n,)
        Line of the file that each row stands in, counted from 1.
    groups : tuple of (str, slice)
        Rows of each protocol, in the order of the file.
    names_line : int
        Line of the column names.
    notes : tuple of str
        What was left out.
    """

    columns: dict[str, np.ndarray]
    lines: np.ndarray
    groups: tuple[tuple[str, slice], ...]
    names_line: int
    notes: tuple[str, ...] = ()

    def pair(self, names: Sequence[str], rows: slice = slice(None)) -> np.ndarray:
        """Some columns side by side, shape (n, len(names))."""
        return np.column_stack([self.columns[name][rows] for name in names])


def read_table(
    lines: Sequence[str], first: int, path: Path, *, drop_missing: bool = False
) -> Table:
    """Read the table below the header.

    Parameters
    ----------
    lines : sequence of str
        All lines of the file.
    first : int
        Index of the line with the column names.
    path : Path
        For messages.
    drop_missing : bool
        Leave out rows in which a reading is missing; else they are refused.

    Returns
    -------
    Table

    Raises
    ------
    InputError
        Naming row and column of the first fault.
    """
    names = column_names(lines[first], first + 1, path)
    rows, numbers = [], []
    for number, cells in rows_of(lines, path, first=first + 1):
        if len(cells) != len(names) or not any(cells):
            if not any(cell.strip() for cell in cells):
                continue  # a blank line
            cells = _trimmed(cells, names, number, path)
        rows.append(cells)
        numbers.append(number)
    if len(rows) < 2:
        raise InputError(
            "only 1 row of data" if rows else "no row of data below the column names",
            file=path,
            row=numbers[0] if rows else first + 1,
            remedy="a test needs the mounted state and at least one stretched state",
        )
    cells_by_column = tuple(zip(*rows, strict=True))
    table = CellTable(path, tuple(names), cells_by_column, np.array(numbers))
    del rows
    numeric = [index for index, name in enumerate(names) if name != "protocol"]
    table = table.without_missing(
        numeric,
        drop=drop_missing,
        remedy="leave such rows out with a line '# missing_rows: drop' at the top",
    )
    labels = table.text(names.index("protocol")) if "protocol" in names else []
    return Table(
        columns={names[index]: table.numbers(index) for index in numeric},
        lines=table.lines,
        groups=_groups(labels, table.lines, path),
        names_line=first + 1,
        notes=table.notes,
    )


def _trimmed(cells: list[str], names: list[str], row: int, path: Path) -> list[str]:
    """A row without the empty cells behind its last column; otherwise what is wrong with it."""
    if not any(cell.strip() for cell in cells[len(names) :]) and len(cells) > len(names):
        return cells[: len(names)]
    if cells[0].startswith("#"):
        raise InputError(
            "a header line below the column names",
            file=path,
            row=row,
            remedy="header and comment lines stand above the table",
        )
    numbers = len(names) - ("protocol" in names)
    if len(cells) == len(names) + numbers:
        remedy = "the file seems to have decimal commas: write decimal points"
    elif len(cells) == 1:
        remedy = "the file may be cut off here, or use another separator than a comma"
    elif len(cells) < len(names):
        remedy = "the file may be cut off here; complete or remove the row"
    else:
        remedy = "one number a column, with decimal points and no thousands separators"
    raise InputError(
        f"{len(cells)} {'cell' if len(cells) == 1 else 'cells'} for {len(names)} columns",
        file=path,
        row=row,
        remedy=remedy,
    )


def _groups(labels: Sequence[str], lines: np.ndarray, path: Path) -> tuple[tuple[str, slice], ...]:
    """Rows of each protocol; a file without the column holds one, named ``1``."""
    if not labels:
        return (("1", slice(0, len(lines))),)
    number: dict[str, int] = {}
    codes = np.array([number.setdefault(label, len(number)) for label in labels])
    labels = list(number)
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    if starts.size > MAX_PROTOCOLS:
        raise InputError(
            f"more than {MAX_PROTOCOLS} protocols",
            file=path,
            row=int(lines[starts[MAX_PROTOCOLS]]),
            column="protocol",
            remedy="the column names the loading path, the same in all its rows",
        )
    if starts.size > len(np.unique(codes)):
        names = ", ".join(dict.fromkeys(one_line(labels[codes[s]])[:40] for s in starts[:50]))
        back = next(s for k, s in enumerate(starts) if codes[s] in codes[starts[:k]])
        raise InputError(
            f"the rows of the protocols {names[:200]} are mixed: protocol "
            f"{one_line(labels[codes[back]])[:40]!r} comes back after another one",
            file=path,
            row=int(lines[back]),
            column="protocol",
            remedy="keep its rows together in the order of the test, or give each loading path a "
            "name of its own",
        )
    groups: dict[str, slice] = {}
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        name = one_line(labels[codes[start]])
        row = int(lines[start])
        if not name:
            raise InputError(
                "the name is empty", file=path, row=row, column="protocol", remedy="fill it in"
            )
        if name in groups:
            raise InputError(
                f"protocol {name[:40]!r} comes back after another one",
                file=path,
                row=row,
                column="protocol",
                remedy="keep its rows together, or give each loading path a name of its own",
            )
        if end - start < 2:
            raise InputError(
                f"protocol {name[:40]!r} has one row",
                file=path,
                row=row,
                column="protocol",
                remedy="give the mounted state and at least one stretched state",
            )
        groups[name] = slice(int(start), int(end))
    return tuple(groups.items())


# --- a path of stretches on which to predict -----------------------------------------------------


def read_stretches(path: str | os.PathLike) -> np.ndarray:
    """Read the columns stretch_x and stretch_y; others and lines that start with # are passed over.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    ndarray, shape (n, 2)

    Raises
    ------
    InputError
        With file, row, column and remedy.
    """
    path = Path(path)
    lines = ["" if line.lstrip().startswith("#") else line for line in read_lines(path)]
    rows = ((row, cells) for row, cells in rows_of(lines, path) if "".join(cells).strip())
    at_names, names = next(rows, (0, []))
    if not names:
        raise InputError("has no rows", file=path, remedy="give stretch_x,stretch_y and numbers")
    names = [cell.strip() for cell in names]
    for column in STRETCHES:
        if names.count(column) != 1:
            raise InputError(
                "missing column" if column not in names else "column appears twice",
                file=path,
                row=at_names,
                column=column,
                remedy="name the columns stretch_x,stretch_y",
            )
    stretches = []
    for row, cells in rows:
        if len(cells) != len(names):
            raise InputError(
                f"{len(cells)} cells where the header names {len(names)}", file=path, row=row
            )
        stretches.append([_stretch(cells[names.index(c)], path, row, c) for c in STRETCHES])
    if not stretches:
        raise InputError("has no rows", file=path, remedy="give one state of stretch a row")
    return np.array(stretches)


def _stretch(cell: str, path: Path, row: int, column: str) -> float:
    try:
        value = number_in(cell)
    except ValueError:
        value = 0.0
    if not STRETCH_RANGE[0] <= value <= STRETCH_RANGE[1]:
        raise InputError(
            f"{cell.strip()[:40]!r} is not a stretch",
            file=path,
            row=row,
            column=column,
            remedy=STRETCH_REMEDY,
        )
    return value
