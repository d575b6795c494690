"""The record of a run folder, and its files, read as if a stranger had made them.

A run folder may come from a colleague or a download. Its provenance is data: types are checked,
nothing in it is executed, and no name in it leads outside the folder.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any

from biaxbayes.errors import BiaxbayesError, InputError, RunError
from biaxbayes.inference.settings import Settings
from biaxbayes.output.provenance import parse_options
from biaxbayes.output.staging import PROVENANCE
from biaxbayes.specimens.text_file import read_bytes

__all__ = ["STATES", "read_json", "read_record", "trusted_path"]

STATES = ("reliable", "tentative", "unusable")
MAX_BYTES = 50_000_000
NUMBER = (int, float)
NEEDED: dict[str, Any] = {
    "specimen": str,
    "unit": str,
    "notes": list,
    "settings": dict,
    "seed": int,
    "noise": {"beta": NUMBER, "readings": NUMBER, "effective_readings": (*NUMBER, type(None))},
    "sampler": {
        "message": str,
        "ensembles": int,
        "walkers": int,
        "steps": int,
        "acceptance": NUMBER,
    },
    "convergence": {
        "state": str,
        "reason": str,
        "worst_ess": (*NUMBER, type(None)),
        "worst_rhat": (*NUMBER, type(None)),
    },
}
"""What the readers of a run rely on; a run of this program holds more."""
ALLOWED = {"priors": dict, "versions": dict, "files": dict}
"""What may be missing, but not be of another type."""


def read_record(folder: Path) -> dict[str, Any]:
    """The provenance of a run folder, checked.

    Raises
    ------
    RunError
        If it is missing, damaged or not that of a run.
    """
    record = read_json(folder, PROVENANCE)
    missing = _misfit(record, NEEDED) or _misfit(record, ALLOWED, optional=True)
    if not missing and record["convergence"]["state"] not in STATES:
        missing = "convergence: state"
    if not missing and not 0.0 < record["noise"]["beta"] < math.inf:
        missing = "noise: beta"
    if not missing:
        # A reliable run states them, and whatever run does states both.
        stated = [record["convergence"][k] is not None for k in ("worst_ess", "worst_rhat")]
        if stated[0] != stated[1] or not (
            stated[0] or record["convergence"]["state"] != "reliable"
        ):
            missing = "convergence: worst_ess, worst_rhat"
    if missing:
        raise RunError(f"{folder / PROVENANCE}: is not that of a run (look at {missing!r})")
    try:
        Settings(**parse_options(record["settings"]))
    except (BiaxbayesError, TypeError) as error:
        raise RunError(f"{folder / PROVENANCE}: is not that of a run (settings: {error})") from None
    return record


def _misfit(record: object, needed: dict[str, Any], *, optional: bool = False) -> str:
    """The first entry that is missing or of another type; empty when there is none."""
    if not isinstance(record, dict):
        return "the whole"
    for key, kind in needed.items():
        if key not in record:
            if not optional:
                return key
        elif isinstance(kind, dict):
            inner = _misfit(record[key], kind, optional=optional)
            if inner:
                return f"{key}: {inner}"
        elif not isinstance(record[key], kind) or isinstance(record[key], bool):
            return key
    return ""


def read_json(folder: Path, name: str) -> Any:
    """A JSON file of a run folder.

    Raises
    ------
    RunError
        If it is missing, leads outside the folder, or is not JSON.
    """
    path = _inside(folder, name)
    if not path.exists():
        raise RunError(f"{path}: no such file; the run is not finished, continue it with --resume")
    try:
        return json.loads(_content(path), parse_int=_whole)
    except (ValueError, RecursionError):
        raise RunError(
            f"{path}: is damaged (not JSON); sample again, or continue with --resume"
        ) from None


def _whole(text: str) -> int:
    """An integer that fits into 64 bits: with more, not even its printing is safe."""
    value = int(text)
    if abs(value) >= 2**63:
        raise ValueError("too large")
    return value


def trusted_path(folder: Path, name: str, record: dict[str, Any]) -> Path:
    """Path of a file of a run, known to be the one that the run wrote.

    Raises
    ------
    RunError
        If it is missing, leads outside the folder, or was changed since.
    """
    path = _inside(folder, name)
    if not path.is_file():
        raise RunError(f"{path}: no such file; is the folder a run's, copied whole?")
    listed = record.get("files")
    wanted = listed.get(name) if isinstance(listed, dict) else None
    if wanted is None:
        return path
    try:
        with path.open("rb") as handle:
            found = hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError as error:
        raise RunError(f"{path}: cannot be read ({error.strerror})") from None
    if found != wanted:
        raise RunError(
            f"{path}: is not the file that the run wrote (damaged or changed); copy the folder "
            "again, or sample again"
        )
    return path


def _inside(folder: Path, name: str) -> Path:
    path = folder / name
    try:
        outside = path.is_symlink() and not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a loop of links
        outside = True
    if outside:
        raise RunError(f"{path}: is a link that leads outside the run folder; copy the file there")
    return path


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path, limit=MAX_BYTES)
    except InputError as error:
        raise RunError(f"{path}: {error.problem}") from None
