"""CSV tables that explain themselves: notes in lines that start with ``#``, then the rows."""

from __future__ import annotations

import csv
import textwrap
from collections.abc import Iterable
from pathlib import Path

import pandas as pd

from biaxbayes.specimens.text_file import atomic_write_text

__all__ = ["write_annotated"]

WIDTH = 98


def write_annotated(table: pd.DataFrame, notes: Iterable[str], path: Path, digits: int = 6) -> None:
    """Write a table that ``pandas.read_csv(path, comment="#")`` reads back.

    Parameters
    ----------
    table : DataFrame
    notes : iterable of str
        Wrapped to lines of 98 characters.
    path : Path
    digits : int
        Significant digits of floating-point numbers.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    head = "".join(
        textwrap.fill(note, WIDTH, initial_indent="# ", subsequent_indent="#   ") + "\n"
        for note in notes
    )
    rounded = table.copy()
    for name in rounded.columns[[pd.api.types.is_float_dtype(t) for t in rounded.dtypes]]:
        rounded[name] = [float(f"{v:.{digits}g}") for v in rounded[name]]
    # Text is quoted, so that a '#' in the name of a protocol starts no comment.
    text = rounded.to_csv(index=False, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    atomic_write_text(path, head + text)
