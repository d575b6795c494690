"""The files of a run appear together: written aside, then moved into place.

Until the last file is written, what was in the folder before stays as it was. The folder with the
new files is then renamed to a fixed name; from there on they are the run, and whoever comes
next finishes moving them if a crash got in between.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from biaxbayes.errors import BiaxbayesError, RunError
from biaxbayes.specimens.text_file import read_bytes, sync_folder

__all__ = [
    "PROVENANCE",
    "READY",
    "clear_leftovers",
    "finish_moving",
    "is_run",
    "manifest",
    "staged",
]

PROVENANCE = "provenance.json"
"""Moved last: with it the folder is a finished run."""
WRITING, READY = ".writing-", ".ready"
TEMPORARY = re.compile(r"\..+\.\d+\.tmp")
"""Names of files half-written, as :func:`atomic_write_bytes` chooses them."""


@contextlib.contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A fresh folder to write a run's files into; they replace the old ones at the end.

    Parameters
    ----------
    folder : Path
        The run folder, whose lock is held.

    Raises
    ------
    RunError
        If anything cannot be written; what was there before is untouched.
    """
    kept = "what was there before is untouched, and --resume continues"
    try:
        aside = Path(tempfile.mkdtemp(prefix=WRITING, dir=folder))
        try:
            yield aside
            for path in aside.iterdir():
                _sync(path)
            sync_folder(aside)
            aside.replace(folder / READY)
            sync_folder(folder)
        except BiaxbayesError as error:
            # Named by where the file was to be, not by the passing folder it was written in.
            problem = str(error).replace(f"{aside.name}{os.sep}", "")
            raise RunError(f"{problem}; {kept}") from None
        finally:
            shutil.rmtree(aside, ignore_errors=True)
        finish_moving(folder)
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be written ({error.strerror or error}); check space and "
            f"permissions; {kept}"
        ) from None


def finish_moving(folder: Path) -> None:
    """Move finished files into place, also those that a crash left waiting; no-op without any."""
    ready = folder / READY
    if ready.is_symlink() or not ready.is_dir():
        return
    listed = _listed(ready / PROVENANCE)
    for name, digest in _listed(folder / PROVENANCE).items():
        # A product of the run before that this one does not have; never a file of the user's.
        if listed and name not in listed and _digest(folder / name) == digest:
            (folder / name).unlink(missing_ok=True)
    waiting = sorted(p for p in ready.iterdir() if p.is_file() and not p.is_symlink())
    for path in sorted(waiting, key=lambda p: p.name == PROVENANCE):
        path.replace(folder / path.name)
    sync_folder(folder)
    shutil.rmtree(ready, ignore_errors=True)


def clear_leftovers(folder: Path) -> None:
    """Remove what a killed process left half-written; the lock of the folder is held."""
    for path in folder.glob(f"{WRITING}*"):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
    for path in folder.iterdir():
        if TEMPORARY.fullmatch(path.name):
            with contextlib.suppress(OSError):
                path.unlink()


def manifest(folder: Path) -> dict[str, str]:
    """SHA-256 of every file in a folder, but for the provenance that is to hold them."""
    names = sorted(p.name for p in folder.iterdir() if p.is_file() and p.name != PROVENANCE)
    return {name: _digest(folder / name) for name in names}


def _digest(path: Path) -> str:
    try:
        if path.is_symlink() or not path.is_file():
            return ""
        with path.open("rb") as handle:
            return hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError:
        return ""


def is_run(folder: Path) -> bool:
    """Whether a folder holds the provenance of a run of this program."""
    return "biaxbayes" in _record(folder / PROVENANCE)


def _listed(path: Path) -> dict[str, str]:
    """Files that a provenance lists, by plain names only; empty where it cannot be read."""
    files = _record(path).get("files")
    if not isinstance(files, dict):
        return {}
    return {
        name: digest
        for name, digest in files.items()
        if digest and Path(name).name == name and not name.startswith(".")
    }


def _record(path: Path) -> dict[str, Any]:
    try:
        record = json.loads(read_bytes(path))
    except (BiaxbayesError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def _sync(path: Path) -> None:
    with path.open("rb") as handle:
        os.fsync(handle.fileno())
