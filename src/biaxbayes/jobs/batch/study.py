"""A study in a folder: every specimen sampled once, whatever comes between.

Everything that the task of a worker needs is in it, and everything it finds goes back; the run
folders lie in the study's, which every worker must see.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

import biaxbayes
from biaxbayes.errors import Interrupted, RunError
from biaxbayes.executors.executor import Executor, InThisProcess
from biaxbayes.jobs.batch.tasks import (
    FigureTask,
    LayerTask,
    SpecimenTask,
    Task,
    WritingTask,
    compare_layers,
    failed,
    layers_before,
    work_on,
)
from biaxbayes.jobs.opening import Stop, never, silent
from biaxbayes.progress_bar import Progress
from biaxbayes.runs.folder import STATES, STUDY, is_run, manifest
from biaxbayes.runs.lock import folder_lock
from biaxbayes.studies.entries import RUNS, Entry, read_entries
from biaxbayes.studies.result import (
    INTERRUPTED,
    LayersFound,
    StudyResult,
    Tried,
    donor_groups,
    result_of,
    study_table,
)
from biaxbayes.studies.study_file import Study
from biaxbayes.text_files import atomic_write_text, csv_text

__all__ = ["Batch"]

# --- the study -----------------------------------------------------------------------------------

GOING = ".going-"
COMPARED_HERE = 4
"""Donors whose layers are compared sooner than workers have started."""


@dataclass
class Found:
    """What is known of a study.

    Attributes
    ----------
    tried : dict of Tried
        By the name of the run folder.
    layers : dict
        What was found, by the comparison; None while it is to be made.
    pictures : dict of bytes or None
        Files of the figure, by name; None while it is not drawn.
    """

    tried: dict[str, Tried]
    layers: dict[LayerTask, LayersFound | None] = field(default_factory=dict)
    pictures: dict[str, bytes] | None = None


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
        progress: Callable[[Any], None] = silent,
        stop: Stop = never,
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
            found = self._found(entries, going, progress, stop)
            progress(Progress("writing"))
            result = self._result(entries, found)
            self._write(replace(result, folder=self.folder.absolute()), found.pictures)
        return result

    def _make_folder(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = {p.name for p in self.folder.iterdir() if not p.name.startswith(".")}
            if names - {RUNS} and STUDY not in names:
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
            record = json.loads((self.folder / STUDY).read_text(encoding="utf-8"))
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
        atomic_write_text(self.folder / STUDY, json.dumps(record, indent=2) + "\n")

    def _write(self, result: StudyResult, pictures: dict[str, bytes] | None) -> None:
        """Write every file, unless those that are there are of this very result."""
        result_digest = {"result": _digest(result)}
        if self._recorded("written") == self._files() | result_digest:
            return
        task = WritingTask(result, pictures)
        if pictures is None or any(o.lost for o in self.executor.run(work_on, [task])):
            work_on(task)  # where no worker is there that has what it takes
        self._save(self._recorded("done"), self._files() | result_digest)

    def _files(self) -> dict[str, str]:
        """Digests of the files of the study."""
        found = manifest(self.folder)
        return {k: v for k, v in found.items() if k != STUDY and not k.startswith(".")}

    def _found(
        self,
        entries: list[Entry],
        going: Path,
        progress: Callable[[Any], None],
        stop: Stop,
    ) -> Found:
        """What became of every specimen, and how far apart the layers of each donor are.

        Finished runs are read here, and few layers compared: no worker has to start for them.
        Where workers have specimens, the layers of a donor are compared once nobody waits for a
        specimen, and the figure is drawn beside the last of them.
        """
        found = Found({e.slug: failed(e.problem) for e in entries if e.specimen is None})
        readable = [e for e in entries if e.specimen is not None]
        done = self._recorded("done")
        done = {e.slug: e.fingerprint for e in readable if done.get(e.slug) == e.fingerprint}
        done = {k: v for k, v in done.items() if is_run(self.folder / RUNS / k)}
        self._save(done)
        there = [e for e in readable if e.slug in done]
        missing = [e for e in readable if e.slug not in done]
        tasks: list[Task] = [self._task(e, False, going) for e in missing]
        if missing:
            self.executor.get_ready()
        before, clock = len(there), time.monotonic()
        finished = f", {before} of them finished before" if before else ""
        progress(Progress(f"sampling {len(entries)} specimens{finished}"))
        asked = 0

        def stopped() -> int:
            nonlocal asked
            asked = asked or stop()
            if asked:
                going.unlink(missing_ok=True)
            return asked

        def take(entry: Entry, tried: Tried) -> None:
            if tried.state == INTERRUPTED:
                if not stopped():
                    raise RunError(
                        f"{tried.reason} {self.folder.absolute()}; put it where all workers see it"
                    )
                return
            found.tried[entry.slug] = tried
            for note in tried.notes:
                progress(Progress("sampling", note=f"{entry.entry.label}: {note}"))
            if tried.state in STATES and entry.slug not in done:
                done[entry.slug] = entry.fingerprint
                self._save(done)
            progress(_how_far(found.tried, len(entries), before, time.monotonic() - clock))
            tasks.extend(self._left_to_compare(entries, entry, found))

        for outcome in InThisProcess().run(
            work_on, [self._task(e, True, going) for e in there], stop=stopped
        ):
            take(there[outcome.index], outcome.value)
        few = not missing and len(tasks) <= COMPARED_HERE
        executor = InThisProcess() if few else self.executor
        for outcome in executor.run(work_on, tasks, stop=stopped):
            task, lost = tasks[outcome.index], outcome.lost
            if isinstance(task, SpecimenTask):
                take(missing[outcome.index], failed(lost) if lost else outcome.value)
                if len(found.tried) == len(entries):
                    progress(Progress("comparing layers"))
                    tasks.append(FigureTask(study_table(entries, found.tried)))
            elif isinstance(task, LayerTask):
                none = LayersFound(task.donor, pd.DataFrame(), [lost])
                found.layers[task] = none if lost else outcome.value
            else:
                found.pictures = outcome.value
        if len(found.tried) < len(entries):
            raise _interruption(len(found.tried), len(entries), self.folder, asked)
        return found

    def _left_to_compare(self, entries: list[Entry], last: Entry, found: Found) -> list[LayerTask]:
        """Comparisons that wait for no specimen any more, and were not made before."""
        same = [e for e in entries if e.donor == last.donor] if last.donor else entries
        if any(e.slug not in found.tried for e in same):
            return []
        out = []
        for task in self._comparisons(same, study_table(same, found.tried)):
            if task not in found.layers:
                found.layers[task] = layers_before(task)
                out += [task] if found.layers[task] is None else []
        return out

    def _comparisons(self, entries: list[Entry], table: pd.DataFrame) -> list[LayerTask]:
        folders = {e.entry.label: self.folder.absolute() / RUNS / e.slug for e in entries}
        return [
            LayerTask(donor, labels, layers, tuple(folders[label] for label in labels))
            for donor, labels, layers in donor_groups(table)
        ]

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

    def _result(self, entries: list[Entry], found: Found) -> StudyResult:
        table = study_table(entries, found.tried)
        layers = [  # who stopped when all was sampled has the rest of them compared here
            found.layers.get(task) or compare_layers(task)
            for task in self._comparisons(entries, table)
        ]
        return result_of(self.study.name, self.folder, table, layers)


def _digest(result: StudyResult) -> str:
    """SHA-256 of everything that the files of a study say."""
    tables = (result.table, result.groups, result.contrasts, result.distances)
    told = [biaxbayes.__version__, result.name, *result.notes, *(csv_text(t) for t in tables)]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def _how_far(tried: Mapping[str, Tried], total: int, before: int, seconds: float) -> Progress:
    """Where the sampling stands, and how long it will take yet."""
    bad = sum(t.state not in STATES for t in tried.values())
    told = f"{len(tried)} of {total} specimens" + (f", {bad} failed" if bad else "")
    if len(tried) > before:
        told += _left(seconds * (total - len(tried)) / (len(tried) - before))
    return Progress(told, len(tried) / total)


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
