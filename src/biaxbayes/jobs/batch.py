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
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

import biaxbayes
from biaxbayes.errors import Interrupted, RunError
from biaxbayes.executors.executor import Executor, InThisProcess, Outcome
from biaxbayes.jobs.opening import Stop, never, silent
from biaxbayes.jobs.study_tasks import (
    LayerTask,
    SpecimenTask,
    compare_layers,
    failed,
    layers_before,
    try_specimen,
)
from biaxbayes.progress_bar import Stage
from biaxbayes.runs.folder import STATES, is_run, manifest
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
            progress(Stage("reading specimens"))
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
        from biaxbayes.reports.study_page import write_study

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
        progress: Callable[[Any], None],
        stop: Stop,
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
        progress(Stage(f"sampling {len(entries)} specimens{finished}"))
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
                progress(Stage("sampling", note=f"{entry.entry.label}: {note}"))
            if found.state in STATES:
                done[entry.slug] = entry.fingerprint
                self._save(done)
            bad = sum(t.state not in STATES for t in tried.values())
            told = f"{len(tried)} of {len(entries)} specimens" + (f", {bad} failed" if bad else "")
            if len(tried) > before:
                spent = time.monotonic() - clock
                told += _left(spent * (len(entries) - len(tried)) / (len(tried) - before))
            progress(Stage(told, len(tried) / len(entries)))
        if len(tried) < len(entries):
            raise _interruption(len(tried), len(entries), self.folder, asked)
        return tried

    def _outcomes(
        self, tasks: list[SpecimenTask], finished: int, stop: Stop
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
        progress: Callable[[Any], None],
    ) -> StudyResult:

        table = study_table(entries, tried)
        progress(Stage("comparing layers"))
        folders = {e.entry.label: self.folder.absolute() / RUNS / e.slug for e in entries}
        tasks = [
            LayerTask(donor, labels, layers, tuple(folders[label] for label in labels))
            for donor, labels, layers in donor_groups(table)
        ]
        found = {task: before for task in tasks if (before := layers_before(task)) is not None}
        tasks_left = [task for task in tasks if task not in found]
        few = len(tasks_left) <= COMPARED_HERE
        for outcome in (InThisProcess() if few else self.executor).run(compare_layers, tasks_left):
            task = tasks_left[outcome.index]
            lost = LayersFound(task.donor, pd.DataFrame(), [outcome.lost])
            found[task] = lost if outcome.lost else outcome.value
        progress(Stage("writing"))
        result = result_of(self.study.name, self.folder, table, [found[task] for task in tasks])
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
