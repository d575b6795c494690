"""What a verb said of a run, kept in its folder and said again as long as nothing has changed.

Nothing heavy is imported here: to say again what is known takes no NumPy.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from biaxbayes.errors import BiaxbayesError
from biaxbayes.text_files import atomic_write_text, read_bytes

__all__ = [
    "IDENTIFIED",
    "IDENTIFIED_FIGURE",
    "IDENTIFIED_TABLES",
    "STUDY_ROWS",
    "STUDY_ROWS_FROM",
    "keep_said",
    "said_before",
    "seal_said",
    "write_said",
]

IDENTIFIED = "identify.json"
"""What ``identify`` said of a run."""
IDENTIFIED_TABLES = ("identifiability.csv", "determined.csv", "same-curves.csv")
IDENTIFIED_FIGURE = "identifiability.pdf"

STUDY_ROWS = "study-rows.json"
"""What a study has in its tables of a run."""
STUDY_ROWS_FROM = ("summary.csv", "identifiability.csv")

READ = ("provenance.json", "specimen.csv", "posterior.nc", "law-fits.csv", "edges.csv")
"""What is read of a run to judge it."""


def said_before(folder: Path, name: str, made: Sequence[str]) -> dict[str, Any] | None:
    """What was said of a run; None where it, a file that was made of it or this code is another.

    Parameters
    ----------
    folder : Path
        Of the run.
    name : str
        The file that it is kept in.
    made : sequence of str
        Files of the folder that were made of the run.
    """
    path = folder / name
    try:
        if path.is_symlink() or not path.is_file():
            return None
        record = json.loads(read_bytes(path))
        kept, said = record["of"], record["said"]
        wanted = _digests(folder, made)
        same = all(kept[key] == digest for key, digest in wanted.items())
    except (BiaxbayesError, OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return said if same and isinstance(said, dict) else None


def keep_said(folder: Path, name: str, made: Sequence[str], said: dict[str, Any]) -> None:
    """Keep what was said of a run; arguments as in :func:`said_before`.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_said(folder, name, said)
    seal_said(folder, name, made)


def write_said(folder: Path, name: str, said: dict[str, Any]) -> None:
    """Write what is said of a run that is not finished yet; :func:`seal_said` makes it valid.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    _write(folder / name, {"of": {}, "said": said})


def seal_said(folder: Path, name: str, made: Sequence[str]) -> None:
    """Put down what it is that was said of; nothing where nothing was said.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    path = folder / name
    if path.is_file():
        _write(path, json.loads(read_bytes(path)) | {"of": _digests(folder, made)})


def _write(path: Path, record: dict[str, Any]) -> None:
    atomic_write_text(path, json.dumps(record, indent=2, ensure_ascii=False) + "\n")


def _digests(folder: Path, made: Sequence[str]) -> dict[str, str]:
    """SHA-256 of what was read, of what was made, and of this package."""
    return {name: _digest(folder / name) for name in (*READ, *made)} | {"biaxbayes": _code()}


@cache
def _code() -> str:
    """SHA-256 of this package, as it is when a process first asks."""
    package, code = Path(__file__).parent.parent, hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        code.update(source.read_bytes())
    return code.hexdigest()


def _digest(path: Path) -> str:
    """Empty where there is no such file."""
    if path.is_symlink() or not path.is_file():
        return ""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
