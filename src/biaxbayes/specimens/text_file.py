"""Text files: read with a size limit and named errors, written whole or not at all."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from biaxbayes.errors import InputError

__all__ = ["atomic_write_bytes", "atomic_write_text", "read_text"]

MAX_BYTES = 1_000_000_000


def read_text(path: Path, *, encoding: str = "utf-8-sig") -> str:
    """Text of a regular file, with line ends as ``\\n``.

    Raises
    ------
    InputError
        If the file is missing, not a regular readable file, too large, empty or not UTF-8.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise InputError("is a folder, not a file", file=path, remedy="name the CSV in it")
        if not stat.S_ISREG(mode):
            raise InputError("is not a regular file", file=path)
        if path.stat().st_size > MAX_BYTES:
            raise InputError("is larger than 1 GB", file=path, remedy="thin or split the record")
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", file=path, remedy="check the path") from None
    except PermissionError:
        raise InputError("may not be read", file=path, remedy="check its permissions") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from None
    except ValueError as error:
        raise InputError(f"is not a path ({error})", file=path) from None
    if not raw.strip():
        raise InputError("is empty", file=path, remedy="export the record again")
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        row = raw[: error.start].count(b"\n") + 1
        raise InputError(
            "is not UTF-8 text", file=path, row=row, remedy="save it as CSV UTF-8"
        ) from None
    if "\0" in text:
        row = text[: text.index("\0")].count("\n") + 1
        raise InputError("is binary, not text", file=path, row=row, remedy="export it as CSV")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def atomic_write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that its name never shows half of it, surviving a power cut.

    Temporary name in the same folder, fsync, rename, fsync of the folder.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as handle:
            handle.write(data)
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError(
            f"cannot be written ({error.strerror})", file=path, remedy="check space and permissions"
        ) from None
    _sync_folder(path.parent)


def atomic_write_text(path: Path, text: str) -> None:
    """UTF-8 text through :func:`atomic_write_bytes`."""
    atomic_write_bytes(path, text.encode("utf-8"))


def _sync_folder(folder: Path) -> None:
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
