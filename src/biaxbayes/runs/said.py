"""What a verb said of runs, kept in a folder of theirs and said again while nothing has changed.

Nothing heavy is imported here: to say again what is known takes no NumPy.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from biaxbayes.errors import BiaxbayesError
from biaxbayes.text_files import atomic_write_text, read_bytes

__all__ = [
    "IDENTIFIED",
    "IDENTIFIED_FIGURE",
    "IDENTIFIED_TABLES",
    "STUDY_FROM",
    "STUDY_LAYERS",
    "STUDY_ROWS",
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
STUDY_LAYERS = "study-layers.json"
"""How far a run is from those of the other layers of its donor."""
STUDY_FROM = ("summary.csv", "identifiability.csv")

READ = ("provenance.json", "specimen.csv", "posterior.nc", "law-fits.csv", "edges.csv")
"""What is read of a run to judge it."""


def said_before(
    folder: Path, name: str, made: Sequence[str], others: Sequence[Path] = ()
) -> dict[str, Any] | None:
    """What was said of runs; None where one, a file that was made of it or this code is another.

    Parameters
    ----------
    folder : Path
        Of the run.
    name : str
        The file that it is kept in.
    made : sequence of str
        Files of the folder that were made of the run.
    others : sequence of Path
        Folders of further runs that it was said of.
    """
    path = folder / name
    try:
        if path.is_symlink() or not path.is_file():
            return None
        record = json.loads(read_bytes(path))
        kept, said = record["of"], record["said"]
        wanted = _digests(folder, made, others)
        same = all(kept[key] == digest for key, digest in wanted.items())
    except (BiaxbayesError, OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return said if same and isinstance(said, dict) else None


def keep_said(
    folder: Path,
    name: str,
    made: Sequence[str],
    said: dict[str, Any],
    others: Sequence[Path] = (),
) -> None:
    """Keep what was said of runs; arguments as in :func:`said_before`.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    _write(folder / name, {"of": _digests(folder, made, others), "said": said})


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


def _digests(folder: Path, made: Sequence[str], others: Sequence[Path] = ()) -> dict[str, str]:
    """SHA-256 of what was read, of what was made, and of this package."""
    files = (*READ, *made)
    found = {name: _digest(folder / name) for name in files}
    for number, other in enumerate(others, start=2):
        found |= {f"{name} of run {number}": _digest(other / name) for name in files}
    return {**found, "biaxbayes": _digest_of_code()}


@cache
def _digest_of_code() -> str:
    """That of every module of the package."""
    package, code = Path(__file__).parent.parent, hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        code.update(source.read_bytes())
    return code.hexdigest()


OLD_NS = 1_000_000_000
"""Age from which a file that is written again has another time: clocks of files tick slowly."""


def _digest(path: Path) -> str:
    """Empty where there is no such file."""
    if path.is_symlink() or not path.is_file():
        return ""
    now, found = time.time_ns(), path.stat()
    state = (found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)
    old = all(now - moment > OLD_NS for moment in state[2:])
    return _digest_as_it_is(path, state) if old else _digest_of(path)


@lru_cache(4096)
def _digest_as_it_is(path: Path, state: tuple[int, ...]) -> str:
    """That of a file in a state which it cannot have again with other content."""
    return _digest_of(path)


def _digest_of(path: Path) -> str:
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
