"""Text files and CSV tables: errors name file, row and column; writing is atomic."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import math
import os
import re
import stat
import traceback
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError, printable

if TYPE_CHECKING:
    import pandas as pd

MAX_TEXT_BYTES = 250_000_000
MAX_LINES = 3_000_000
MAX_LINE = 20_000
CONTROL_BYTES = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")
"""Control characters other than tab, line ends and form feed."""
SIGNATURES = {
    b"PK\x03\x04": (
        "an Excel workbook or a ZIP archive",
        "'biaxbayes convert' reads .xlsx and .ods",
    ),
    b"\xd0\xcf\x11\xe0": ("an old Excel workbook", "'biaxbayes convert' reads .xls"),
    b"\x1f\x8b": ("a gzip archive", "unpack it first"),
    b"\x89HDF": ("an HDF5 file", "export it as CSV"),
    b"%PDF": ("a PDF", "export the table as CSV"),
}
"""First bytes of files other than text, with their kind and a remedy."""
EMPTY_REMEDIES = {
    **dict.fromkeys(("", ".csv", ".tsv", ".txt", ".xls", ".xlsx"), "export the record again"),
    ".toml": "write its settings into it",
}
"""Remedies for an empty file by its suffix."""
DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
DECIMAL_POINT = re.compile(r"[+-]?\d+\.\d+([eE][+-]?\d+)?")
NUMBER_WITH_UNIT = re.compile(r"[+-]?\d+\.?\d*([eE][+-]?\d+)?\s*[^\W\d_%]*[%\w/^°]*")
FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""Texts that a spreadsheet computes (``=1+1``), also after an apostrophe that marks text."""


# --- reading text files ---------------------------------------------------------------------------


def read_bytes(path: Path, *, limit: int = MAX_TEXT_BYTES) -> bytes:
    """Content of a regular file that is neither empty nor larger than the limit."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError("is a folder, not a file", file=path, remedy="name the file in it")
        if not stat.S_ISREG(status.st_mode):
            raise InputError("is not a regular file", file=path, remedy="name a file on disk")
        if status.st_size > limit:
            problem = f"is larger than {limit // 1_000_000} MB"
            raise InputError(problem, file=path, remedy="split the record, or leave out rows")
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", file=path, remedy="check the path") from None
    except PermissionError:
        raise InputError("cannot be read", file=path, remedy="check its permissions") from None
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
        raise InputError(problem, file=path, remedy="check the path") from None
    except ValueError as error:
        raise InputError(f"is not a path ({error})", file=path, remedy="check the path") from None
    if not raw.strip(b" \t\r\n\0\xef\xbb\xbf"):
        remedy = EMPTY_REMEDIES.get(path.suffix.lower(), "check the path")
        raise InputError("is empty", file=path, remedy=remedy)
    return raw


def read_text(path: Path) -> str:
    r"""UTF-8 text of a regular file, with line ends as ``\n``."""
    raw = read_bytes(path)
    for signature, (kind, remedy) in SIGNATURES.items():
        if raw.startswith(signature):
            raise InputError(f"is {kind}, not a text file", file=path, remedy=remedy)
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError("is UTF-16, not UTF-8 text", file=path, remedy="save it as CSV UTF-8")

    def row(position: int) -> int:
        before = raw[:position]
        return max(before.count(b"\n"), before.count(b"\r")) + 1

    control = CONTROL_BYTES.search(raw)
    if control:
        byte = control.group()[0]
        problem = "is binary, not text" if byte == 0 else f"control character {byte:#04x}"
        remedy = "export it as CSV UTF-8"
        raise InputError(problem, file=path, row=row(control.start()), remedy=remedy)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        remedy, at = "save it as CSV UTF-8", row(error.start)
        raise InputError("is not UTF-8 text", file=path, row=at, remedy=remedy) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_lines(path: Path) -> list[str]:
    """Lines of a text file, as an editor counts them."""
    lines = read_text(path).split("\n")
    if len(lines) > MAX_LINES + 1:
        problem = f"has more than {MAX_LINES:,} lines"
        raise InputError(problem, file=path, remedy="split the record, or leave out rows")
    for row, line in enumerate(lines, 1):
        if len(line) > MAX_LINE:
            problem = f"a line of {len(line):,} characters"
            remedy = "this is not a table of a biaxial test"
            raise InputError(problem, file=path, row=row, remedy=remedy)
    return lines


def read_toml(path: Path) -> dict[str, Any]:
    """Table of a TOML file."""
    import tomllib

    try:
        return tomllib.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        why = str(error)[:80] if isinstance(error, ValueError) else "nested too deeply"
        raise InputError(f"not valid TOML ({why})", file=path) from None


# --- cells ----------------------------------------------------------------------------------------


def number_in(text: str) -> float:
    """The finite number in a cell, else ValueError; unlike float(), refuses ``1_000``."""
    value = float(text)
    if "_" in text or not math.isfinite(value):
        raise ValueError("not a finite number")
    return value


def is_number(cell: str) -> bool:
    """True if a cell is a number, with a decimal point or a decimal comma."""
    try:
        number_in(cell.replace(",", ".", 1))
    except ValueError:
        return False
    return True


def cell_fault(text: str) -> tuple[str, str]:
    """Describe a cell that holds no finite number, and what to do about it."""
    cell = text.strip()
    shown = repr(cell[:40])
    if not cell:
        return "the cell is empty", "fill it in or remove the row"
    if cell.startswith("="):
        return f"{shown} is a formula, not a number", "save the values in place of formulas"
    if DECIMAL_COMMA.fullmatch(cell):
        return f"{shown} has a decimal comma", "write it with a decimal point"
    if DECIMAL_POINT.fullmatch(cell):
        problem = f"{shown} has a decimal point where other numbers have decimal commas"
        return problem, "export the table with one of them and no thousands separators"
    try:
        value = float(cell.replace("_", "x"))
    except ValueError:
        if NUMBER_WITH_UNIT.fullmatch(cell):
            return f"{shown} is not a plain number", "write it without unit or separators"
        return f"{shown} is not a number", "mend the value or remove the row"
    if math.isnan(value):
        return f"{shown} is not a finite number: the reading is missing", "remove the row"
    return f"{shown} is not a finite number", "mend the value or remove the row"


def one_line(text: str) -> str:
    """Text of a name: printable, in one line, with single spaces, none at the ends."""
    return " ".join(printable(text).split())


def first_few(texts: Sequence[str], most: int, separator: str = ", ") -> str:
    """The first of some texts, and how many more there are: ``a, b and 5 more``."""
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return separator.join(texts[:most]) + more


def without_empty_end(cells: Sequence[str]) -> list[str]:
    """Cells without the empty ones at the end, as spreadsheets write."""
    last = max((k for k, cell in enumerate(cells) if cell.strip()), default=-1)
    return list(cells[: last + 1])


def cells_of(line: str) -> list[str]:
    """Cells of a single line; spaces before a cell are not part of it."""
    return next(csv.reader([line], skipinitialspace=True), [])


def rows_of(
    lines: Sequence[str], path: Path, *, first: int = 0, separator: str = ",", in_cell: int = 1
) -> Iterator[tuple[int, list[str]]]:
    """First line (from 1) and cells of each row from index `first`; `in_cell`: lines of a cell."""
    ended = (f"{line}\n" for line in islice(lines, first, None))
    reader = csv.reader(ended, delimiter=separator, skipinitialspace=True)
    number = first
    try:
        for cells in reader:
            # the csv module joins lines with an open quotation mark between them
            if first + reader.line_num > number + in_cell:
                raise csv.Error("a quotation mark is not closed")
            yield number + 1, cells
            number = first + reader.line_num
    except csv.Error as error:
        problem = f"not a row of a CSV: {error}"
        remedy = "look for a stray quotation mark"
        raise InputError(problem, file=path, row=number + 1, remedy=remedy) from None


# --- writing --------------------------------------------------------------------------------------


def safe_file_name(text: str, default: str = "", limit: int = 60) -> str:
    """Text as a part of a file name that every file system accepts."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", text).strip(".-")[:limit] or default


def as_path(value: Any, name: str) -> Path:
    """The path that an argument of this name gives; refuses what is none."""
    if not isinstance(value, str | os.PathLike):
        raise InputError(f"`{name}` must be a path, not {type(value).__name__}")
    return Path(value)


def make_folder(path: Any) -> Path:
    """Make a folder to write into, where it does not exist."""
    folder = as_path(path, "out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=folder) from None
    return folder


MADE_HERE = "made by biaxbayes"
"""Pictures and pages of this program have it, as a comment."""


def refuse_foreign(path: Path) -> None:
    """Refuse to replace a file that is not empty and no picture or page of this program."""
    if path.is_dir():
        raise InputError("is a folder, not a file", file=path, remedy="give a file name")
    if path.exists() and path.stat().st_size and MADE_HERE.encode() not in path.read_bytes():
        remedy = "choose another name, or remove it"
        raise InputError("exists, and biaxbayes did not make it", file=path, remedy=remedy)


def atomic_write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write a file whole or not at all, also on a power cut: temporary name, fsync, rename."""
    atomic_write_all({path: data})


def atomic_write_all(contents: Mapping[Path, bytes | memoryview]) -> None:
    """Write files that belong together: none takes its name before all are on the disk."""
    temporary = {path: path.with_name(f".{path.name[:40]}.{os.getpid()}.tmp") for path in contents}
    try:
        for path, data in contents.items():
            if not path.name or path.is_dir():
                raise InputError("is a folder, not a file", file=path, remedy="name a file")
            if not path.parent.is_dir():
                problem = f"the folder {path.parent} does not exist"
                raise InputError(problem, file=path, remedy="make it, or name another")
            # an existing name was left by a crash, or is a link that must not be followed
            temporary[path].unlink(missing_ok=True)
            with temporary[path].open("xb") as handle:
                handle.write(data)
                handle.flush()
                os.fsync(handle.fileno())
        for path in contents:
            temporary[path].replace(path)
    except OSError as error:
        problem = f"cannot be written ({error.strerror})"
        raise InputError(problem, file=path, remedy="check space and permissions") from None
    finally:
        for waiting in temporary.values():
            with contextlib.suppress(OSError):
                waiting.unlink(missing_ok=True)
    for folder in {path.parent for path in contents}:
        sync_folder(folder)
    for path, data in contents.items():
        for folder in list(path.parents)[:3]:  # the lists of its folder and of the two above
            name, lists = path.relative_to(folder).as_posix(), folder / WRITTEN
            if lists.is_file() and not lists.is_symlink() and "/." not in f"/{name}":
                with contextlib.suppress(OSError), lists.open("a", encoding="utf-8") as lines:
                    lines.write(f"{hashlib.sha256(data).hexdigest()}  {name}\n")


WRITTEN = ".written"
"""List in a folder of what was written into it: lines of SHA-256 and name, as sha256sum has them.
A folder that has one is of a run, say: these files go when its draws are replaced."""


def atomic_write_text(path: Path, text: str) -> None:
    """UTF-8 text through :func:`atomic_write_bytes`; of the name of a file it may not be UTF-8."""
    atomic_write_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def sync_folder(folder: Path) -> None:
    """Make renames in a folder survive a power cut, where the platform can."""
    with contextlib.suppress(OSError):  # not every platform opens folders
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


# --- tables of this program -----------------------------------------------------------------------


def read_csv(path: Path, **how: Any) -> pd.DataFrame:
    """Read a table of this program."""
    import pandas as pd

    def unmarked(cell: Any) -> Any:
        marked = isinstance(cell, str) and cell.startswith("'") and FORMULA.match(cell)
        return cell[1:] if marked else cell

    return _with_texts(pd.read_csv(path, **how), unmarked)


def write_csv(path: Path, table: pd.DataFrame, *, digits: int | None = None) -> None:
    """Write a table without its index, atomically; `digits` are significant, default all."""
    atomic_write_text(path, csv_text(table, digits=digits))


def csv_text(table: pd.DataFrame, *, digits: int | None = None) -> str:
    """A table without its index as :func:`write_csv` writes it."""

    def marked(cell: Any) -> Any:
        """A text that a spreadsheet would compute, marked as text by an apostrophe."""
        computed = isinstance(cell, str) and FORMULA.match(cell) and cell != "-"
        return f"'{cell}" if computed and not is_number(cell) else cell

    form = None if digits is None else f"%.{digits}g"
    marked_table = _with_texts(table, marked)
    return str(marked_table.to_csv(index=False, float_format=form, lineterminator="\n"))


def _with_texts(table: pd.DataFrame, change: Any) -> pd.DataFrame:
    """A table with each of its texts changed, those of its column names included."""
    words = table.select_dtypes(exclude=["number", "bool"]).columns
    changed = table.assign(**{name: table[name].map(change) for name in words})
    return changed.rename(columns=change)


def aligned(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """Lines of a table for a terminal; columns in `right` are right-aligned."""
    columns = range(max(map(len, rows), default=0))
    widths = [max(len(row[k]) for row in rows if k < len(row)) for k in columns]
    return [
        "  ".join(
            cell.rjust(widths[k]) if k in right else cell.ljust(widths[k])
            for k, cell in enumerate(row)
        ).rstrip()
        for row in rows
    ]


# --- errors of the operating system ---------------------------------------------------------------


def os_error_text(error: OSError) -> str:
    """An error of the operating system in one line with its path."""
    return f"{f'{error.filename}: ' if error.filename else ''}{error.strerror or error}"


def cache_problem(error: Exception) -> str:
    """What to do about an error in numba's cache of compiled code; empty for other errors."""
    frames = traceback.walk_tb(error.__traceback__)
    if not any(frame.f_globals.get("__name__") == "numba.core.caching" for frame, _ in frames):
        return ""
    from biaxbayes.compilation import CACHE  # loaded, as its functions are being compiled

    if isinstance(error, OSError):
        where = error.filename or CACHE
        remedy = "NUMBA_CACHE_DIR names another folder for compiled code"
        return f"{where}: {error.strerror or error}; check space and permissions; {remedy}"
    for path in CACHE.rglob("*.nb[ic]") if CACHE else ():
        with contextlib.suppress(OSError):
            path.unlink()
    return f"{CACHE}: compiled code was damaged and is removed; run the same command again"
