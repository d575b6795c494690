"""The verbs, for Python. The command line parses its options, calls these and prints.

A run may be given by its folder, a specimen by its CSV. What a verb writes goes where ``out`` says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.executors.executor import executor_for
from biaxbayes.jobs.opening import (
    PathLike,
    RunLike,
    SpecimenLike,
    draw_figure,
    is_run,
    made_folder,
    opened_run,
    opened_specimen,
    refuse_model,
    usable_run,
    write_table,
)
from biaxbayes.jobs.outputs import (
    WITHOUT_JUDGEMENT,
    cards_folder,
    check_cards,
    check_figure,
    export,
    inflate,
    picture,
    picture_name,
    plot,
    predict,
    report,
    report_text,
)
from biaxbayes.jobs.sample import Sampling, sample
from biaxbayes.jobs.specimen_files import check, convert, fit, fit_all, simulate, truth_file
from biaxbayes.options import (
    INFERRING,
    CalibrationPlan,
    DesignOptions,
    LawsPlan,
    LedgerPlan,
    ModelOptions,
    PopulationOptions,
    ProfileOptions,
    SamplingPlan,
    documented,
)
from biaxbayes.progress_bar import with_progress
from biaxbayes.runs.run import open_run
from biaxbayes.sampling.sampler import Progress
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    from biaxbayes.comparison.compare import Comparison
    from biaxbayes.comparison.law_weights import LawComparison
    from biaxbayes.comparison.mounting_bias import Ledger
    from biaxbayes.identifiability.profile import Profile
    from biaxbayes.jobs.calibrate import Outcome
    from biaxbayes.jobs.population_files import PopulationFound
    from biaxbayes.jobs.products import Identified
    from biaxbayes.optimal_design.design import Design
    from biaxbayes.studies.result import StudyResult

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

Tell = Callable[[Progress], None]
Stop = Callable[[], int]


def _silent(progress: Progress) -> None:
    """Where nobody watches."""


def _never() -> int:
    return 0


# --- what a posterior determines -----------------------------------------------------------------


def identify(run: RunLike, *, out: PathLike | None = None, figure: bool = True) -> Identified:
    """Which parameters the data determine: a verdict with its evidence for each.

    Parameters
    ----------
    run : Run or path-like
    out : path-like, optional
        Folder, such as the run's, for identifiability.csv and .pdf, determined.csv and
        same-curves.csv.
    figure : bool
        Whether to draw the figure there.
    """
    from biaxbayes.jobs.products import identified, write_identifiability_products

    opened = opened_run(run)
    judged = opened.posterior(), opened.draws, opened.state
    if out is None:
        return identified(*judged, kept=opened.path)
    folder = made_folder(out)
    return write_identifiability_products(folder, *judged, figure=figure, kept=opened.path)


@documented(ProfileOptions)
def profile(
    source: RunLike | SpecimenLike,
    parameters: Sequence[str] = (),
    *,
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    workers: int = 1,
    **options: Any,
) -> list[Profile]:
    """Profile likelihoods: what the data alone say of each parameter.

    Parameters
    ----------
    source : Run, Specimen or path-like
        A run, with its own model, or a specimen.
    parameters : sequence of str
        C1, k1, k2, alpha, kappa, mounting_stretch_x or _y; the free ones of the first five where
        none is named.
    out : path-like, optional
        Folder for profile.csv, profile-intervals.csv and profile.pdf.
    mounting_force : (float, float), optional
        For a tared specimen: the force (or stress) at the mounted state, put back on.
    workers : int
        Processes.
    **options
        For a specimen, as in :class:`~biaxbayes.options.ProfileOptions`.
    """
    from biaxbayes.figures.run.profile import profile_figure
    from biaxbayes.figures.style import save_figure
    from biaxbayes.identifiability.profile import profiles
    from biaxbayes.jobs.products import write_profiles
    from biaxbayes.model.preparation import prepare

    if is_run(source):
        refuse_model(options, mounting_force)
        posterior = opened_run(source).posterior()  # type: ignore[arg-type]
    else:
        model = ProfileOptions.of(options)
        if "noise_sd" in model.priors:
            raise InputError("noise_sd is profiled out and cannot be fixed here")
        data = opened_specimen(source, mounting_force)  # type: ignore[arg-type]
        posterior = prepare(data, **model.keywords())
    settings = posterior.settings
    names = tuple(dict.fromkeys(parameters))
    law = posterior.law.names
    names = names or tuple(n for n in law if n not in settings.priors or n in posterior.free)
    found = profiles(posterior, names, workers=workers)
    if out is not None:
        folder = made_folder(out)
        about = f"profile likelihood of {posterior.specimen.name}: mounting {settings.mounting}, "
        about += f"noise {settings.noise}"
        about += "".join(f", {name}={value:g}" for name, value in settings.fixed.items())
        write_profiles(found, folder, about)
        save_figure(profile_figure(found), folder / "profile.pdf")
    return found


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
    progress: Tell = _silent,
    stop: Stop = _never,
    **options: Any,
) -> LawComparison:
    """Fit and sample every law on a specimen, and weigh them by what they predict.

    Each protocol is left out in turn, or each quarter of the only one.

    Parameters
    ----------
    specimen : Specimen or path-like
    out : path-like, optional
        Folder for laws.csv, left-out.csv, stacked-draws.csv, stacked-bands.csv and the figures.
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
    stop: Stop = _never,
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


@with_progress
@documented(LedgerPlan, ModelOptions)
def ledger(
    source: RunLike | SpecimenLike,
    *,
    stretches: Sequence[float] = (),
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    anyway: bool = False,
    progress: Tell = _silent,
    **options: Any,
) -> Ledger:
    """What ignoring the mounting stretch costs: inferred, ignored and zeroed, side by side.

    Parameters
    ----------
    source : Run, Specimen or path-like
        A run serves as the inferred posterior, with its own model; a specimen is sampled.
    stretches : sequence of float
        Total equibiaxial stretches of the stresses; five up to the largest tested one where none
        is given.
    out : path-like, optional
        Folder for ledger.csv, ledger.pdf and ledger.png.
    mounting_force : (float, float), optional
        For a tared specimen: the force (or stress) at the mounted state, put back on.
    anyway : bool
        Sample a specimen that cannot be a loading curve, too.
    progress : callable or bool, optional
        Called with each step; True or False shows a line or none, by default on a terminal and
        in a notebook.
    **options
        As in :class:`~biaxbayes.options.LedgerPlan`, and for a specimen
        :class:`~biaxbayes.options.ModelOptions`.
    """
    from biaxbayes.comparison.mounting_bias import Treated, treated_three_ways
    from biaxbayes.comparison.mounting_bias import ledger as lay_out

    chosen, model = LedgerPlan.taken(options)
    if is_run(source):
        refuse_model(model, mounting_force)
        run = usable_run(source)  # type: ignore[arg-type]
        posterior = run.posterior()
        asked, specimen = posterior.options(), run.specimen
        if asked["mounting"] not in INFERRING:
            raise InputError(
                f"this run's mounting stretch is {asked['mounting']}, not inferred",
                file=run.path,
                remedy="give a run with --mounting noisy, exact or free, or the specimen's CSV",
            )
        inferred = Treated(posterior, run.draws, run.state)
    else:
        asked, inferred = ModelOptions.of(model).keywords(), None
        if asked["mounting"] not in INFERRING:
            raise InputError(
                f"--mounting {asked['mounting']} is what the ledger compares with",
                remedy=f"choose {', '.join(INFERRING)}: how the force enters where it is inferred",
            )
        specimen = opened_specimen(source, mounting_force)  # type: ignore[arg-type]
    prepared = Sampling.prepare(
        specimen,
        out=None,
        options=asked,
        anyway=anyway or inferred is not None,
        **vars(chosen),
    )
    for finding in prepared.findings if inferred is None else ():
        progress(Progress("fitting", note=str(finding)))
    treated = treated_three_ways(
        prepared.specimen, prepared.options, prepared.plan, inferred, progress
    )
    found = lay_out(treated, stretches or None)
    if out is not None:
        from biaxbayes.figures.run.mounting import ledger_figure

        folder = made_folder(out)
        write_table(folder, "ledger", found.table, "%.6g")
        draw_figure(folder, "ledger", ledger_figure(found))
    return found


@with_progress
@documented(DesignOptions)
def design(
    run: RunLike,
    *,
    out: PathLike | None = None,
    workers: int | None = 1,
    scheduler: str | None = None,
    progress: Tell = _silent,
    **options: Any,
) -> Design:
    """Which further measurement would narrow the posterior of a run most.

    Parameters
    ----------
    run : Run or path-like
    out : path-like, optional
        Folder for design.csv, design.pdf and design.png.
    workers : int, optional
        Processes; None for the number of processors, at most four.
    scheduler : str, optional
        Address of a Dask scheduler to use instead.
    progress : callable or bool, optional
        Called with each step; True or False shows a line or none, by default on a terminal and
        in a notebook.
    **options
        As in :class:`~biaxbayes.options.DesignOptions`.
    """
    from biaxbayes.optimal_design.candidates import standard_candidates
    from biaxbayes.optimal_design.design import design as rank

    candidates = dict(vars(DesignOptions.of(options)))
    rank_by, seed = candidates.pop("rank_by"), candidates.pop("seed")
    executor = executor_for(workers, scheduler)
    opened = usable_run(run)
    posterior = opened.posterior()
    tried = standard_candidates(posterior, **candidates)
    found = rank(
        posterior,
        opened.draws,
        tried,
        rank_by=rank_by,
        seed=seed,
        executor=executor,
        progress=progress,
    )
    if out is not None:
        from biaxbayes.figures.design import design_figure

        folder = made_folder(out)
        write_table(folder, "design", found.to_frame(), "%.5g")
        draw_figure(folder, "design", design_figure(found))
    return found


# --- verbs that sample many specimens ------------------------------------------------------------


@with_progress
@documented(SamplingPlan, ModelOptions)
def batch(
    study: PathLike | Sequence[PathLike],
    *,
    out: PathLike,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Tell = _silent,
    stop: Stop = _never,
    **options: Any,
) -> StudyResult:
    """Sample every specimen of a study, or what is missing of it.

    In a script of your own the call stands below ``if __name__ == "__main__":``, as for everything
    that starts processes.

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
        For specimen files: seed, ess, max_steps, anyway (as in :func:`biaxbayes.sample`), and
        those of
        :class:`~biaxbayes.options.ModelOptions`.
    """
    from biaxbayes.jobs.batch import Batch
    from biaxbayes.studies.study_file import read_study, study_of_files

    if isinstance(study, str | Path):
        if options:
            raise InputError("options of a study stand in its file", file=study)
        chosen = read_study(Path(study))
    else:
        own = ("seed", "ess", "max_steps", "anyway")
        numbers = {k: options.pop(k) for k in own if k in options}
        model = ModelOptions.of(options).keywords()
        chosen = study_of_files([Path(p) for p in study], model, **numbers)
    executor = executor_for(workers, scheduler, isolated=True)
    return Batch(chosen, Path(out), executor).execute(progress=progress, stop=stop)


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
    anyway: bool = False,
    progress: Tell = _silent,
    stop: Stop = _never,
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
    return job.execute(resume=resume, progress=progress, stop=stop)


@with_progress
@documented(CalibrationPlan, ModelOptions)
def calibrate(
    specimen: SpecimenLike,
    *,
    out: PathLike,
    mounting_force: Sequence[float] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = True,
    progress: Tell = _silent,
    stop: Stop = _never,
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
        :class:`~biaxbayes.options.ModelOptions`.
    """
    from biaxbayes.jobs.calibrate import CalibrationStudy, study_of

    plan, model = CalibrationPlan.taken(options)
    asked = ModelOptions.of(model).keywords()
    executor = executor_for(workers, scheduler)
    study = study_of(opened_specimen(specimen, mounting_force), asked, plan)
    kept = CalibrationStudy(study, Path(out), plan.replications, executor)
    return kept.execute(resume=resume, progress=progress, stop=stop)
