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
import os
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from biaxbayes.errors import BiaxbayesError, InputError, RunError
from biaxbayes.file_lock import folder_lock
from biaxbayes.options import CARD_PROGRAMS, CARD_UNITS, FIGURE_FORMATS, PLOTS, REPORTS
from biaxbayes.progress_bar import OnProgress, Progress, no_progress
from biaxbayes.runs.checkpoint import NAMES as CHECKPOINTS
from biaxbayes.text_files import atomic_write_text, read_bytes, sync_folder

PROVENANCE = "provenance.json"
"""Moved last: with it the folder is a finished run."""
POPULATION = "population.json"
"""The same of a population."""
KINDS = {PROVENANCE: "run", POPULATION: "population"}
EVIDENCE = "evidence"
"""Sub-folder of a run: the tables behind the reported result."""
STUDY, RUNS = "study.json", "runs"
"""The record of a study's folder, and where its runs are."""
WRITING, READY = ".writing-", ".ready"
CARDS = "cards"
CARDS_FOLDER = re.compile(rf"{CARDS}-({'|'.join(CARD_PROGRAMS)})-({'|'.join(CARD_UNITS)})")
"""Folders of material cards in a run."""
OUTPUTS = (
    *("prediction", "inflation", "ledger", "design", "profile", "grips"),
    *("population-forest", "population-pairs", "new-specimen-bands"),
)
"""Stems of tables with a figure."""
EXPORTS = (
    *("profile-intervals", "report", "report-stresses", "identifiability", "law-fits"),
    *("determined", "same-curves", "misfit"),
)
RECORDS = ("results", "profile-provenance")
DERIVED = re.compile(
    rf"({'|'.join((*OUTPUTS, *EXPORTS))})\.csv|({'|'.join(RECORDS)})\.json|README\.txt"
    rf"|({'|'.join((*OUTPUTS, *PLOTS.values()))})(-.+mm)?\.({'|'.join(FIGURE_FORMATS)})"
    rf"|{'|'.join(map(re.escape, REPORTS.values()))}"
)
"""Files derived from the draws of their folder, stale once the draws change."""
PLAIN_NAME = re.compile(rf"({EVIDENCE}/)?[^./\\][^/\\]*")
TEMPORARY = re.compile(r"\..+\.\d+\.tmp")
"""Names of files half-written, as :func:`atomic_write_bytes` chooses them."""


# --- who writes into a folder ---------------------------------------------------------------------


@contextlib.contextmanager
def claim_folder(
    folder: Path, records: Collection[str], kind: str, own: Collection[str] = ()
) -> Iterator[None]:
    """Make and lock a folder that is new, or holds one of `records` or nothing but `own` names."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = {p.name for p in folder.iterdir() if not p.name.startswith(".")}
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be used ({error.strerror}); choose another `out`"
        ) from None
    if names.difference(own) and not names.intersection(records):
        raise RunError(f"{folder}: is a folder that is not {kind}; choose another `out`")
    with folder_lock(folder):
        clear_leftovers(folder)
        yield


@contextlib.contextmanager
def lock_folder(folder: Path, record: str, *, resume: bool, overwrite: bool) -> Iterator[None]:
    """Claim and lock the folder of a run or population, and finish what a crash interrupted."""
    records = [*CHECKPOINTS, *([record] if is_finished(folder, record) else [])]
    with claim_folder(folder, records, f"a {KINDS[record]}'s"):
        finish_moving(folder, record)
        refuse_finished(folder, record, resume=resume, overwrite=overwrite)
        yield


def refuse_finished(folder: Path, record: str, *, resume: bool, overwrite: bool) -> None:
    """Refuse to overwrite a finished run without `overwrite`, or a checkpoint and `resume`."""
    continued = resume and any((folder / name).exists() for name in CHECKPOINTS)
    if is_finished(folder, record) and not (continued or overwrite):
        raise RunError(
            f"{folder}: holds a finished {KINDS[record]}; choose another `out`, or replace it with "
            "`overwrite=True`"
        )


# --- files written to a staging folder, then moved into place together --------------------------


@contextlib.contextmanager
def staged(
    folder: Path, record: str = PROVENANCE, progress: OnProgress = no_progress
) -> Iterator[Path]:
    """Yield a fresh folder for the files of a run, which then replace the old ones together.

    On failure the old files are untouched. `record` lists the others and is moved last. Files that
    were derived from the previous run are removed, and named to `progress`.
    """
    remains = "what was there before is untouched, and `resume=True` continues"
    try:
        staging = Path(tempfile.mkdtemp(prefix=WRITING, dir=folder))
        try:
            yield staging
            for path in _files(staging):
                with path.open("r+b") as handle:  # Windows syncs only what can be written
                    os.fsync(handle.fileno())
            sync_folder(staging)
            staging.replace(folder / READY)
            sync_folder(folder)
        except BiaxbayesError as error:
            # The error names the final path, not the staging folder.
            problem = str(error).replace(f"{staging.name}{os.sep}", "")
            raise RunError(f"{problem}; {remains}") from None
        finally:
            shutil.rmtree(staging, ignore_errors=True)
        if removed := finish_moving(folder, record):
            note = f"removed with the previous {KINDS[record]}: {', '.join(removed)}"
            progress(Progress("writing", note=note))
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
    listed, before = _read_manifest(ready / record), _read_manifest(folder / record)
    for name, digest in before.items():
        # A file of the previous run that this one does not have; files of the user stay.
        if listed and name not in listed and _digest(folder / name) == digest:
            (folder / name).unlink(missing_ok=True)
    # values that distinguish the draws of two records; a continued run has the same
    old, new = (_record(path / record) for path in (folder, ready))
    keys = ("specimen_sha256", "settings", "seed", "identity")
    others_draws = "biaxbayes" in old and any(old.get(k) != new.get(k) for k in keys)
    waiting = _files(ready)
    removed = []
    if listed and others_draws:
        current = {*listed, *before, *(_name(p, ready) for p in waiting)}
        removed = _remove_derived(folder, current)
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
    """Files of a run folder and its sub-folder evidence; no links."""
    evidence = folder / EVIDENCE
    inner = evidence.iterdir() if evidence.is_dir() and not evidence.is_symlink() else ()
    paths = (*folder.iterdir(), *inner)
    return sorted(p for p in paths if p.is_file() and not p.is_symlink())


def _name(path: Path, folder: Path) -> str:
    """Name of a file in a manifest, as ``evidence/law-fits.csv``."""
    return path.relative_to(folder).as_posix()


def _remove_derived(folder: Path, current: set[str]) -> list[str]:
    """Remove files derived from the previous draws; files that the user added stay."""
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
    """Remove half-written files of a killed process; the caller has locked the folder."""
    for path in folder.glob(f"{WRITING}*"):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
    for path in folder.iterdir():
        if TEMPORARY.fullmatch(path.name):
            with contextlib.suppress(OSError):
                path.unlink()


def manifest(folder: Path, *, without: Sequence[str] = ()) -> dict[str, str]:
    """SHA-256 of every file in a folder except the provenance."""
    left = (PROVENANCE, *without)
    names = [_name(p, folder) for p in _files(folder)]
    return {name: _digest(folder / name) for name in names if name not in left}


def refresh_manifest(folder: Path, record: dict[str, Any], names: Sequence[str]) -> None:
    """Write the provenance of a run again, with new digests of some files."""
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


def is_finished(folder: Path, record: str) -> bool:
    """True if a folder holds the file that is written last: of a run, or of a population."""
    return "biaxbayes" in _record(folder / record)


def stored_identity(path: Path) -> Any:
    """Entry ``identity`` of a record: what its folder holds results of; None if unreadable."""
    return _record(path).get("identity")


def _read_manifest(path: Path) -> dict[str, str]:
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


# --- files of a run folder, read as untrusted input -----------------------------------------------


MAX_RECORD_BYTES = 50_000_000


def read_json(folder: Path, name: str) -> Any:
    """Read a JSON file of a run folder; RunError if it is missing, leads outside or is not JSON."""
    path = _inside(folder, name)
    if not path.exists():
        raise RunError(
            f"{path}: no such file; the run is not finished, continue it with `resume=True`"
        )
    try:
        return json.loads(read_bytes(path, limit=MAX_RECORD_BYTES), parse_int=_whole)
    except InputError as error:
        raise RunError(f"{path}: {error.problem}") from None
    except (ValueError, RecursionError):
        raise RunError(
            f"{path}: is damaged (not JSON); sample again, or continue with `resume=True`"
        ) from None


def _whole(text: str) -> int:
    """An integer of 64 bits; printing a longer one can fail."""
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
    if not isinstance(listed, dict):
        return path  # of a run that is being written
    wanted = listed.get(name)
    digest = _digest(path.resolve())
    if not digest:
        raise RunError(f"{path}: cannot be read; check its permissions")
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


def piece_files(count: int) -> list[str]:
    """Files of the pieces of a tissue in a run folder."""
    return ["specimen.csv", *(f"piece-{i}.csv" for i in range(2, count + 1))]


def other_kind(folder: Path) -> str:
    """Message for the folder of a population or study given as a run; empty for others."""
    if (folder / PROVENANCE).exists():
        return ""
    if (folder / POPULATION).is_file():
        return (
            "is a population's folder, not a run's; give one of the runs of its study, or export "
            "cards of a group with `population`"
        )
    if (folder / STUDY).is_file() and (folder / RUNS).is_dir():
        return f"is a study's folder, not a run's; give one of the runs in {folder / RUNS}"
    return ""
