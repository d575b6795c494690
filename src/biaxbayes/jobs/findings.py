"""The verbs for what a posterior determines: verdicts, profiles, the ledger and the design."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.jobs.opening import (
    PathLike,
    RunLike,
    SpecimenLike,
    Tell,
    is_run,
    made_folder,
    opened_run,
    opened_specimen,
    refuse_model,
    silent,
    usable_run,
    write_table,
)
from biaxbayes.jobs.sample import Sampling
from biaxbayes.options import (
    INFERRING,
    DesignOptions,
    InferringOptions,
    LedgerPlan,
    ProfileOptions,
    documented,
)
from biaxbayes.options.model import ALL_ROWS
from biaxbayes.parallel import executor_for
from biaxbayes.progress_bar import with_progress
from biaxbayes.sampling.sampler import Progress

if TYPE_CHECKING:
    from biaxbayes.comparison.mounting_bias import Ledger
    from biaxbayes.identifiability.profile.profile import Profile
    from biaxbayes.jobs.identified import Identified
    from biaxbayes.optimal_design.design import Design

__all__ = ["design", "identify", "ledger", "profile"]


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
    from biaxbayes.figures.run.identifiability import identifiability_figure
    from biaxbayes.figures.style import save_figure
    from biaxbayes.jobs.identified import identified, write_tables

    opened = opened_run(run)
    posterior = opened.posterior()
    result = identified(posterior, opened.draws, opened.state)
    if out is not None:
        folder = made_folder(out)
        write_tables(result, posterior, folder)
        if figure:
            save_figure(identifiability_figure(result.verdicts), folder / "identifiability.pdf")
    return result


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
    from biaxbayes.identifiability.profile.profile import profiles
    from biaxbayes.jobs.identified import write_profiles
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


@with_progress
@documented(LedgerPlan, InferringOptions)
def ledger(
    source: RunLike | SpecimenLike,
    *,
    stretches: Sequence[float] = (),
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    anyway: bool = False,
    progress: Tell = silent,
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
        :class:`~biaxbayes.options.InferringOptions`.
    """
    from biaxbayes.comparison.mounting_bias import Treated, treated_three_ways
    from biaxbayes.comparison.mounting_bias import ledger as lay_out

    chosen, model = LedgerPlan.taken(options)
    if is_run(source):
        refuse_model(model, mounting_force)
        run = usable_run(source)  # type: ignore[arg-type]
        posterior = run.posterior()
        asked, specimen = posterior.options(), run.specimen
        asked["thin"] = asked["thin"] or ALL_ROWS
        if asked["mounting"] not in INFERRING:
            raise InputError(
                f"this run's mounting stretch is {asked['mounting']}, not inferred",
                file=run.path,
                remedy="give a run with --mounting noisy, exact or free, or the specimen's CSV",
            )
        inferred = Treated(posterior, run.draws, run.state)
    else:
        asked, inferred = InferringOptions.of(model).keywords(), None
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
        from biaxbayes.figures.style import save_pictures

        folder = made_folder(out)
        write_table(folder, "ledger", found.table, "%.6g")
        save_pictures(ledger_figure(found), folder, "ledger")
    return found


@with_progress
@documented(DesignOptions)
def design(
    run: RunLike,
    *,
    out: PathLike | None = None,
    workers: int | None = 1,
    scheduler: str | None = None,
    progress: Tell = silent,
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
        from biaxbayes.figures.style import save_pictures

        folder = made_folder(out)
        write_table(folder, "design", found.to_frame(), "%.5g")
        save_pictures(design_figure(found), folder, "design")
    return found
