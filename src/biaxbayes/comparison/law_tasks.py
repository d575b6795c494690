"""Posteriors of a comparison of laws: what is to be sampled, and what a folder stores of it."""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.law_comparison import (
    WHOLE,
    PredictedReadings,
    Prediction,
    Task,
    left_out_parts,
    sample_part,
)
from biaxbayes.errors import Interrupted, RunError
from biaxbayes.options import LawsPlan
from biaxbayes.progress_bar import OnProgress, Progress
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.stored_data import DamagedArchive, pack_record, read_record
from biaxbayes.tasks import Executor, Stop
from biaxbayes.text_files import atomic_write_bytes


def law_tasks(
    laws: Sequence[str], specimen: Specimen, options: Mapping[str, Any], plan: LawsPlan
) -> list[Task]:
    """Every law on the whole record, and without each part of it."""
    tasks = []
    for law in laws:
        for part in (None, *left_out_parts(specimen)):
            # The seed of a law and part does not depend on which others are sampled.
            text = f"{law}/{part.name if part else WHOLE}"
            key = int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")
            seed = int(np.random.default_rng([plan.seed, key]).integers(2**62))
            tasks.append(Task(law, specimen, part, options, seed, plan.ess, plan.max_steps))
    return tasks


def sample_parts(
    tasks: Sequence[Task], folder: Path | None, executor: Executor, progress: OnProgress, stop: Stop
) -> dict[tuple[str, str], Prediction]:
    """Predictions by law and part, read from the folder or computed and stored there."""
    files = [None if folder is None else folder / f"{i:03d}.npz" for i in range(len(tasks))]
    results = [None if file is None else _read(file) for file in files]
    missing = [i for i, result in enumerate(results) if result is None]
    with tempfile.TemporaryDirectory() as place:
        told = {i: ProgressFile(Path(place) / str(i)) for i in missing}

        def show() -> None:
            done = len(tasks) - results.count(None)
            latest = {i: told[i].read() for i in missing if results[i] is None}
            running = [f"{tasks[i].name}: {p.phase}" for i, p in latest.items() if p]
            share = done + sum(p.share or 0.0 for p in latest.values() if p)
            # one that does not converge takes many times the mean of the others: it is named
            named = f"; {running[0]}" if running else ""
            progress(Progress(f"{done} of {len(tasks)} posteriors{named}", share / len(tasks)))

        def show_and_stop() -> int:
            show()
            return stop()

        def tell_here(file: ProgressFile, latest: Progress) -> None:
            file(latest)
            show()

        # in this process nobody asks for a stop while a task is running
        here = type(executor) is Executor
        work = [(tasks[i], partial(tell_here, told[i]) if here else told[i]) for i in missing]
        for outcome in executor.run(_sample, work, stop=show_and_stop):
            index = missing[outcome.index]
            if outcome.failure:
                raise RunError(f"{tasks[index].name}: {outcome.failure}")
            results[index], file = outcome.value, files[index]
            if file is not None:
                _write(file, outcome.value)
        if missing:
            show()
    if None in results:
        text = f"interrupted after {len(tasks) - results.count(None)} of {len(tasks)} posteriors"
        raise Interrupted(text, stop(), folder=folder and folder.parent)
    return {
        (task.law, task.part.name if task.part else WHOLE): result
        for task, result in zip(tasks, results, strict=True)
        if result is not None
    }


def _sample(work: tuple[Task, OnProgress]) -> Prediction:
    return sample_part(*work)


@dataclass(frozen=True)
class ProgressFile:
    """Progress of a task that runs in another process, by way of a file."""

    path: Path

    def __call__(self, progress: Progress) -> None:
        """Write it; a machine that does not share the folder shows none."""
        with contextlib.suppress(OSError):
            self.path.write_text(f"{progress.share or 0.0}\n{progress.phase}")

    def read(self) -> Progress | None:
        """What was written last; None if nothing was, or it is being written."""
        try:
            share, phase = self.path.read_text().split("\n")
            return Progress(phase, float(share))
        except (OSError, ValueError):
            return None


def _write(path: Path, prediction: Prediction) -> None:
    draws = {"draws": prediction.draws.to_numpy(), "columns": list(prediction.draws.columns)}
    readings = {} if prediction.readings is None else vars(prediction.readings)
    path.parent.mkdir(exist_ok=True)
    atomic_write_bytes(path, pack_record(vars(prediction) | draws | {"readings": readings}))


def _read(path: Path) -> Prediction | None:
    """A stored prediction; None if it is missing or damaged and has to be made again."""
    try:
        record = read_record(path)
        draws = pd.DataFrame(record["draws"], columns=record.pop("columns"))
        readings = PredictedReadings(**record["readings"]) if record["readings"] else None
        return Prediction(**record | {"readings": readings, "draws": draws})
    except (DamagedArchive, ValueError, KeyError, TypeError):
        return None
