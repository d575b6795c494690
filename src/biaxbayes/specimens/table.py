"""The table of a specimen file: named columns of numbers, each row with its line."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.cell import fault_of, number_in, one_line
from biaxbayes.specimens.columns import column_names

__all__ = ["Table", "read_table"]

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
    """

    columns: dict[str, np.ndarray]
    lines: np.ndarray
    groups: tuple[tuple[str, slice], ...]
    names_line: int

    def pair(self, names: Sequence[str], rows: slice = slice(None)) -> np.ndarray:
        """Some columns side by side, shape (n, len(names))."""
        return np.column_stack([self.columns[name][rows] for name in names])


@dataclass
class _Cells:
    """Flat numbers of the rows read so far, with the line and the protocol of each row."""

    numbers: array = field(default_factory=lambda: array("d"))
    lines: array = field(default_factory=lambda: array("q"))
    codes: array = field(default_factory=lambda: array("q"))
    labels: dict[str, int] = field(default_factory=dict)


def read_table(lines: Sequence[str], first: int, path: Path) -> Table:
    """Read the table below the header.

    Parameters
    ----------
    lines : sequence of str
        All lines of the file.
    first : int
        Index of the line with the column names.
    path : Path
        For messages.

    Returns
    -------
    Table

    Raises
    ------
    InputError
        Naming row and column of the first fault.
    """
    names = column_names(lines[first], first + 1, path)
    numeric = [name for name in names if name != "protocol"]
    cells = _read_cells(lines, first, names, path)
    count = len(cells.lines)
    if count < 2:
        raise InputError(
            "only 1 row of data" if count else "no row of data below the column names",
            file=path,
            row=cells.lines[0] if count else first + 1,
            remedy="a test needs the mounted state and at least one stretched state",
        )
    matrix = np.frombuffer(cells.numbers, dtype=float).reshape(count, len(numeric))
    line_of = np.frombuffer(cells.lines, dtype=np.int64)
    if not np.isfinite(matrix).all():
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        problem, remedy = fault_of(f"{matrix[row, column]:g}")
        raise InputError(
            problem, file=path, row=int(line_of[row]), column=numeric[column], remedy=remedy
        )
    return Table(
        columns=dict(zip(numeric, np.ascontiguousarray(matrix.T), strict=True)),
        lines=line_of,
        groups=_groups(
            list(cells.labels), np.frombuffer(cells.codes, dtype=np.int64), line_of, path
        ),
        names_line=first + 1,
    )


def _read_cells(lines: Sequence[str], first: int, names: list[str], path: Path) -> _Cells:
    labelled = names.index("protocol") if "protocol" in names else None
    numeric = [name for name in names if name != "protocol"]
    # float() takes '1_000' for a number; look closely only where an underscore occurs.
    plain = not any("_" in line for line in islice(lines, first + 1, None))
    out = _Cells()
    row = first + 1
    reader = csv.reader(islice(lines, first + 1, None), skipinitialspace=True)
    try:
        for cells in reader:
            if first + 1 + reader.line_num > row + 1:
                raise csv.Error("a quotation mark is not closed")
            row += 1
            if len(cells) != len(names) or not any(cells):
                if not any(cell.strip() for cell in cells):
                    continue  # a blank line
                cells = _trimmed(cells, names, row, path)
            if labelled is not None:
                label = cells.pop(labelled)
                out.codes.append(out.labels.setdefault(label, len(out.labels)))
            try:
                if not plain and "_" in "".join(cells):
                    raise ValueError
                out.numbers.extend(map(float, cells))
            except ValueError:
                raise _bad_cell(cells, numeric, row, path) from None
            out.lines.append(row)
    except csv.Error as error:
        raise InputError(
            f"not a row of a CSV: {error}",
            file=path,
            row=row + 1,
            remedy="look for a stray quotation mark",
        ) from None
    return out


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


def _bad_cell(cells: list[str], numeric: list[str], row: int, path: Path) -> InputError:
    for name, cell in zip(numeric, cells, strict=True):
        try:
            number_in(cell)
        except ValueError:
            problem, remedy = fault_of(cell)
            return InputError(problem, file=path, row=row, column=name, remedy=remedy)
    return InputError("a cell is not a number", file=path, row=row)


def _groups(
    labels: list[str], codes: np.ndarray, lines: np.ndarray, path: Path
) -> tuple[tuple[str, slice], ...]:
    """Rows of each protocol; a file without the column holds one, named ``1``."""
    if not labels:
        return (("1", slice(0, len(lines))),)
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    if starts.size > MAX_PROTOCOLS:
        raise InputError(
            f"more than {MAX_PROTOCOLS} protocols",
            file=path,
            row=int(lines[starts[MAX_PROTOCOLS]]),
            column="protocol",
            remedy="the column names the loading path, the same in all its rows",
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
