"""Text files: read with limits and named errors, written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import stat
from pathlib import Path

from biaxbayes.errors import InputError

__all__ = [
    "atomic_write_bytes",
    "atomic_write_text",
    "read_bytes",
    "read_lines",
    "read_text",
    "sync_folder",
]

MAX_BYTES = 250_000_000
MAX_LINES = 3_000_000
MAX_LINE = 20_000
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")
"""Control characters that no text file needs; tab, line ends and form feed are none of them."""
SIGNATURES = {
    b"PK\x03\x04": ("an Excel workbook or a ZIP archive", "'biaxbayes convert' reads .xlsx"),
    b"\xd0\xcf\x11\xe0": ("an old Excel workbook", "save it as CSV UTF-8 or .xlsx"),
    b"\x1f\x8b": ("a gzip archive", "unpack it first"),
    b"\x89HDF": ("an HDF5 file", "export it as CSV"),
    b"%PDF": ("a PDF", "export the table as CSV"),
}


def read_bytes(path: Path, *, limit: int = MAX_BYTES) -> bytes:
    """Content of a regular file.

    Raises
    ------
    InputError
        If the file is missing, not a regular readable file, too large or empty.
    """
    try:
        mode = path.stat()
        if stat.S_ISDIR(mode.st_mode):
            raise InputError("is a folder, not a file", file=path, remedy="name the file in it")
        if not stat.S_ISREG(mode.st_mode):
            raise InputError("is not a regular file", file=path, remedy="name a file on disk")
        if mode.st_size > limit:
            raise InputError(
                f"is larger than {limit // 1_000_000} MB",
                file=path,
                remedy="thin or split the record",
            )
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", file=path, remedy="check the path") from None
    except PermissionError:
        raise InputError("may not be read", file=path, remedy="check its permissions") from None
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", file=path, remedy="check the path"
        ) from None
    except ValueError as error:
        raise InputError(f"is not a path ({error})", file=path, remedy="check the path") from None
    if not raw.strip(b" \t\r\n\0\xef\xbb\xbf"):
        raise InputError("is empty", file=path, remedy="export the record again")
    return raw


def read_text(path: Path, *, encoding: str = "utf-8-sig") -> str:
    r"""Text of a regular file, with line ends as ``\n``.

    Raises
    ------
    InputError
        As :func:`read_bytes`, and if the content is not UTF-8 text.
    """
    raw = read_bytes(path)
    for signature, (kind, remedy) in SIGNATURES.items():
        if raw.startswith(signature):
            raise InputError(f"is {kind}, not a text file", file=path, remedy=remedy)
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError("is UTF-16, not UTF-8 text", file=path, remedy="save it as CSV UTF-8")
    found = CONTROL.search(raw)
    if found:
        byte = found.group()[0]
        raise InputError(
            "is binary, not text" if byte == 0 else f"control character {byte:#04x}",
            file=path,
            row=_row(raw, found.start()),
            remedy="export it as CSV UTF-8",
        )
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        raise InputError(
            "is not UTF-8 text",
            file=path,
            row=_row(raw, error.start),
            remedy="save it as CSV UTF-8",
        ) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _row(raw: bytes, position: int) -> int:
    """Line, from 1, that a byte of a file stands in, whatever its line ends are."""
    before = raw[:position]
    return max(before.count(b"\n"), before.count(b"\r")) + 1


def read_lines(path: Path) -> list[str]:
    """Lines of a text file, as an editor counts them.

    Raises
    ------
    InputError
        As :func:`read_text`, and if there are too many lines or one is too long.
    """
    text = read_text(path)
    if text.count("\n") > MAX_LINES:
        raise InputError(
            f"has more than {MAX_LINES:,} lines", file=path, remedy="thin or split the record"
        )
    lines = text.split("\n")
    longest = max(map(len, lines))
    if longest > MAX_LINE:
        row = next(number for number, line in enumerate(lines, 1) if len(line) == longest)
        raise InputError(
            f"a line of {longest:,} characters",
            file=path,
            row=row,
            remedy="this is not a table of a biaxial test",
        )
    return lines


def atomic_write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that its name never shows half of it, surviving a power cut.

    Temporary name in the same folder, fsync, rename, fsync of the folder.

    Raises
    ------
    InputError
        If the file cannot be written; what was there before is untouched.
    """
    if not path.name or path.is_dir():
        raise InputError("is a folder, not a file", file=path, remedy="name a file")
    temporary = path.with_name(f".{path.name[:40]}.{os.getpid()}.tmp")
    try:
        # A name that is there already was left by a crash, or is somebody's link: never follow it.
        temporary.unlink(missing_ok=True)
        with temporary.open("xb") as handle:
            handle.write(data)
            handle.flush()
            os.fsync(handle.fileno())
        temporary.replace(path)
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror})", file=path, remedy="check space and permissions"
        ) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def atomic_write_text(path: Path, text: str) -> None:
    """UTF-8 text through :func:`atomic_write_bytes`."""
    atomic_write_bytes(path, text.encode("utf-8"))


def sync_folder(folder: Path) -> None:
    """Make renames in a folder survive a power cut, where the platform can."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return  # not every platform opens folders
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)
