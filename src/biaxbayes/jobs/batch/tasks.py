"""What a worker does for a study: sample a specimen, compare layers, draw, write.

Nothing heavy is imported here before it is needed: to say again what is known takes little.
"""

from __future__ import annotations

import contextlib
import os
import socket
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from biaxbayes.errors import BiaxbayesError, CannotResume, InputError, Interrupted
from biaxbayes.laws import DEFAULT_LAW
from biaxbayes.runs.folder import READY
from biaxbayes.runs.said import (
    IDENTIFIED,
    IDENTIFIED_TABLES,
    STUDY_FROM,
    STUDY_LAYERS,
    STUDY_ROWS,
    keep_said,
    said_before,
)
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.studies.result import (
    FAILED,
    INTERRUPTED,
    LayersFound,
    StudyResult,
    Tried,
    are_distances,
    are_notes,
    are_rows,
    layers_found,
    rows_without_run,
)

if TYPE_CHECKING:
    from biaxbayes.comparison.compare import Member
    from biaxbayes.runs.run import Run

__all__ = [
    "FigureTask",
    "LayerTask",
    "SpecimenTask",
    "Task",
    "WritingTask",
    "compare_layers",
    "failed",
    "layers_before",
    "try_specimen",
    "work_on",
]

# --- sample a specimen, or read its run ----------------------------------------------------------


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
            rows = _rows(task, notes)
            return Tried(rows[0]["state"], rows[0]["reason"], rows, notes)
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


def _rows(task: SpecimenTask, notes: list[str]) -> list[dict[str, Any]]:
    """The rows of the run, kept in its folder: to open its draws again takes far longer."""
    known = task.finished and not (task.folder / READY).exists()  # else a crash left files waiting
    said = said_before(task.folder, STUDY_ROWS, STUDY_FROM) if known else None
    rows: list[dict[str, Any]] = (said or {}).get("rows", [])
    if not are_rows(rows):
        from biaxbayes.studies.rows import rows_of_run

        run = _run(task, notes)
        rows = rows_of_run(run)
        with contextlib.suppress(InputError):  # of a folder that cannot be written
            keep_said(run.path, STUDY_ROWS, STUDY_FROM, {"rows": rows})
    return rows


def _run(task: SpecimenTask, notes: list[str]) -> Run:
    from biaxbayes.runs.run import open_run

    if task.finished:
        return open_run(task.folder)
    from biaxbayes.compilation import first_alone
    from biaxbayes.jobs.sample import Sampling

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


# --- compare the layers of a donor ---------------------------------------------------------------


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

    @property
    def layer_of(self) -> dict[str, str]:
        """Layers by label."""
        return dict(zip(self.labels, self.layers, strict=True))


def layers_before(task: LayerTask) -> LayersFound | None:
    """What was found of the layers of a donor, kept in the folder of the first of its runs.

    None where it must be found anew.
    """
    first, *others = task.folders
    said = said_before(first, STUDY_LAYERS, STUDY_FROM, others) or {}
    rows: list[dict[str, Any]] = said.get("distances", [])
    notes: list[str] = said.get("notes", [])
    same = said.get("labels") == list(task.labels)
    if same and are_distances(rows, task.labels) and are_notes(notes):
        return layers_found(task.donor, task.layer_of, rows, notes)
    return None


def compare_layers(task: LayerTask) -> LayersFound:
    """Compare the layers of one donor; nothing is raised."""
    from biaxbayes.comparison.compare import distances_between

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            members, verdicts = _members(task)
            table, notes = distances_between(members, verdicts)
        except BiaxbayesError as error:
            return LayersFound(task.donor, pd.DataFrame(), [f"no comparison: {error}"])
    rows = [{str(k): v for k, v in row.items()} for row in table.to_dict("records")]
    first, *others = task.folders
    said = {"labels": list(task.labels), "distances": rows, "notes": notes}
    with contextlib.suppress(InputError):  # of a folder that cannot be written
        keep_said(first, STUDY_LAYERS, STUDY_FROM, said, others)
    return layers_found(task.donor, task.layer_of, rows, notes)


def _members(task: LayerTask) -> tuple[list[Member], list[dict[str, str]]]:
    """The runs of a donor, and their verdicts."""
    from biaxbayes.comparison.compare import Member, judged_member
    from biaxbayes.runs.run import open_run

    members, verdicts = [], []
    for label, folder in zip(task.labels, task.folders, strict=True):
        run = open_run(folder)
        member = Member(label, run.posterior(), run.draws, run.state, run.stated)
        members.append(member)
        verdicts.append(_verdicts_before(folder, member) or judged_member(member).verdicts)
    return members, verdicts


def _verdicts_before(folder: Path, member: Member) -> dict[str, str]:
    """Those that ``identify`` said of the run as it is; empty where it did not."""
    said = said_before(folder, IDENTIFIED, IDENTIFIED_TABLES) or {}
    try:
        found = {row["parameter"]: row["verdict"] for row in said["json"]["parameters"]}
    except (KeyError, TypeError):
        return {}
    judged = {q.name for q in member.posterior.quantities.judged()} & {*member.draws.columns}
    return found if all(isinstance(found.get(name), str) for name in judged) else {}


# --- draw the figure, write the files; what a task is --------------------------------------------


@dataclass(frozen=True)
class FigureTask:
    """The figure of a study to draw.

    Attributes
    ----------
    table : DataFrame
        The study table.
    """

    table: pd.DataFrame


@dataclass(frozen=True)
class WritingTask:
    """The files of a study to write.

    Attributes
    ----------
    result : StudyResult
        Its folder is absolute.
    pictures : dict of bytes or None
        Files of the figure, by name; None where it is to be drawn.
    """

    result: StudyResult
    pictures: dict[str, bytes] | None = None


Task = SpecimenTask | LayerTask | FigureTask | WritingTask


def work_on(task: Task) -> Any:
    """Do a task: of a specimen, the layers of a donor, the figure, or the files of the study."""
    if isinstance(task, SpecimenTask):
        return try_specimen(task)
    if isinstance(task, LayerTask):
        return compare_layers(task)
    from biaxbayes.reports.study_page import study_pictures, write_study

    if isinstance(task, FigureTask):
        return study_pictures(task.table)
    return write_study(task.result, task.pictures)
