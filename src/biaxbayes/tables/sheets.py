"""A file of any format as sheets of text cells; text files are read here."""

from __future__ import annotations

import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.tables.child import Reader, read_in_child
from biaxbayes.tables.table import plain
from biaxbayes.tables.worksheet import MAX_CELLS, MINUS, Worksheet
from biaxbayes.text_files import SIGNATURES, is_number, read_bytes, rows_of

MAX_WORKBOOK_BYTES = 64_000_000
MAX_ROWS = 500_000
CONTROL_CHARACTERS = re.compile("[\\x00-\\x08\\x0e-\\x1f\\x7f]")
WORDS = re.compile(r"[^ \t]+")
"""What stands between spaces; a narrow space may be a mark between thousands."""
LINES_OF_A_CELL = 5
"""Largest number of lines of a quoted cell."""
SEPARATORS = {"\t": "tabs", ";": "semicolons", "|": "bars", " ": "spaces", ",": "commas"}
SEPARATOR_LINES, LEAST_LINES = 200, 10
"""Lines at the end of the file from which its separator is read, at most and at least."""


WORKBOOK = Reader("workbook", "workbook", "python-calamine")
MATLAB = Reader("matlab", "MATLAB file", "h5py")
TDMS = Reader("tdms", "LabVIEW TDMS file", "npTDMS")
NUMPY = Reader("matlab", "NumPy file", "numpy")
READERS = {
    b"\xd0\xcf\x11\xe0": WORKBOOK,
    b"MATLAB 5.0 MAT-file": MATLAB,
    b"MATLAB 7.3 MAT-file": MATLAB,
    b"TDSm": TDMS,
}
"""Readers by the first bytes of a file; anything else is an archive or text."""


def read_sheets(path: Path) -> dict[str, Worksheet]:
    """Sheets of a file by name; a text file has one without a name."""
    raw = read_bytes(path, limit=MAX_WORKBOOK_BYTES)
    reader = next((r for first, r in READERS.items() if raw.startswith(first)), None)
    if raw.startswith(b"PK\x03\x04"):
        reader = _archive_reader(path)
    if reader is not None:
        return read_in_child(path, reader)
    for signature, (kind, remedy) in SIGNATURES.items():
        if raw.startswith(signature):
            raise InputError(f"is {kind}, not a table", file=path, remedy=remedy)
    return {"": _text_sheet(raw, path)}


def _archive_reader(path: Path) -> Reader:
    """The reader of a ZIP archive by the names in it."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError):
        return WORKBOOK  # which will say that it is damaged
    if names and all(name.endswith(".npy") for name in names):
        return NUMPY
    if not {"[Content_Types].xml", "content.xml", "mimetype"} & set(names):
        remedy = f"unpack it and name the tables in it: {', '.join(names)[:200]}"
        raise InputError("is a ZIP archive, not a table", file=path, remedy=remedy)
    return WORKBOOK


# --- text files -----------------------------------------------------------------------------------


def _text_sheet(raw: bytes, path: Path) -> Worksheet:
    """The cells of a text file in any usual separator and encoding."""
    text, encoding = _decoded(raw, path)
    # CR CR LF is one end of a line that two programs wrote
    lines = re.sub(r"\r+\n|\r", "\n", text).split("\n")
    separator = _separator(lines, path)
    if len(lines) > MAX_ROWS or text.count(separator) > MAX_CELLS:
        problem = f"has more than {MAX_ROWS:,} lines or {MAX_CELLS:,} cells"
        raise InputError(problem, file=path, remedy="cut out the cycle of interest")
    if separator == " ":
        lines = ["\t".join(WORDS.findall(line)) for line in lines]
    sheet = Worksheet([], [], [] if encoding == "UTF-8" else [f"read as {encoding}"], text=True)
    if separator != ",":
        sheet.notes.append(f"columns separated by {SEPARATORS[separator]}")
    cut = "\t" if separator == " " else separator
    for number, cells in rows_of(lines, path, separator=cut, in_cell=LINES_OF_A_CELL):
        if cells and cells[0].startswith("#"):
            first = cells[0].lstrip("#").strip()
            if not sheet.rows:
                sheet.names[:] = [first, *cells[1:]] if first else cells[1:]
        elif "".join(cells).strip():
            sheet.rows.append(cells)
            sheet.lines.append(number)
    return sheet


def _decoded(raw: bytes, path: Path) -> tuple[str, str]:
    """Text and its encoding: Unicode, otherwise the code page of instruments on Windows."""
    encoding = "utf-16" if raw.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
    nulls = raw[:2000:2].count(0), raw[1:2000:2].count(0)
    if encoding == "utf-8-sig" and max(nulls) > 0.4 * len(raw[:2000:2]):
        encoding = "utf-16-be" if nulls[0] > nulls[1] else "utf-16-le"
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        if encoding.startswith("utf-16"):
            raise InputError(
                "is damaged UTF-16 text", file=path, remedy="export it again"
            ) from None
        encoding, text = "Windows-1252", raw.decode("cp1252", errors="replace")
    text = text.removesuffix("\x1a").replace(MINUS, "-")  # old programs mark the end of a file
    control = CONTROL_CHARACTERS.search(text)
    if control:
        row = text[: control.start()].count("\n") + 1
        raise InputError("is binary, not text", file=path, row=row, remedy="export it as CSV")
    return text, encoding.replace("utf-8-sig", "UTF-8").replace("utf", "UTF")


def _separator(lines: Sequence[str], path: Path) -> str:
    """The separator that cuts most of the last lines into the same number of cells."""
    sample = [line for line in lines if line.strip() and not line.startswith("#")]
    last = sample = sample[-SEPARATOR_LINES:]
    while len(last) >= LEAST_LINES or last is sample:
        separator = _separator_of(last)
        if separator:
            return separator
        last = last[len(last) // 2 :]
    shown = sample[0].strip()[:60] if sample else ""
    problem = f"holds no table with columns; its first line reads {shown!r}"
    remedy = "export it with commas, semicolons or tabs between the columns"
    raise InputError(problem, file=path, remedy=remedy)


def _separator_of(sample: Sequence[str]) -> str:
    """The separator of most of some lines; empty without one."""
    words = [WORDS.findall(line) for line in sample]

    def usual(counts: Iterable[int]) -> int:
        """The count that most lines have; 0 if these are few."""
        ((count, often),) = Counter(counts).most_common(1) or [(0, 0)]
        return count if often >= 0.6 * len(sample) else 0

    for separator in SEPARATORS:
        counts = [line.count(separator) for line in sample]
        if separator == " ":
            # Only where all is numbers: decimal commas between spaces look like separators.
            counts = [
                len(w) - 1 for w in words if len(w) > 1 and all(map(is_number, map(plain, w)))
            ]
        if usual(counts) >= 1:
            return separator
    if usual(map(len, words)) >= 2 and any(map(is_number, sample[-1].split())):
        return " "
    return ""
