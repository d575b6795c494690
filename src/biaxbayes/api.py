"""The verbs, for Python. The command line parses its options, calls these and prints.

A run may be given by its folder, a specimen by its CSV. What a verb writes goes where ``out`` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.jobs.batch import batch
from biaxbayes.jobs.findings import design, identify, ledger, profile
from biaxbayes.jobs.opening import (
    PathLike,
    RunLike,
    SpecimenLike,
    Stop,
    Tell,
    is_run,
    made_folder,
    never,
    opened_specimen,
    refuse_finished,
    silent,
    usable_run,
)
from biaxbayes.jobs.outputs import (
    cards_folder,
    check_cards,
    export,
    inflate,
    predict,
    report,
    report_text,
)
from biaxbayes.jobs.run_figure import WITHOUT_JUDGEMENT, check_figure, picture, picture_name, plot
from biaxbayes.jobs.sample import sample
from biaxbayes.jobs.simulate import simulate, truth_file
from biaxbayes.jobs.specimen_files import check, convert, fit, fit_all
from biaxbayes.options import (
    CalibrationPlan,
    InferringOptions,
    LawsPlan,
    ModelOptions,
    PopulationOptions,
    SamplingPlan,
    documented,
)
from biaxbayes.parallel import executor_for
from biaxbayes.progress_bar import with_progress
from biaxbayes.runs.folder import POPULATION
from biaxbayes.runs.run import open_run
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from biaxbayes.comparison.compare import Comparison
    from biaxbayes.comparison.law_weights import LawComparison
    from biaxbayes.jobs.calibrate import Outcome
    from biaxbayes.jobs.population_files import PopulationFound

__all__ = [
    "WITHOUT_JUDGEMENT",
    "batch",
    "calibrate",
    "cards_folder",
    "check",
    "check_cards",
    "check_comparison",
    "check_figure",
    "compare",
    "compare_laws",
    "convert",
    "design",
    "export",
    "fit",
    "fit_all",
    "identify",
    "inflate",
    "ledger",
    "open_run",
    "picture",
    "picture_name",
    "plot",
    "population",
    "predict",
    "profile",
    "report",
    "report_text",
    "sample",
    "simulate",
    "truth_file",
    "usable_run",
]

# --- runs and specimens side by side -------------------------------------------------------------


@with_progress
@documented(LawsPlan, ModelOptions, without=("law", "fibre_switch", "priors"))
def compare_laws(
    specimen: SpecimenLike,
    *,
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    resume: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Tell = silent,
    stop: Stop = never,
    **options: Any,
) -> LawComparison:
    """Fit and sample every law on a specimen, and weigh them by what they predict.

    Each protocol is left out in turn, or each quarter of the only one.

    Parameters
    ----------
    specimen : Specimen or path-like
    out : path-like, optional
        Folder for laws.csv, stated.csv, left-out.csv, stacked-draws.csv, stacked-bands.csv, the
        figures and laws.html.
    mounting_force : (float, float), optional
        For a tared specimen: the force (or stress) at the mounted state, put back on.
    resume : bool
        Go on with what the folder holds.
    workers : int, optional
        Local processes; the result does not depend on them.
    scheduler : str, optional
        Address of a Dask scheduler to use instead.
    progress, stop : callable
    **options
        As in :class:`~biaxbayes.options.LawsPlan` and :class:`~biaxbayes.options.ModelOptions`,
        without what belongs to one law.

    Returns
    -------
    LawComparison
    """
    from biaxbayes.jobs.laws import chosen_laws, compared_laws

    plan, left = LawsPlan.taken(options)
    own = [name for name in ("law", "fibre_switch", "priors") if left.get(name)]
    if own:
        raise InputError(f"{own[0]} belongs to one law", remedy="use sample for that")
    model = ModelOptions.of(left).keywords()
    common = {k: v for k, v in model.items() if k not in ("law", "fibre_switch", "priors")}
    return compared_laws(
        opened_specimen(specimen, mounting_force),
        common,
        chosen_laws(plan.laws),
        plan,
        executor_for(workers, scheduler),
        folder=None if out is None else made_folder(out),
        resume=resume,
        progress=progress,
        stop=stop,
    )


@with_progress
@documented(SamplingPlan, ModelOptions)
def compare(
    runs: Sequence[RunLike | SpecimenLike],
    *,
    labels: Sequence[str] | None = None,
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    anyway: bool = False,
    overwrite: bool = False,
    progress: Tell | None = None,
    stop: Stop = never,
    **options: Any,
) -> Comparison:
    """Runs side by side: verdicts, and how far apart they are in what both determine.

    Parameters
    ----------
    runs : sequence of Run, Specimen or path-like
        Two or more. A specimen is sampled first, into a run folder inside of ``out``.
    labels : sequence of str, optional
        Default: the layers if they differ, else the specimens, else the folders.
    out : path-like, optional
        Folder of the tables, figures and the page, compare.html.
    mounting_force : (float, float), optional
        Of tared specimens to sample.
    anyway : bool
        Take runs whose chains have not converged, which get no verdict, and specimens that
        cannot be loading curves.
    overwrite : bool
        Replace finished runs of specimens in ``out``.
    progress, stop : callable, optional
        As in :func:`biaxbayes.sample`.
    **options
        For specimens to sample, as in :func:`biaxbayes.sample`.
    """
    from biaxbayes.comparison.compare import Member, labels_of
    from biaxbayes.comparison.compare import compare as lay_out
    from biaxbayes.reports.comparison import write_comparison

    ModelOptions.of(SamplingPlan.taken(options)[1])
    check_comparison(runs, labels)
    opened = []
    for source in runs:
        if is_run(source):
            run = source
        elif out is None:
            raise InputError("a specimen is sampled into a folder", remedy="state it with out")
        else:
            stem = source.name if isinstance(source, Specimen) else Path(source).stem  # type: ignore
            run = sample(
                source,  # type: ignore[arg-type]
                out=Path(out) / f"{stem}-posterior",
                mounting_force=mounting_force,
                anyway=anyway,
                overwrite=overwrite,
                progress=progress,
                stop=stop,
                **options,
            )
        opened.append(usable_run(run, anyway=anyway))  # type: ignore[arg-type]
    names = labels or labels_of([r.specimen for r in opened], [r.path.name for r in opened])
    # Draws taken anyway still get no verdict.
    states = ["tentative" if r.state == "unusable" else r.state for r in opened]
    found = lay_out(
        [
            Member(name, run.posterior(), run.draws, state, run.stated)
            for name, run, state in zip(names, opened, states, strict=True)
        ]
    )
    if out is not None:
        write_comparison(found, Path(out))
    return found


def check_comparison(runs: Sequence[Any], labels: Sequence[str] | None) -> None:
    """Refuse fewer than two runs, or labels that are not one each."""
    if len(runs) < 2:
        raise InputError("a comparison needs two runs or more")
    if labels is not None and (len(labels) != len(runs) or not all(labels)):
        raise InputError(
            f"--labels names {len(labels)} runs of {len(runs)}", remedy="one each, between commas"
        )


# --- verbs that sample many specimens ------------------------------------------------------------


@with_progress
@documented(PopulationOptions)
def population(
    study: PathLike,
    *,
    out: PathLike,
    runs: PathLike | None = None,
    priors: PathLike | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    anyway: bool = False,
    progress: Tell = silent,
    stop: Stop = never,
    **options: Any,
) -> PopulationFound:
    """What the specimens of a study have in common: a hierarchical posterior over them.

    Parameters
    ----------
    study : path-like
        The folder of a finished study, or a study file, whose specimens are sampled first where
        that has not been done.
    out : path-like
        Folder of population.csv, specimens.csv, contrasts.csv and population.nc.
    runs : path-like, optional
        For a study file: the study folder; default as of ``biaxbayes batch``, ``<stem>-study``.
    priors : path-like, optional
        Population priors, a TOML file.
    scheduler : str, optional
        Address of a Dask scheduler, for specimens that have to be sampled first.
    resume : bool
        Continue from the folder's checkpoint where there is one.
    overwrite : bool
        Replace a finished population, with all that was made of it.
    anyway : bool
        Take specimens whose runs are tentative, too.
    progress, stop : callable, optional
        As in :func:`biaxbayes.sample`.
    **options
        As in :class:`~biaxbayes.options.PopulationOptions`.
    """
    from biaxbayes.jobs.population import PopulationJob
    from biaxbayes.jobs.population_files import members_of_study
    from biaxbayes.populations.model import PopulationPriors

    chosen = PopulationOptions.of(options)
    stated = PopulationPriors() if priors is None else PopulationPriors.read(Path(priors))
    refuse_finished(Path(out), POPULATION, resume=resume, overwrite=overwrite)
    source = Path(study)
    if not source.is_dir():
        folder = Path(runs) if runs is not None else Path(f"{source.stem}-study")
        batch(
            source,
            out=folder,
            workers=chosen.workers,
            scheduler=scheduler,
            progress=progress,
            stop=stop,
        )
        source = folder
    elif runs is not None:
        raise InputError("--runs goes with a study file", file=source)
    name, members = members_of_study(source)
    job = PopulationJob(name, members, Path(out), chosen, stated, anyway)
    return job.execute(resume=resume, overwrite=overwrite, progress=progress, stop=stop)


@with_progress
@documented(CalibrationPlan, InferringOptions)
def calibrate(
    specimen: SpecimenLike,
    *,
    out: PathLike,
    mounting_force: Sequence[float] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = True,
    progress: Tell = silent,
    stop: Stop = never,
    **options: Any,
) -> Outcome:
    """Simulation-based calibration on the protocols of a specimen.

    Parameters
    ----------
    specimen : Specimen or path-like
    out : path-like
        Folder of the study.
    mounting_force : (float, float), optional
        For a tared specimen: the force (or stress) at the mounted state, put back on.
    workers, scheduler, progress, stop
        As in :func:`batch`.
    resume : bool
        Continue the study that the folder holds.
    **options
        As in :class:`~biaxbayes.options.CalibrationPlan` and
        :class:`~biaxbayes.options.InferringOptions`.
    """
    from biaxbayes.jobs.calibrate import CalibrationStudy, study_of

    plan, model = CalibrationPlan.taken(options)
    asked = InferringOptions.of(model).keywords()
    executor = executor_for(workers, scheduler)
    study = study_of(opened_specimen(specimen, mounting_force), asked, plan)
    kept = CalibrationStudy(study, Path(out), plan.replications, executor)
    return kept.execute(resume=resume, progress=progress, stop=stop)
