"""The files of a run folder: written together, recorded, and read as untrusted input.

Those of a population's folder are written in the same way.

Until the last file is written, what was in the folder before stays as it was. The folder with the
new files is then renamed to a fixed name; from there on they are the run, and the next process
finishes moving them if a crash got in between.

A run folder may come from a colleague or a download. Its provenance is data: types are checked,
nothing in it is executed, and no name in it leads outside the folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from biaxbayes.errors import BiaxbayesError, InputError, RunError
from biaxbayes.options import CARD_PROGRAMS, CARD_UNITS, Settings
from biaxbayes.runs.provenance import parse_options
from biaxbayes.text_files import atomic_write_text, read_bytes, sync_folder

# --- the files of a run: written to a staging folder, then moved into place together ------------


PROVENANCE = "provenance.json"
"""Moved last: with it the folder is a finished run."""
POPULATION = "population.json"
"""The same of a population."""
KINDS = {PROVENANCE: "run", POPULATION: "population"}
EVIDENCE = "evidence"
"""Sub-folder of a run: the tables that what is reported rests on."""
STUDY, RUNS = "study.json", "runs"
"""The record of a study's folder, and where its runs are."""
WRITING, READY = ".writing-", ".ready"
CARDS = "cards"
CARDS_FOLDER = re.compile(rf"{CARDS}-({'|'.join(CARD_PROGRAMS)})-({'|'.join(CARD_UNITS)})")
"""Folders of material cards in a run."""
PICTURE = r"\.(pdf|png|svg)"
DERIVED = re.compile(
    rf"(prediction|inflation|ledger|design|profile|grips)(\.csv|{PICTURE})|(profile-intervals\.csv|profile-provenance\.json)"
    rf"|(identifiability|determined|same-curves|law-fits|edges|misfit|report|report-stresses)\.csv"
    r"|report\.(html|md|tex)|explore\.html|results\.json|README\.txt"
    r"|(identify|study-rows|study-layers)\.json"
    rf"|(corner|stress-bands|identifiability|mounting|trace|profile)(-.+mm)?{PICTURE}"
    rf"|(population-forest|population-pairs|new-specimen-bands)(\.csv|{PICTURE})"
)
"""Files derived from the draws of their folder: stale once the draws change."""
PLAIN_NAME = re.compile(rf"({EVIDENCE}/)?[^./\\][^/\\]*")
TEMPORARY = re.compile(r"\..+\.\d+\.tmp")
"""Names of files half-written, as :func:`atomic_write_bytes` chooses them."""


@contextlib.contextmanager
def staged(
    folder: Path,
    on_removed: Callable[[list[str]], None] = lambda names: None,
    record: str = PROVENANCE,
) -> Iterator[Path]:
    """Yield a fresh folder for the files of a run, which then replace the old ones together.

    On failure the old files are untouched. `record` lists the others and is moved last;
    `on_removed` gets the names of removed files that were derived from the previous run.
    """
    remains = "what was there before is untouched, and `resume=True` continues"
    try:
        staging = Path(tempfile.mkdtemp(prefix=WRITING, dir=folder))
        try:
            yield staging
            for path in _files(staging):
                _sync(path)
            sync_folder(staging)
            staging.replace(folder / READY)
            sync_folder(folder)
        except BiaxbayesError as error:
            # The error names the final path, not the staging folder.
            problem = str(error).replace(f"{staging.name}{os.sep}", "")
            raise RunError(f"{problem}; {remains}") from None
        finally:
            shutil.rmtree(staging, ignore_errors=True)
        on_removed(finish_moving(folder, record))
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be written ({error.strerror or error}); check space and "
            f"permissions; {remains}"
        ) from None


def finish_moving(folder: Path, record: str = PROVENANCE) -> list[str]:
    """Move staged files into place, also after a crash; return the derived files removed."""
    ready = folder / READY
    if ready.is_symlink() or not ready.is_dir():
        return []
    listed, before = _listed(ready / record), _listed(folder / record)
    for name, digest in before.items():
        # A file of the run before that this one does not have; never one of the user's.
        if listed and name not in listed and _digest(folder / name) == digest:
            (folder / name).unlink(missing_ok=True)
    other = is_finished(folder, record) and _posterior(folder / record) != _posterior(
        ready / record
    )
    waiting = _files(ready)
    new = {_name(p, ready) for p in waiting}
    removed = _remove_derived(folder, {*listed, *new, *before}) if listed and other else []
    if any(p.parent != ready for p in waiting):
        if (folder / EVIDENCE).is_symlink():
            (folder / EVIDENCE).unlink()
        (folder / EVIDENCE).mkdir(exist_ok=True)
    for path in sorted(waiting, key=lambda p: p.name == record):
        path.replace(folder / _name(path, ready))
    sync_folder(folder)
    shutil.rmtree(ready, ignore_errors=True)
    return removed


def _files(folder: Path) -> list[Path]:
    """Files of a run folder and of its evidence; no links."""
    evidence = folder / EVIDENCE
    inner = evidence.iterdir() if evidence.is_dir() and not evidence.is_symlink() else ()
    paths = (*folder.iterdir(), *inner)
    return sorted(p for p in paths if p.is_file() and not p.is_symlink())


def _name(path: Path, folder: Path) -> str:
    """Name of a file in a manifest, as ``evidence/law-fits.csv``."""
    return path.relative_to(folder).as_posix()


def _posterior(path: Path) -> tuple[Any, ...]:
    """What tells the draws of two records apart; a run that was continued is the same."""
    record = _record(path)
    return tuple(record.get(key) for key in ("specimen_sha256", "settings", "seed", "identity"))


def _remove_derived(folder: Path, current: set[str]) -> list[str]:
    """Remove what was derived from the draws before; what the user changed or added stays."""
    removed = []
    cards = [p for p in folder.iterdir() if p.is_dir()]
    for path in sorted([*_files(folder), *cards]):
        if path.is_symlink() or _name(path, folder) in current:
            continue
        if path.is_file() and DERIVED.fullmatch(path.name):
            path.unlink()
        elif path.is_dir() and CARDS_FOLDER.fullmatch(path.name):
            shutil.rmtree(path)
        else:
            continue
        removed.append(_name(path, folder))
    return removed


def clear_leftovers(folder: Path) -> None:
    """Remove what a killed process left half-written; the caller has locked the folder."""
    for path in folder.glob(f"{WRITING}*"):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
    for path in folder.iterdir():
        if TEMPORARY.fullmatch(path.name):
            with contextlib.suppress(OSError):
                path.unlink()


def manifest(folder: Path, *, without: Sequence[str] = ()) -> dict[str, str]:
    """SHA-256 of every file in a folder, but for the provenance that is to hold them."""
    left = (PROVENANCE, *without)
    names = [_name(p, folder) for p in _files(folder)]
    return {name: _digest(folder / name) for name in names if name not in left}


def refresh_manifest(folder: Path, record: dict[str, Any], names: Sequence[str]) -> None:
    """Write the provenance of a run again, with the digests of files that were written anew."""
    files = record.get("files")
    if isinstance(files, dict):
        digests = {name: _digest(folder / name) for name in names if (folder / name).exists()}
        new = record | {"files": dict(sorted((files | digests).items()))}
        atomic_write_text(folder / PROVENANCE, record_text(new))


def record_text(record: Any) -> str:
    """A record as JSON text."""
    return json.dumps(record, indent=2, ensure_ascii=False, allow_nan=True, default=str) + "\n"


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
    return is_finished(folder, PROVENANCE)


def is_finished(folder: Path, record: str) -> bool:
    """Whether a folder holds what this program writes last of a run, or of a population."""
    return "biaxbayes" in _record(folder / record)


def _listed(path: Path) -> dict[str, str]:
    """Files that a provenance lists, of the folder and its evidence; empty if unreadable."""
    files = _record(path).get("files")
    if not isinstance(files, dict):
        return {}
    return {name: digest for name, digest in files.items() if digest and PLAIN_NAME.fullmatch(name)}


def _record(path: Path) -> dict[str, Any]:
    try:
        record = json.loads(read_bytes(path))
    except (BiaxbayesError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def _sync(path: Path) -> None:
    with path.open("rb") as handle:
        os.fsync(handle.fileno())


# --- the record of a run folder and its files, read as untrusted input ---------------------------


STATES = ("converged", "tentative", "unusable")
EARLIER = {"reliable": "converged"}
"""What earlier versions called a state."""
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
    """Read and check the provenance of a run folder."""
    record = read_json(folder, PROVENANCE)
    missing = _schema_error(record, NEEDED) or _schema_error(record, ALLOWED, optional=True)
    if not missing:
        state = record["convergence"]["state"]
        record["convergence"]["state"] = EARLIER.get(state, state)
    if not missing and record["convergence"]["state"] not in STATES:
        missing = "convergence: state"
    if not missing and not 0.0 < record["noise"]["beta"] < math.inf:
        missing = "noise: beta"
    if not missing:
        # A converged run has both, any other run both or neither.
        stated = [record["convergence"][k] is not None for k in ("worst_ess", "worst_rhat")]
        if stated[0] != stated[1] or not (
            stated[0] or record["convergence"]["state"] != "converged"
        ):
            missing = "convergence: worst_ess, worst_rhat"
    if missing:
        raise RunError(f"{folder / PROVENANCE}: is not that of a run (entry {missing!r})")
    try:
        Settings(**parse_options(record["settings"]))
    except (BiaxbayesError, TypeError) as error:
        raise RunError(f"{folder / PROVENANCE}: is not that of a run (settings: {error})") from None
    return record


def _schema_error(record: object, needed: dict[str, Any], *, optional: bool = False) -> str:
    """The first entry that is missing or of another type; empty when there is none."""
    if not isinstance(record, dict):
        return "the whole"
    for key, kind in needed.items():
        if key not in record:
            if not optional:
                return key
        elif isinstance(kind, dict):
            inner = _schema_error(record[key], kind, optional=optional)
            if inner:
                return f"{key}: {inner}"
        elif not isinstance(record[key], kind) or isinstance(record[key], bool):
            return key
    return ""


def read_json(folder: Path, name: str) -> Any:
    """Read a JSON file of a run folder; RunError if it is missing, leads outside or is not JSON."""
    path = _inside(folder, name)
    if not path.exists():
        raise RunError(
            f"{path}: no such file; the run is not finished, continue it with `resume=True`"
        )
    try:
        return json.loads(_content(path), parse_int=_whole)
    except (ValueError, RecursionError):
        raise RunError(
            f"{path}: is damaged (not JSON); sample again, or continue with `resume=True`"
        ) from None


def _whole(text: str) -> int:
    """An integer that fits into 64 bits: with more, not even its printing is safe."""
    value = int(text)
    if abs(value) >= 2**63:
        raise ValueError("too large")
    return value


def trusted_path(folder: Path, name: str, record: dict[str, Any]) -> Path:
    """Path of a file of a run; RunError if it is missing, leads outside or was changed."""
    path = _inside(folder, name)
    if not path.is_file():
        raise RunError(f"{path}: no such file; was the run folder copied completely?")
    listed = record.get("files")
    wanted = listed.get(name) if isinstance(listed, dict) else None
    if wanted is None:
        return path
    try:
        with path.open("rb") as handle:
            digest = hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError as error:
        raise RunError(f"{path}: cannot be read ({error.strerror})") from None
    if digest != wanted:
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


def other_kind(folder: Path) -> str:
    """What a folder is that is no run's, and what to give instead; empty where it is unknown."""
    if (folder / PROVENANCE).exists():
        return ""
    if (folder / POPULATION).is_file():
        return (
            "is a population's folder, not a run's; give one of the runs of its study, or export "
            "its cards with `population`, a group of it"
        )
    if (folder / STUDY).is_file() and (folder / RUNS).is_dir():
        return f"is a study's folder, not a run's; give one of the runs in {folder / RUNS}"
    return ""


def names_in(folder: Path) -> set[str]:
    """Make a folder if it is new, and return the names in it without hidden files."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return {p.name for p in folder.iterdir() if not p.name.startswith(".")}
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be used ({error.strerror}); choose another `out`"
        ) from None
