"""``biaxbayes batch``: sample many specimens and compare them.

A task holds all that its worker needs; every worker must see the study folder, with the runs.
"""

from __future__ import annotations

import math
import os
import socket
import traceback
import uuid
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from biaxbayes.compilation import first_alone
from biaxbayes.derived.determined import largest_equibiaxial
from biaxbayes.errors import (
    BiaxbayesError,
    CannotResume,
    InputError,
    Interrupted,
    RunError,
    as_options,
    printable,
)
from biaxbayes.options import ModelOptions, SamplingPlan, takes_options
from biaxbayes.parallel import executor_for
from biaxbayes.progress_bar import Progress, with_progress
from biaxbayes.reports.study_page import closing_message, write_study
from biaxbayes.runs.folder import PROVENANCE, RUNS, STUDY, claim_folder
from biaxbayes.runs.run import Run, open_run
from biaxbayes.sampling.convergence import STATES
from biaxbayes.stored_data import read_object
from biaxbayes.studies import study_file, study_result
from biaxbayes.studies.record import record_runs, recorded_runs
from biaxbayes.studies.study_file import LoadedSpecimen, Study
from biaxbayes.studies.study_result import (
    INTERRUPTED,
    SpecimenOutcome,
    StudyResult,
    failed_outcome,
)
from biaxbayes.tasks import Executor
from biaxbayes.text_files import cache_problem, os_error_text
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, Stop, no_progress, no_stop
from biaxbayes.verbs.sample import SampleJob


@with_progress
@takes_options(SamplingPlan, ModelOptions)
def batch(
    study: PathLike | Sequence[PathLike],
    *,
    out: PathLike,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: OnProgress = no_progress,
    stop: Stop = no_stop,
    **options: Any,
) -> StudyResult:
    """Sample every specimen of a study that is not finished, and compare them.

    In a script put the call below ``if __name__ == "__main__":``, because it starts processes.

    Parameters
    ----------
    study : path-like, or sequence of path-like
        A study file, or specimen files that share their options.
    out : path-like
        The study folder.
    workers : int, optional
        Local processes; default the number of processors, at most four.
    scheduler : str, optional
        Address of a Dask scheduler to use instead.
    progress, stop : callable, optional
        As in :func:`biaxbayes.sample`.
    **options
        For specimen files: seed, ess, max_steps, anyway (as in :func:`biaxbayes.sample`), and those
        of :class:`~biaxbayes.options.ModelOptions`.
    """
    if isinstance(study, str | Path):
        if options:
            raise InputError("options of a study belong in its file", file=study)
        chosen = study_file.read_study(Path(study))
    else:
        own = ("seed", "ess", "max_steps", "anyway")
        numbers = {k: options.pop(k) for k in own if k in options}
        model = ModelOptions.from_values(options).keywords()
        chosen = study_file.study_of_files([Path(p) for p in study], model, **numbers)
    executor = executor_for(workers, scheduler, isolated=True)
    return run_study(chosen, Path(out), executor, progress=progress, stop=stop)


# --- what a worker does: sample a specimen, read stresses of its run -----------------------------


@dataclass(frozen=True)
class SpecimenTask:
    """A specimen to sample, or whose finished run is to be read."""

    loaded: LoadedSpecimen
    folder: Path
    ess: float
    max_steps: int
    finished: bool
    running: Path  # exists as long as the study runs


def sample_specimen(task: SpecimenTask) -> SpecimenOutcome:
    """Sample a specimen into its run folder, or read its finished run; raises nothing."""
    notes: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if not task.running.exists():
                problem = f"{socket.gethostname()} does not see the study folder"
                return SpecimenOutcome(INTERRUPTED, problem)
            run = open_run(task.folder) if task.finished else _sample(task, notes)
            rows, largest = study_result.rows_of_run(run), math.nan
            if run.state != "unusable":
                largest = largest_equibiaxial(run.draws, run.specimen)
            return SpecimenOutcome(rows[0]["state"], rows[0]["reason"], rows, notes, largest)
        except Interrupted as error:
            return SpecimenOutcome(INTERRUPTED, str(error))
        except BiaxbayesError as error:
            reason = str(error)
        except Exception as error:
            reason = cache_problem(error)
            if isinstance(error, OSError):
                reason = reason or os_error_text(error)
            elif os.environ.get("BIAXBAYES_DEBUG"):
                traceback.print_exc()
            reason = reason or f"internal error: {type(error).__name__}: {error}"
    return failed_outcome(reason, notes, task.loaded.listing.options["law"])


def _sample(task: SpecimenTask, notes: list[str]) -> Run:
    """The run of a specimen, continued from its checkpoint where there is one."""

    def note(progress: Progress) -> None:
        if progress.note:
            notes.append(progress.note)

    def stop() -> bool:
        return not task.running.exists()

    listing = task.loaded.listing
    assert task.loaded.specimen is not None
    job = SampleJob.prepare(
        task.loaded.specimen,
        out=task.folder,
        options=dict(listing.options),
        amount=SamplingPlan(listing.seed, task.ess, task.max_steps, workers=1),
        anyway=listing.anyway,
    )
    job = replace(job, source=listing.file.name)
    run = partial(job.run, overwrite=True, progress=note, stop=stop)
    with first_alone():
        if stop():  # while another process was compiling
            raise Interrupted("stopped before it began")
        try:
            folder = run(resume=True)
        except CannotResume as error:
            notes.append(f"sampled again from the start: {error}")
            folder = run(resume=False)
    return open_run(folder)


def rows_of_stretches(folder: Path, stretches: Sequence[float]) -> tuple[list[dict[str, Any]], str]:
    """Stresses and stiffnesses of a run, or why there are none; nothing is raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return study_result.rows_at_stretches(open_run(folder), stretches), ""
        except BiaxbayesError as error:
            return [], str(error)


# --- the study -----------------------------------------------------------------------------------


RUNNING_PREFIX = ".running-"


def run_study(
    study: Study,
    folder: Path,
    executor: Executor | None = None,
    *,
    progress: OnProgress = no_progress,
    stop: Stop = no_stop,
) -> StudyResult:
    """Sample what is missing, compare the groups, and write every file."""
    executor = executor or Executor()
    with claim_folder(folder, STUDY, own={RUNS}), executor:
        runs = folder.absolute() / RUNS
        runs.mkdir(exist_ok=True)
        for left in folder.glob(f"{RUNNING_PREFIX}*"):
            left.unlink(missing_ok=True)
        # A file that exists as long as the study runs; workers stop when it is removed.
        running = folder.absolute() / f"{RUNNING_PREFIX}{uuid.uuid4().hex[:12]}"
        running.touch()
        try:
            progress(Progress("reading specimens"))
            entries = study_file.load_specimens(study)
            outcomes = _sample_all(study, entries, folder, running, executor, progress, stop)
            notes = []
            for axis in "xy":
                named = {getattr(e.specimen, f"axis_{axis}") for e in entries if e.specimen}
                if len(known := sorted(str(name) for name in named if name)) > 1:
                    words = ", ".join(known)
                    notes.append(f"axis {axis} is not the same direction everywhere: {words}")
            progress(Progress("stresses at common stretches"))
            notes += _add_common_stretches(entries, outcomes, runs, executor)
            table = study_result.study_table(entries, outcomes)
            progress(Progress("writing"))
            result = StudyResult(study.name, folder.absolute(), table, notes)
            write_study(result)
        finally:
            running.unlink(missing_ok=True)
    return result


def _add_common_stretches(
    entries: list[LoadedSpecimen],
    outcomes: dict[str, SpecimenOutcome],
    runs: Path,
    executor: Executor,
) -> list[str]:
    """Add the rows at stretches that every converged specimen reached; why where they lack."""
    known = {e.slug: e for e in entries if outcomes[e.slug].state == "converged"}
    stretches = study_result.common_stretches([outcomes[slug].largest_stretch for slug in known])
    if not stretches:
        return []
    slugs, notes = list(known), []
    at_stretches = partial(rows_of_stretches, stretches=tuple(stretches))
    for outcome in executor.run(at_stretches, [runs / slug for slug in slugs]):
        slug = slugs[outcome.index]
        rows, failure = outcome.value or ([], outcome.failure)
        if failure:
            notes.append(f"{known[slug].listing.label}: no stresses: {failure}")
        outcomes[slug] = replace(outcomes[slug], rows=[*outcomes[slug].rows, *rows])
    return notes


def _sample_all(
    study: Study,
    entries: list[LoadedSpecimen],
    folder: Path,
    running: Path,
    executor: Executor,
    progress: OnProgress,
    stop: Stop,
) -> dict[str, SpecimenOutcome]:
    """The outcome of every specimen, by the name of its run folder."""
    runs = folder.absolute() / RUNS
    outcomes = {e.slug: failed_outcome(e.problem) for e in entries if e.specimen is None}
    recorded = recorded_runs(folder)
    finished = {}
    for e in entries:
        unchanged = e.specimen and recorded.get(e.slug) == e.fingerprint
        if unchanged and "biaxbayes" in read_object(runs / e.slug / PROVENANCE):
            finished[e.slug] = e.fingerprint
    record_runs(study, folder, finished)
    more = f", {len(finished)} of them finished before" if finished else ""
    progress(Progress(f"sampling {len(entries)} specimens{more}"))

    def stopped() -> int:
        if signal := stop():
            running.unlink(missing_ok=True)
        return signal

    tasks = [
        SpecimenTask(e, runs / e.slug, study.ess, study.max_steps, e.slug in finished, running)
        for e in entries
        if e.specimen
    ]
    tasks.sort(key=lambda task: not task.finished)  # reading a finished run takes no time
    for outcome in executor.run(sample_specimen, tasks, stop=stopped):
        entry = tasks[outcome.index].loaded
        result = failed_outcome(outcome.failure) if outcome.failure else outcome.value
        if result.state == INTERRUPTED:
            if not stopped():
                place = folder.absolute()
                raise RunError(f"{result.reason} {place}; put it where all workers see it")
            continue
        outcomes[entry.slug] = result
        for note in result.notes:
            progress(Progress("sampling", note=f"{entry.listing.label}: {note}"))
        if result.state in STATES and entry.slug not in finished:
            finished[entry.slug] = entry.fingerprint
            record_runs(study, folder, finished)
        text = f"{len(outcomes)} of {len(entries)} specimens"
        if failed := sum(t.state not in STATES for t in outcomes.values()):
            text += f", {failed} failed"
        progress(Progress(text, len(outcomes) / len(entries)))
    if len(outcomes) < len(entries):
        text = f"interrupted after {len(outcomes)} of {len(entries)} specimens"
        raise Interrupted(text, stop(), folder=folder, resume=False)
    return outcomes


# --- the command ---------------------------------------------------------------------------------


STUDY_FILE_ENTRIES = {
    **dict.fromkeys(("seed", "ess", "max_steps", "anyway"), "{}"),
    **dict.fromkeys(opt.MODEL, "options"),
    **dict.fromkeys(("fix", "priors"), "priors"),
    "mounting_force": "{}",
}
"""Place of an option in a study file; {} is its name."""


@click.command("batch")
@opt.argument("sources", metavar="STUDY.toml|CSV...", nargs=-1, required=True)
@opt.executor_options
@opt.file_option("out", "Study folder [<stem>-study].")
@opt.options(SamplingPlan, "seed")
@opt.model_options()
@opt.options(SamplingPlan, "ess", "max_steps")
@opt.anyway_option
@opt.quiet_option
def command(sources: tuple[Path, ...], out: Path | None, quiet: bool, **given: Any) -> int:
    r"""Sample many specimens: those of a study file, or the CSV files given.

    Writes a study folder: study.csv with a row for each specimen and quantity, summaries across
    layers and donors, study.html with the groups compared, and in runs/ a run folder of each
    specimen. The same command again does what is missing: a finished specimen is not sampled
    again, an interrupted one continues. A specimen that fails does not stop the others. Exit
    code 0 when every specimen has converged, 3 when one has not or has failed, 2 when nothing
    could be started: a file is missing, a study file, an option or a folder cannot be used.

    \b
    biaxbayes batch study.toml --workers 4
    biaxbayes batch study.toml --scheduler tcp://head:8786
    biaxbayes batch *.csv --out aortas --noise independent
    """
    study: Any = sources
    executor = {name: given.pop(name) for name in ("workers", "scheduler")}
    mounting_force = given.pop("mounting_force")
    studies = [path for path in sources if path.suffix.lower() == ".toml"]
    if studies:
        study = studies[0]
        if len(sources) > 1:
            problem = "a study file cannot be combined with other files"
            raise InputError(problem, file=study, remedy="list all specimens in it")
        for name, key in STUDY_FILE_ENTRIES.items():
            remedy = f"write it in the study file, under {key.format(name)}"
            opt.refuse_options((name,), "{} is for CSV files", file=study, remedy=remedy)
        given = {}
    elif mounting_force is not None:
        remedy = "give mounting_force for each specimen in a study file"
        raise InputError("`mounting_force` belongs to one specimen", remedy=remedy)
    else:
        given = opt.with_priors(**given)
    folder = out or Path(f"{sources[0].stem}-study" if len(sources) == 1 else "study")
    with opt.progress_and_stop(quiet) as work:
        result = batch(study, out=folder, **executor, **work, **given)
    if not quiet:
        click.echo(closing_message(result))
    for label, reason in result.failures.items():
        click.echo(f"biaxbayes: {printable(label)}: {printable(as_options(reason))}", err=True)
    return 0 if result.converged else opt.NOT_CONVERGED
