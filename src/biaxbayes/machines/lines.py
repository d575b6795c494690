"""Lines of a file that the user asks for."""

from __future__ import annotations

import numpy as np

from biaxbayes.errors import InputError


def outside(lines: np.ndarray, wanted: str | None, file: object) -> np.ndarray:
    """A reason for each line outside ``12:480`` or ``2:30,32:61``, empty for the others."""
    if wanted in (None, "all"):
        return np.full(lines.size, "", dtype=object)
    inside = np.zeros(lines.size, dtype=bool)
    for part in str(wanted).split(","):
        first, colon, last = part.strip().partition(":")
        if not (colon and first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
            raise InputError(
                f"`rows`: {part.strip()[:40]!r} is not of the form 12:480",
                remedy="give first and last line of the file, several ranges with commas, or all",
            )
        inside |= (lines >= int(first)) & (lines <= int(last))
    if inside.sum() < 2:
        raise InputError(
            f"`rows` {str(wanted)[:40]} leaves {inside.sum()} rows",
            file=file,
            remedy=f"the table is in lines {lines[0]} to {lines[-1]}",
        )
    return np.where(inside, "", "not in the rows that were asked for").astype(object)


def ranges_without(lines: np.ndarray, rows: np.ndarray) -> str:
    """The value of ``rows`` that keeps all lines but those of some rows."""
    kept = np.ones(lines.size, dtype=bool)
    kept[rows] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    return ",".join(f"{lines[a]}:{lines[b - 1]}" for a, b in edges.reshape(-1, 2))
