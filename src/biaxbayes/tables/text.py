"""Text tables in any usual separator and encoding."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.tables.sheets import MAX_CELLS, MAX_ROWS, Sheet
from biaxbayes.text_files import is_number, rows_of

CONTROL = re.compile("[\\x00-\\x08\\x0e-\\x1f\\x7f]")
SEPARATORS = {"\t": "tabs", ";": "semicolons", "|": "bars", " ": "spaces", ",": "commas"}
SAMPLE = 200
"""Lines at the end of the file that tell its separator; a preamble stands at the start."""


def sheets(raw: bytes, path: Path) -> dict[str, Sheet]:
    """The one sheet of a text file."""
    text, encoding = _decoded(raw, path)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    separator = _separator(lines, path)
    if len(lines) > MAX_ROWS or text.count(separator) > MAX_CELLS:
        raise InputError(
            f"has more than {MAX_ROWS:,} lines or {MAX_CELLS:,} cells",
            file=path,
            remedy="cut out the cycle of interest",
        )
    if separator == " ":
        lines = ["\t".join(line.split()) for line in lines]
    sheet = Sheet([], [], [] if encoding == "UTF-8" else [f"read as {encoding}"], text=True)
    if separator != ",":
        sheet.notes.append(f"columns separated by {SEPARATORS[separator]}")
    cut = "\t" if separator == " " else separator
    for number, cells in rows_of(lines, path, separator=cut, kind="a table"):
        if cells and cells[0].startswith("#"):
            first = cells[0].lstrip("#").strip()
            if not sheet.rows:
                sheet.names[:] = [first, *cells[1:]] if first else cells[1:]
        elif "".join(cells).strip():
            sheet.rows.append(cells)
            sheet.lines.append(number)
    return {"": sheet}


def _decoded(raw: bytes, path: Path) -> tuple[str, str]:
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            text, encoding = raw.decode("utf-16"), "UTF-16"
        except UnicodeDecodeError:
            raise InputError(
                "is damaged UTF-16 text", file=path, remedy="export it again"
            ) from None
    else:
        try:
            text, encoding = raw.decode("utf-8-sig"), "UTF-8"
        except UnicodeDecodeError:
            # Instrument software on Windows writes its own code page, in names only.
            text, encoding = raw.decode("cp1252", errors="replace"), "Windows-1252"
    control = CONTROL.search(text)
    if control:
        row = text[: control.start()].count("\n") + 1
        raise InputError("is binary, not text", file=path, row=row, remedy="export it as CSV")
    return text, encoding


def _separator(lines: Sequence[str], path: Path) -> str:
    """The separator that cuts most lines into the same number of cells."""
    sample = [line for line in lines if line.strip() and not line.startswith("#")][-SAMPLE:]
    for separator in SEPARATORS:
        if separator == " ":
            # Only where all is numbers: decimal commas between spaces look like separators.
            counts = Counter(len(x.split()) - 1 for x in sample if _all_numbers(x.split()))
        else:
            counts = Counter(line.count(separator) for line in sample)
        count, often = counts.most_common(1)[0] if counts else (0, 0)
        if count >= 1 and often >= 0.6 * len(sample):
            return separator
    counts = Counter(len(line.split()) for line in sample)
    count, often = counts.most_common(1)[0] if counts else (0, 0)
    if count >= 2 and often >= 0.6 * len(sample) and any(map(is_number, sample[-1].split())):
        return " "
    shown = sample[0].strip()[:60] if sample else ""
    raise InputError(
        f"holds no table with columns; its first line reads {shown!r}",
        file=path,
        remedy="export it with commas, semicolons or tabs between the columns",
    )


def _all_numbers(cells: Sequence[str]) -> bool:
    return len(cells) > 1 and all(map(is_number, cells))
