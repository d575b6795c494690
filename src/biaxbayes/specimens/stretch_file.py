"""A CSV of stretches: a path on which to predict."""

from __future__ import annotations

import csv
import math
import os
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.text_file import read_text

__all__ = ["read_stretches"]

COLUMNS = ("stretch_x", "stretch_y")
RANGE = (0.2, 5.0)


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
    lines = [
        (number, line)
        for number, line in enumerate(read_text(path).splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise InputError("has no rows", file=path, remedy="give stretch_x,stretch_y and numbers")
    names = [cell.strip() for cell in next(csv.reader([lines[0][1]]))]
    for column in COLUMNS:
        if names.count(column) != 1:
            raise InputError(
                "missing column" if column not in names else "column appears twice",
                file=path,
                row=lines[0][0],
                column=column,
                remedy="name the columns stretch_x,stretch_y",
            )
    at = [names.index(column) for column in COLUMNS]
    rows = []
    for number, line in lines[1:]:
        cells = next(csv.reader([line]))
        if len(cells) != len(names):
            raise InputError(
                f"{len(cells)} cells where the header names {len(names)}", file=path, row=number
            )
        rows.append([_stretch(cells[i], path, number, names[i]) for i in at])
    if not rows:
        raise InputError("has no rows", file=path, remedy="give one state of stretch a row")
    return np.array(rows)


def _stretch(cell: str, path: Path, row: int, column: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not RANGE[0] <= value <= RANGE[1]:
        raise InputError(
            f"{cell.strip()[:40]!r} is not a stretch",
            file=path,
            row=row,
            column=column,
            remedy="stretches are ratios near 1, not strains or per cent",
        )
    return value
