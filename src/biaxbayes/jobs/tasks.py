"""What a worker of a study does: sample one specimen, or compare the layers of one donor.

Everything a task needs is in it, and everything it finds goes back; the run folders lie in the
study's, which every worker must see.
"""

from __future__ import annotations

import os
import socket
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from biaxbayes.errors import BiaxbayesError, CannotResume, Interrupted
from biaxbayes.jobs.sample import Sampling
from biaxbayes.laws import DEFAULT_LAW
from biaxbayes.runs.run import Run, open_run
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.studies.result import (
    FAILED,
    INTERRUPTED,
    LayersFound,
    Tried,
    rows_of_run,
    rows_without_run,
)

__all__ = [
    "LayerTask",
    "SpecimenTask",
    "compare_layers",
    "try_specimen",
]


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
            return Tried(run.state, _reason(run), rows_of_run(run), notes)
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
