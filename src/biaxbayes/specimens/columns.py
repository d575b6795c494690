"""The columns of a specimen file: which names are known, and what a wrong line of them means."""

from __future__ import annotations

import csv
import difflib
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.specimens.specimen import STRESS_PAIRS

__all__ = ["KNOWN_COLUMNS", "STRETCHES", "column_names"]

STRETCHES = ("stretch_x", "stretch_y")
KNOWN_COLUMNS = (
    *STRETCHES,
    "protocol",
    "time_s",
    *(name for pair in STRESS_PAIRS.values() for name in pair),
)
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
    names = [name.strip() for name in next(csv.reader([line], skipinitialspace=True))]
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
    close = difflib.get_close_matches(name[:60], KNOWN_COLUMNS, n=1, cutoff=0.75)
    hint = f"did you mean {close[0]}? " if close else ""
    return InputError(
        "unknown column",
        file=path,
        row=row,
        column=name[:60],
        remedy=f"{hint}known columns are {', '.join(KNOWN_COLUMNS)}",
    )
