"""The files of a run or population: written aside, moved in together, read as untrusted input.

They are written into a hidden folder in it. Renaming that folder to ``.ready`` makes them the run:
they are then moved into place, by the next process if a crash got in between. The run folder itself
is never exchanged: it may be a mount or a link, and lock and checkpoints are in it. A file that the
record or the list ``.written`` names, and that is still as it was written, goes with the draws;
every other is the user's and stays.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from biaxbayes.errors import BiaxbayesError, InputError, RunError
from biaxbayes.file_lock import folder_lock
from biaxbayes.progress_bar import OnProgress, Progress, no_progress
from biaxbayes.runs.checkpoint import NAMES as CHECKPOINTS
from biaxbayes.stored_data import json_text, read_json, read_object
from biaxbayes.text_files import WRITTEN, atomic_write_text, sync_folder

PROVENANCE, POPULATION, STUDY = "provenance.json", "population.json", "study.json"
KINDS = {
    PROVENANCE: "run",
    POPULATION: "population",
    STUDY: "study",
    "calibration.json": "calibration",
    "laws.json": "comparison of laws",
}
"""Kinds of work by the record of its folder; that of a run or population is moved last."""
RUNS = "runs"
"""Where the runs of a study are in its folder."""
WRITING, READY = ".writing-", ".ready"
COPY_AGAIN = "copy the folder again, or sample again"


# --- who writes into a folder ---------------------------------------------------------------------


@contextlib.contextmanager
def claim_folder(folder: Path, record: str, own: Collection[str] = ()) -> Iterator[None]:
    """Make and lock a folder that is new, holds work of its kind, or nothing but `own` names."""
    records = {record, *(CHECKPOINTS if record in (PROVENANCE, POPULATION) else ())}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = {p.name for p in folder.iterdir() if not p.name.startswith(".")}
    except OSError as error:
        problem = f"cannot be used ({error.strerror})"
        raise RunError(f"{folder}: {problem}; choose another `out`") from None
    if names.difference(own) and not names.intersection(records):
        raise RunError(f"{folder}: is not a {KINDS[record]} folder; choose another `out`")
    with folder_lock(folder):
        for path in folder.glob(f"{WRITING}*"):  # of a killed process
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
        for path in folder.glob(".*.tmp"):
            with contextlib.suppress(OSError):
                path.unlink()
        yield


@contextlib.contextmanager
def lock_folder(folder: Path, record: str, *, resume: bool, overwrite: bool) -> Iterator[None]:
    """Claim the folder of a run or population, and finish what a crash interrupted."""
    with claim_folder(folder, record):
        finish_moving(folder, record)
        refuse_finished(folder, record, resume=resume, overwrite=overwrite)
        yield


def refuse_finished(folder: Path, record: str, *, resume: bool, overwrite: bool) -> None:
    """Refuse to overwrite a finished run without `overwrite`, or a checkpoint and `resume`."""
    continued = resume and any((folder / name).exists() for name in CHECKPOINTS)
    if (folder / record).exists() and not (continued or overwrite):
        remedy = "choose another `out`, or replace it with `overwrite=True`"
        raise RunError(f"{folder}: holds a finished {KINDS[record]}; {remedy}")


def refuse_other_work(folder: Path, record: str, identity: Any, *, resume: bool) -> None:
    """Refuse a folder that holds a calibration, say, without `resume`, or another one with it."""
    if not (folder / record).exists():
        return
    if not resume:
        remedy = "choose another `out`, or continue it with `resume=True`"
        raise RunError(f"{folder}: already holds a {KINDS[record]}; {remedy}")
    if read_object(folder / record).get("identity") != identity:
        problem = f"holds another {KINDS[record]} (specimen, options, seed or version differ)"
        raise RunError(f"{folder}: {problem}; choose another `out`")


# --- files written aside, then moved into place together -----------------------------------------


@contextlib.contextmanager
def staged(
    folder: Path,
    record: str = PROVENANCE,
    progress: OnProgress = no_progress,
    *,
    resumable: bool = True,
) -> Iterator[Path]:
    """Yield a fresh folder for the files of a run, which then replace the old ones together.

    The caller has locked `folder`. On failure the old files are untouched. `record` lists the
    others and is moved last. What went with the draws of the previous run is named to `progress`.
    """
    continues = ", and `resume=True` continues" if resumable else ""
    remains = f"what was there before is untouched{continues}"
    try:
        staging = Path(tempfile.mkdtemp(prefix=WRITING, dir=folder))
        try:
            yield staging
            for path in _files(staging).values():
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
            f"permissions, and close programs that show its files; {remains}"
        ) from None


@contextlib.contextmanager
def updated(folder: Path, record: dict[str, Any]) -> Iterator[Path]:
    """Yield a fresh folder for some files of a finished run, which replace theirs together."""
    with folder_lock(folder), staged(folder, resumable=False) as staging:
        yield staging
        record = record | {"files": _listed(record) | manifest(staging)}
        atomic_write_text(staging / PROVENANCE, json_text(record))


SAME_DRAWS = ("specimen_sha256", "settings", "seed", "identity")
"""Entries of a record that say which draws it is of; a continued run has the same."""


def finish_moving(folder: Path, record: str = PROVENANCE) -> list[str]:
    """Move staged files into place, also after a crash; return what went with the old draws."""
    ready = folder / READY
    if ready.is_symlink() or not ready.is_dir():
        return []
    old, new = read_object(folder / record), read_object(ready / record)
    waiting, kept = _files(ready), _listed(new)
    removed: list[str] = []
    if kept:
        for name, digest in _listed(old).items():
            if name not in kept:
                _remove(folder, name, digest)
        if old and any(old.get(key) != new.get(key) for key in SAME_DRAWS):
            written = {k: v for k, v in _written(folder).items() if k not in (*kept, *_listed(old))}
            gone = [name for name, digest in written.items() if _remove(folder, name, digest)]
            removed = list(dict.fromkeys(name.partition("/")[0] for name in gone))
            (folder / WRITTEN).unlink(missing_ok=True)
    for name in sorted(waiting, key=lambda name: name == record):
        parent = (folder / name).parent
        if parent != folder and parent.is_symlink():
            parent.unlink()
        parent.mkdir(parents=True, exist_ok=True)
        waiting[name].replace(folder / name)
    if not (folder / WRITTEN).is_symlink():
        (folder / WRITTEN).touch()
    sync_folder(folder)
    shutil.rmtree(ready, ignore_errors=True)
    return removed


def manifest(folder: Path) -> dict[str, str]:
    """SHA-256 of every file in a folder except the provenance and hidden ones."""
    return {name: _digest(path) for name, path in _files(folder).items() if name != PROVENANCE}


def _files(folder: Path) -> dict[str, Path]:
    """Files of a folder and its sub-folders by name, as ``evidence/law-fits.csv``; no links."""
    paths = {p.relative_to(folder).as_posix(): p for p in sorted(folder.rglob("[!.]*"))}
    return {name: p for name, p in paths.items() if p.is_file() and not p.is_symlink()}


def _digest(path: Path) -> str:
    try:
        if path.is_symlink() or not path.is_file():
            return ""
        with path.open("rb") as handle:
            return hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError:
        return ""


def _listed(record: dict[str, Any]) -> dict[str, str]:
    """Files that a record lists, with their digests."""
    files = record.get("files")
    return files if isinstance(files, dict) else {}


def _written(folder: Path) -> dict[str, str]:
    """Files that verbs wrote into a run folder, with their digests."""
    path = folder / WRITTEN
    if path.is_symlink() or not path.is_file():
        return {}
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def _remove(folder: Path, name: str, digest: object) -> bool:
    """Remove a file that is still as this program wrote it; no name leads outside the folder."""
    parts = name.split("/")
    hidden = any(not part.strip(". ") or part.startswith(".") for part in parts)
    parents = [folder.joinpath(*parts[:k]) for k in range(len(parts) - 1, 0, -1)]
    if hidden or any(ch in name for ch in "\\:\0") or any(p.is_symlink() for p in parents):
        return False
    if not digest or _digest(folder / name) != digest:
        return False
    (folder / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # a folder that is not empty
        for parent in parents:
            parent.rmdir()
    return True


# --- files of a run folder, read as untrusted input -----------------------------------------------


def open_folder(folder: Path, record: str) -> None:
    """Finish what a crash interrupted; RunError if it is no such folder."""
    kind = KINDS[record]
    verb = f"'biaxbayes {'sample' if record == PROVENANCE else kind}'"
    try:
        if not os.path.lexists(folder):
            raise RunError(f"{folder}: does not exist; make a {kind} folder with {verb}")
        found = [name for name in KINDS if (folder / name).is_file()] if folder.is_dir() else []
        if found and record not in found:
            remedy = f"make one with {verb}"
            if record == PROVENANCE and found[0] == STUDY:
                remedy = f"give one of the runs in {folder / RUNS}"
            elif record == PROVENANCE and found[0] == POPULATION:
                remedy = "give a run of its study, or export cards of a group with `population`"
            raise RunError(f"{folder}: is a {KINDS[found[0]]}'s folder, not a {kind}'s; {remedy}")
        if not any((folder / name).exists() for name in (record, READY, *CHECKPOINTS)):
            problem = f"is not a {kind} folder (it has no {record})"
            raise RunError(f"{folder}: {problem}; make one with {verb}")
        if (folder / READY).is_dir():
            # A crash came between two renames of finished files: nothing is missing.
            with folder_lock(folder):
                finish_moving(folder, record)
        if not inside(folder, record).exists():
            problem = f"no such file; the {kind} is not finished, continue it with `resume=True`"
            raise RunError(f"{folder / record}: {problem}")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise RunError(f"{folder}: cannot be opened ({reason})") from None


def read_run_json(path: Path) -> Any:
    """Values of a JSON file of a run; RunError if it is not JSON."""
    try:
        return read_json(path)
    except InputError as error:
        raise RunError(f"{path}: {error.problem}; {COPY_AGAIN}") from None


def trusted_path(folder: Path, name: str, record: dict[str, Any]) -> Path:
    """Path of a file of a run; RunError if it is missing, leads outside or was changed."""
    path = inside(folder, name)
    if not path.is_file():
        raise RunError(f"{path}: no such file; was the run folder copied completely?")
    if not isinstance(record.get("files"), dict):
        return path  # of a run that is being written
    digest = _digest(path.resolve())
    if not digest:
        raise RunError(f"{path}: cannot be read; check its permissions")
    if digest != record["files"].get(name):
        problem = "is not the file that the run wrote (damaged or changed)"
        raise RunError(f"{path}: {problem}; {COPY_AGAIN}")
    return path


def inside(folder: Path, name: str) -> Path:
    """Path of a name in a folder; RunError if it is a link that leads outside."""
    path = folder / name
    try:
        outside = path.is_symlink() and not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a loop of links
        outside = True
    if outside:
        raise RunError(f"{path}: is a link that leads outside the run folder; remove it")
    return path


def piece_files(count: int) -> list[str]:
    """Files of the pieces of a tissue in a run folder."""
    return ["specimen.csv", *(f"piece-{i}.csv" for i in range(2, count + 1))]
