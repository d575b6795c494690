"""A study in a folder: every specimen sampled once, whatever comes between.

Everything that the task of a worker needs is in it, and everything it finds goes back; the run
folders lie in the study's, which every worker must see.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import socket
import time
import traceback
import uuid
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

import biaxbayes
from biaxbayes.errors import BiaxbayesError, CannotResume, InputError, Interrupted, RunError
from biaxbayes.executors.executor import Executor, InThisProcess, Outcome
from biaxbayes.figures.run import DRAWING_MODULES
from biaxbayes.jobs.sample import Sampling
from biaxbayes.laws import DEFAULT_LAW
from biaxbayes.reports.study_page import write_study
from biaxbayes.runs.folder import STATES, is_run, manifest
from biaxbayes.runs.lock import folder_lock
from biaxbayes.runs.run import Run, open_run
from biaxbayes.runs.said import STUDY_ROWS, STUDY_ROWS_FROM, keep_said, said_before
from biaxbayes.sampling.sampler import Progress
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.studies.result import (
    FAILED,
    INTERRUPTED,
    RUNS,
    Entry,
    LayersFound,
    StudyResult,
    Tried,
    are_rows,
    donor_groups,
    read_entries,
    result_of,
    rows_of_run,
    rows_without_run,
    study_table,
)
from biaxbayes.studies.study_file import Study
from biaxbayes.text_files import atomic_write_text, csv_text

__all__ = ["WORKER_MODULES", "Batch", "LayerTask", "SpecimenTask", "compare_layers", "try_specimen"]

WORKER_MODULES = (
    "biaxbayes.sampling.ensembles",
    "biaxbayes.jobs.identified",
    "biaxbayes.jobs.products",
    "biaxbayes.reports.page",
    "scipy.signal",
    "jinja2",
    *DRAWING_MODULES,
)
"""What a worker imports in the end, wherever that is put off until it is needed."""


# --- what a worker does: sample one specimen, or compare the layers of one donor -----------------


@dataclass(frozen=True)
class SpecimenTask:
    """A specimen to sample.

    Attributes
    ----------
    specimen : Specimen
    source : str
        Name of its file.
    folder : Path
        Of the run, absolute.
    options : dict
    seed : int
    ess : float
    max_steps : int
    anyway : bool
        Also what cannot be a loading curve.
    finished : bool
        The folder holds the finished run of this very task.
    going : Path
        A file that is there as long as the study goes on.
    """

    specimen: Specimen
    source: str
    folder: Path
    options: dict[str, Any]
    seed: int
    ess: float
    max_steps: int
    anyway: bool
    finished: bool
    going: Path


def failed(reason: str, notes: list[str] | None = None, law: str = DEFAULT_LAW) -> Tried:
    """A specimen without a run."""
    return Tried(FAILED, reason, rows_without_run(FAILED, reason, law), notes or [])


def try_specimen(task: SpecimenTask) -> Tried:
    """Sample a specimen into its run folder, or read the run that is there.

    Nothing is raised: one specimen does not stop the others.
    """
    notes: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if not task.going.exists():
                return Tried(INTERRUPTED, f"{socket.gethostname()} does not see the study folder")
            run = _run(task, notes)
            return Tried(run.state, _reason(run), _rows(run), notes)
        except Interrupted as error:
            return Tried(INTERRUPTED, str(error))
        except BiaxbayesError as error:
            return failed(str(error), notes, task.options["law"])
        except OSError as error:
            where = f"{error.filename}: " if error.filename else ""
            return failed(f"{where}{error.strerror or error}", notes, task.options["law"])
        except Exception as error:
            if os.environ.get("BIAXBAYES_DEBUG"):
                traceback.print_exc()
            return failed(
                f"internal error: {type(error).__name__}: {error}", notes, task.options["law"]
            )


def _run(task: SpecimenTask, notes: list[str]) -> Run:
    from biaxbayes.compilation import first_alone

    if task.finished:
        return open_run(task.folder)

    def note(progress: Any) -> None:
        if progress.note:
            notes.append(str(progress.note))

    def stop() -> bool:
        return not task.going.exists()

    sampling = Sampling.prepare(
        task.specimen,
        out=task.folder,
        options=task.options,
        seed=task.seed,
        ess=task.ess,
        max_steps=task.max_steps,
        workers=1,
        anyway=task.anyway,
    )
    sampling.source = task.source
    with first_alone():
        if stop():  # while another process was compiling
            raise Interrupted("stopped before it began")
        try:
            folder = sampling.execute(resume=True, overwrite=True, progress=note, stop=stop)
        except CannotResume as error:
            notes.append(f"sampled anew: {error}")
            folder = sampling.execute(resume=False, overwrite=True, progress=note, stop=stop)
    return open_run(folder)


def _rows(run: Run) -> list[dict[str, Any]]:
    """The rows of a run, kept in its folder: to open its draws again takes far longer."""
    said = said_before(run.path, STUDY_ROWS, STUDY_ROWS_FROM) or {}
    rows: list[dict[str, Any]] = said.get("rows", [])
    if not (rows and are_rows(rows)):
        rows = rows_of_run(run)
        with contextlib.suppress(InputError):  # of a folder that cannot be written
            keep_said(run.path, STUDY_ROWS, STUDY_ROWS_FROM, {"rows": rows})
    return rows


def _reason(run: Run) -> str:
    return "" if run.state == "converged" else str(run.provenance["convergence"]["reason"])


@dataclass(frozen=True)
class LayerTask:
    """Runs to compare with one another: the layers of one donor.

    Attributes
    ----------
    donor : str
        Empty where the specimens have none.
    labels, layers : tuple of str
    folders : tuple of Path
    """

    donor: str
    labels: tuple[str, ...]
    layers: tuple[str, ...]
    folders: tuple[Path, ...]


def compare_layers(task: LayerTask) -> LayersFound:
    """Compare the layers of one donor; nothing is raised."""
    from biaxbayes.comparison.compare import Member, compare

    layer_of = dict(zip(task.labels, task.layers, strict=True))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            runs = [open_run(folder) for folder in task.folders]
            found = compare(
                [
                    Member(label, run.posterior(), run.draws, run.state, run.stated)
                    for label, run in zip(task.labels, runs, strict=True)
                ]
            )
        except BiaxbayesError as error:
            return LayersFound(task.donor, pd.DataFrame(), [f"no comparison: {error}"])
    table = found.distances
    table.insert(0, "donor", task.donor)
    for k, side in enumerate("ab"):
        table.insert(1 + k, f"layer_{side}", [layer_of[v] for v in table[f"run_{side}"]])
    return LayersFound(task.donor, table, list(found.notes))


# --- the study -----------------------------------------------------------------------------------

RECORD, GOING = "study.json", ".going-"
COMPARED_HERE = 4
"""Donors whose layers are compared sooner than workers have started."""


@dataclass
class Batch:
    """A study, the folder it is kept in and who does the work.

    Attributes
    ----------
    study : Study
    folder : Path
    executor : Executor
    """

    study: Study
    folder: Path
    executor: Executor = field(default_factory=InThisProcess)

    def execute(
        self,
        *,
        progress: Callable[[Progress], None] = lambda p: None,
        stop: Callable[[], int] = lambda: False,
    ) -> StudyResult:
        """Sample what is missing, compare the layers of each donor, and write every file.

        Raises
        ------
        RunError
            If the folder is in use or holds something else, or no worker sees it.
        Interrupted
            If stopped; what was done is saved.
        """
        self._make_folder()
        with folder_lock(self.folder), self.executor, self._going() as going:
            progress(Progress("reading specimens"))
            entries = read_entries(self.study)
            done = self._recorded("done")
            tried = self._sample(entries, done, going, progress, stop)
            result = self._result(entries, tried, progress)
        return result

    def _make_folder(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = {p.name for p in self.folder.iterdir() if not p.name.startswith(".")}
            if names - {RUNS} and RECORD not in names:
                raise RunError(
                    f"{self.folder}: is a folder that is not a study's; choose another --out"
                )
            (self.folder / RUNS).mkdir(exist_ok=True)
        except OSError as error:
            raise RunError(
                f"{self.folder}: cannot be made ({error.strerror}); choose another --out"
            ) from None

    @contextlib.contextmanager
    def _going(self) -> Iterator[Path]:
        """A file that is there as long as the study goes on; where it goes, workers stop."""
        for left in self.folder.glob(f"{GOING}*"):
            left.unlink(missing_ok=True)
        path = self.folder.absolute() / f"{GOING}{uuid.uuid4().hex[:12]}"
        path.touch()
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    def _recorded(self, key: str) -> dict[str, str]:
        """What the record holds: ``done``, or ``written``; empty where it cannot be read."""
        try:
            record = json.loads((self.folder / RECORD).read_text(encoding="utf-8"))
            return {str(k): str(v) for k, v in record[key].items()}
        except (OSError, ValueError, KeyError, AttributeError, TypeError, RecursionError):
            return {}

    def _save(self, done: dict[str, str], written: dict[str, str] | None = None) -> None:
        """Keep the fingerprints of the finished runs, and the digests of what was written."""
        written = self._recorded("written") if written is None else written
        record = {"biaxbayes": biaxbayes.__version__, "name": self.study.name, "done": done}
        if written:
            record |= {"written": written}
        if self.study.columns:
            stated = {e.label: dict(e.columns) for e in self.study.specimens}
            record |= {"columns": list(self.study.columns), "stated": stated}
        atomic_write_text(self.folder / RECORD, json.dumps(record, indent=2) + "\n")

    def _write(self, result: StudyResult) -> None:
        """Write every file, unless those that are there are of this very result."""
        result_digest = {"result": _digest(result)}
        if self._recorded("written") == self._files() | result_digest:
            return
        write_study(result)
        self._save(self._recorded("done"), self._files() | result_digest)

    def _files(self) -> dict[str, str]:
        """Digests of the files of the study."""
        found = manifest(self.folder)
        return {k: v for k, v in found.items() if k != RECORD and not k.startswith(".")}

    def _sample(
        self,
        entries: list[Entry],
        done: dict[str, str],
        going: Path,
        progress: Callable[[Progress], None],
        stop: Callable[[], int],
    ) -> dict[str, Tried]:
        """What became of every specimen, by its folder's name."""
        tried = {e.slug: failed(e.problem) for e in entries if e.specimen is None}
        readable = [e for e in entries if e.specimen is not None]
        done = {e.slug: e.fingerprint for e in readable if done.get(e.slug) == e.fingerprint}
        done = {k: v for k, v in done.items() if is_run(self.folder / RUNS / k)}
        self._save(done)
        there = [e for e in readable if e.slug in done]
        readable = there + [e for e in readable if e.slug not in done]
        tasks = [self._task(e, e.slug in done, going) for e in readable]
        before, clock = len(done), time.monotonic()
        finished = f", {before} of them finished before" if before else ""
        progress(Progress(f"sampling {len(entries)} specimens{finished}"))
        asked = 0

        def stopped() -> int:
            nonlocal asked
            asked = asked or stop()
            if asked:
                going.unlink(missing_ok=True)
            return asked

        for outcome in self._outcomes(tasks, before, stopped):
            entry = readable[outcome.index]
            found = failed(outcome.lost) if outcome.lost else outcome.value
            if found.state == INTERRUPTED:
                if not stopped():
                    raise RunError(
                        f"{found.reason} {self.folder.absolute()}; put it where all workers see it"
                    )
                continue
            tried[entry.slug] = found
            for note in found.notes:
                progress(Progress("sampling", note=f"{entry.entry.label}: {note}"))
            if found.state in STATES:
                done[entry.slug] = entry.fingerprint
                self._save(done)
            bad = sum(t.state not in STATES for t in tried.values())
            told = f"{len(tried)} of {len(entries)} specimens" + (f", {bad} failed" if bad else "")
            if len(tried) > before:
                spent = time.monotonic() - clock
                told += _left(spent * (len(entries) - len(tried)) / (len(tried) - before))
            progress(Progress(told, len(tried) / len(entries)))
        if len(tried) < len(entries):
            raise _interruption(len(tried), len(entries), self.folder, asked)
        return tried

    def _outcomes(
        self, tasks: list[SpecimenTask], finished: int, stop: Callable[[], int]
    ) -> Iterator[Outcome[Tried]]:
        """Finished runs, the first tasks, are read here: no worker has to start for them."""
        yield from InThisProcess().run(try_specimen, tasks[:finished], stop=stop)
        for outcome in self.executor.run(try_specimen, tasks[finished:], stop=stop):
            yield replace(outcome, index=finished + outcome.index)

    def _task(self, entry: Entry, finished: bool, going: Path) -> SpecimenTask:
        assert entry.specimen is not None
        return SpecimenTask(
            entry.specimen,
            entry.entry.file.name,
            self.folder.absolute() / RUNS / entry.slug,
            dict(entry.entry.options),
            entry.entry.seed,
            self.study.ess,
            self.study.max_steps,
            entry.entry.anyway,
            finished,
            going,
        )

    def _result(
        self,
        entries: list[Entry],
        tried: dict[str, Tried],
        progress: Callable[[Progress], None],
    ) -> StudyResult:

        table = study_table(entries, tried)
        progress(Progress("comparing layers"))
        folders = {e.entry.label: self.folder.absolute() / RUNS / e.slug for e in entries}
        tasks = [
            LayerTask(donor, labels, layers, tuple(folders[label] for label in labels))
            for donor, labels, layers in donor_groups(table)
        ]
        found: dict[int, LayersFound] = {}
        few = len(tasks) <= COMPARED_HERE
        for outcome in (InThisProcess() if few else self.executor).run(compare_layers, tasks):
            lost = LayersFound(tasks[outcome.index].donor, pd.DataFrame(), [outcome.lost])
            found[outcome.index] = lost if outcome.lost else outcome.value
        progress(Progress("writing"))
        result = result_of(self.study.name, self.folder, table, [found[i] for i in sorted(found)])
        self._write(result)
        return result


def _digest(result: StudyResult) -> str:
    """SHA-256 of everything that the files of a study say."""
    tables = (result.table, result.groups, result.contrasts, result.distances)
    told = [biaxbayes.__version__, result.name, *result.notes, *(csv_text(t) for t in tables)]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def _left(seconds: float) -> str:
    """Time left in words; nothing where there is none."""
    if seconds < 1.0:
        return ""
    return (
        f", about {seconds:.0f} s left"
        if seconds < 90.0
        else f", about {seconds / 60:.0f} min left"
    )


def _interruption(done: int, total: int, folder: Path, signal: int) -> Interrupted:
    error = Interrupted(
        f"interrupted after {done} of {total} specimens, all saved in {folder}; the same command "
        "continues"
    )
    if not isinstance(signal, bool) and signal:
        error.exit_code = 128 + signal
    return error
