"""``biaxbayes population``: a hierarchical posterior over the specimens of a study."""

from __future__ import annotations

import hashlib
import json
import platform
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click
import pandas as pd

import biaxbayes
from biaxbayes.errors import InputError, Interrupted, printable
from biaxbayes.options import PopulationOptions, takes_options
from biaxbayes.parameters import MATERIAL
from biaxbayes.populations import tables
from biaxbayes.populations.archive import archive
from biaxbayes.populations.grouping import group_sources, open_sources
from biaxbayes.populations.model import (
    Grouping,
    PooledValue,
    PopulationPriors,
    make_layout,
    pooled_values,
)
from biaxbayes.populations.population_result import Population, PopulationResult, draw_sources
from biaxbayes.populations.reweighting import MAX_K
from biaxbayes.populations.sampler import PopulationCheckpoint, PopulationPlan
from biaxbayes.populations.specimens import Source, check_stretches, pooled_names
from biaxbayes.progress_bar import Progress, with_progress
from biaxbayes.reports import population_page as page
from biaxbayes.runs import checkpoint
from biaxbayes.runs.folder import POPULATION, lock_folder, manifest, refuse_finished, staged
from biaxbayes.runs.provenance import settings_table, specimen_digest
from biaxbayes.stored_data import json_text, json_values
from biaxbayes.studies.record import StudyRun, members_of_study
from biaxbayes.text_files import atomic_write_bytes, atomic_write_text, first_few, write_csv
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.batch import batch
from biaxbayes.verbs.inputs import OnProgress, PathLike, Stop


@with_progress
@takes_options(PopulationOptions)
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
    progress: OnProgress = inputs.no_progress,
    stop: Stop = inputs.no_stop,
    **options: Any,
) -> PopulationResult:
    """Sample a hierarchical posterior over the specimens of a study.

    Parameters
    ----------
    study : path-like
        The folder of a finished study, or a study file; missing runs are sampled first.
    out : path-like
        Folder of population.csv, specimens.csv, contrasts.csv and population.nc.
    runs : path-like, optional
        For a study file: the study folder; default ``<stem>-study``, as for ``biaxbayes batch``.
    priors : path-like, optional
        Population priors, a TOML file.
    scheduler : str, optional
        Address of a Dask scheduler, for specimens that have to be sampled first.
    overwrite : bool
        Replace a finished population and everything derived from it.
    anyway : bool
        Use tentative runs, too.
    resume, progress, stop : optional
        As in :func:`biaxbayes.sample`.
    **options
        As in :class:`~biaxbayes.options.PopulationOptions`.
    """
    chosen = PopulationOptions.from_values(options)
    own_priors = None if priors is None else PopulationPriors.read(Path(priors))
    replacing: dict[str, Any] = {"resume": resume, "overwrite": overwrite}
    work: dict[str, Any] = {"progress": progress, "stop": stop}
    refuse_finished(Path(out), POPULATION, **replacing)
    source = Path(study)
    if not source.is_dir():
        folder = Path(runs) if runs is not None else Path(f"{source.stem}-study")
        batch(source, out=folder, workers=chosen.workers, scheduler=scheduler, **work)
        source = folder
    elif runs is not None:
        raise InputError("`runs` can be given only with a study file", file=source)
    name, members = members_of_study(source)
    return sample_population(
        name, members, Path(out), chosen, own_priors, anyway=anyway, **replacing, **work
    )


def sample_population(
    name: str,
    members: list[StudyRun],
    folder: Path,
    options: PopulationOptions | None = None,
    priors: PopulationPriors | None = None,
    *,
    anyway: bool = False,
    resume: bool = False,
    overwrite: bool = False,
    progress: OnProgress = inputs.no_progress,
    stop: Stop = inputs.no_stop,
) -> PopulationResult:
    """Sample the population of these specimens, and write every file into the folder."""
    options, priors = options or PopulationOptions(), priors or PopulationPriors()
    progress(Progress("reading runs"))
    sources, left_out = open_sources(members, anyway=anyway)
    grouping, notes = group_sources(members, sources)
    law, names = sources[0].posterior.law, pooled_names(sources)
    values = priors.apply_to(pooled_values(law, names, mounting=options.pool_mounting))
    plan = PopulationPlan(**options.keywords())
    identity = _identity(sources, grouping, values, plan, options, priors)
    with lock_folder(folder, POPULATION, resume=resume, overwrite=overwrite):
        stored = None
        if resume:
            stored, note = checkpoint.load(folder, identity, PopulationCheckpoint.from_record)
            if note:
                progress(Progress("resuming", note=note))
        for source in sources:
            check_stretches(source, values)
        layout = make_layout(grouping, values, options, priors)
        sampled = draw_sources(
            sources,
            grouping,
            values,
            layout,
            plan,
            state=stored,
            on_step=lambda s: checkpoint.save(folder, s, identity, PopulationCheckpoint.record),
            progress=progress,
            stop=stop,
        )
        if sampled is None:
            raise Interrupted("interrupted", stop(), folder=folder)
        few = [s.label for s, k in zip(sources, sampled.pareto_k, strict=True) if k > MAX_K]
        if few:
            notes.append(
                f"few draws of {first_few(few, 4)} are where the population is (Pareto k above "
                f"{MAX_K:g}): the numbers of these specimens are less certain"
            )
        progress(Progress("writing"))
        fixed = name, tuple(sources), grouping, tuple(values)
        drawn = Population(*fixed, layout, sampled, options.seed, left_out, notes)
        with staged(folder, POPULATION, progress) as staging:
            written = write_population(staging, drawn, identity)
    return replace(written, folder=folder)


NOT_OF_DRAWS = ("workers", "ess", "max_steps")
"""Options with which a population can be continued."""


def _identity(
    sources: list[Source],
    grouping: Grouping,
    values: list[PooledValue],
    plan: PopulationPlan,
    options: PopulationOptions,
    priors: PopulationPriors,
) -> dict[str, Any]:
    """Values that the draws depend on."""
    runs = {}
    for source, group, donor in zip(sources, grouping.group, grouping.donor, strict=True):
        settings = json.dumps(settings_table(source.posterior), sort_keys=True, default=str)
        files = source.run.provenance.get("files", {})
        runs[source.label] = {
            "group": group,
            "donor": donor,
            "specimen": specimen_digest(source.run.specimen)[:16],
            "settings": hashlib.sha256(settings.encode()).hexdigest()[:16],
            "draws": str(files.get("posterior.nc", ""))[:16],
        }
    return {
        "biaxbayes": biaxbayes.__version__,
        "options": {k: v for k, v in asdict(options).items() if k not in NOT_OF_DRAWS},
        "priors": {
            **{v.name: {k: x for k, x in vars(v).items() if k != "parameter"} for v in values},
            "eta": list(priors.correlations.values()),
        },
        "sampler": {"ensembles": plan.ensembles, "chains": plan.chains},
        "runs": runs,
    }


# --- files ---------------------------------------------------------------------------------------


def write_population(
    folder: Path, result: Population, identity: dict[str, Any]
) -> PopulationResult:
    """Write the files of a population, its record last."""
    specimens, contrasts = tables.specimens_table(result), tables.contrasts_table(result)
    notes = tables.contradictions(specimens)
    notes = [*result.notes, *notes, *tables.differences_from_study(result, contrasts)]
    result = replace(result, notes=notes)
    made = {"groups": tables.groups_table(result), "specimens": specimens, "contrasts": contrasts}
    for key, table in made.items():
        write_csv(folder / page.TABLES[key][0], table, digits=8)
    atomic_write_bytes(folder / "population.nc", archive(result))
    if result.state != "unusable":
        draw_figures(folder, result, made)
    convergence, labels = result.sampled.convergence, result.grouping.labels
    record = {
        "biaxbayes": biaxbayes.__version__,
        "python": platform.python_version(),
        "name": result.name,
        "convergence": {
            "state": convergence.state,
            "reason": convergence.reason,
            "worst_ess": convergence.worst_ess if convergence.names else None,
            "worst_rhat": convergence.worst_rhat if convergence.names else None,
            "kept_sweeps": convergence.steps,
        },
        "law": result.law.name,
        "pareto_k": dict(zip(labels, result.sampled.pareto_k.round(3).tolist(), strict=True)),
        "sampled_again": [labels[i] for i in result.sampled.sampled_again],
        "pooled": {
            v.name: {
                "scale": v.scale,
                "mean": v.mean_in_words(),
                "sd_donors": f"half-normal({v.donor_scale:.4g})",
                "sd_specimens": f"half-normal({v.specimen_scale:.4g})",
            }
            for v in result.values
        },
        "left_out": result.left_out,
        "notes": notes,
        "identity": identity,
    }
    atomic_write_text(folder / page.LATEX, page.population_latex(made, record))
    atomic_write_text(folder / page.PAGE, page.population_page(folder, made, record))
    record |= {name: json_values(table) for name, table in made.items()}
    record["files"] = manifest(folder)
    atomic_write_text(folder / POPULATION, json_text(record))
    more: dict[str, Any] = {**made, "notes": notes, "left_out": result.left_out}
    return PopulationResult(result.name, folder, result.state, result.reason, **more)


def draw_figures(folder: Path, result: Population, made: dict[str, pd.DataFrame]) -> None:
    """Draw forest, pairs and stress bands."""
    from biaxbayes.figures.groups import band_figure, forest_figure, pairs_figure
    from biaxbayes.figures.style import save_pictures

    specimen = result.sources[0].run.specimen
    parameters = [v.parameter for v in result.values]
    materials = [p for p in parameters if p.kind == MATERIAL]
    bands, records = tables.bands_table(result), tables.equibiaxial_records(result)
    write_csv(folder / f"{page.BANDS}.csv", bands, digits=8)
    drawn = (
        forest_figure(made["specimens"], made["groups"], parameters),
        pairs_figure(result.new_specimens(), made["specimens"], materials),
        band_figure(bands, records, directions=specimen.directions),
    )
    for stem, figure in zip(page.FIGURE_TEXTS, drawn, strict=True):
        save_pictures(figure, folder, stem)


# --- the command ---------------------------------------------------------------------------------


@click.command("population")
@opt.argument("study", metavar="STUDY.toml|FOLDER")
@opt.file_option("out", "Folder [<stem>-population].", "DIR")
@opt.file_option("runs", "For a study file: the study folder [<stem>-study].", "DIR")
@opt.file_option("priors", "Priors of means, sds and correlations.", "FILE.toml")
@opt.options(PopulationOptions, "pool_mounting", "spread", "correlations")
@opt.options(PopulationOptions, "seed", "ess", "max_steps", "workers")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler for specimens that still have to be sampled, as tcp://host:8786.",
)
@opt.resume_option
@opt.overwrite_option("population")
@opt.flag("anyway", "Use tentative runs, too.")
@opt.quiet_option
def command(study: Path, out: Path | None, quiet: bool, **given: Any) -> int:
    r"""Sample a hierarchical posterior over the specimens of STUDY.

    STUDY is the folder of a finished batch, or a study file; missing runs are sampled first.
    Groups are the layers, or the values of the columns that the study file names.
    Writes population.csv (means and spreads of donors and of specimens with verdicts, new specimens
    and donors), specimens.csv (each specimen before and after pooling), contrasts.csv and
    population.nc. Exit code 0 when the posterior has converged, 3 when the chains did not converge,
    2 when the input cannot be used.

    \b
    biaxbayes population study.toml --out aortas-population
    biaxbayes population study-study --out population --priors population-priors.toml
    """
    folder = out or Path(f"{study.stem}-population")
    with opt.progress_and_stop(quiet) as work:
        result = population(study, out=folder, **work, **given)
    for label, reason in result.left_out.items():
        click.echo(f"biaxbayes: left out: {printable(label)}: {printable(reason)}", err=True)
    if not quiet:
        click.echo(page.closing_message(result))
    elif result.state != "converged":
        click.echo(f"biaxbayes: {result.reason}", err=True)
    return 0 if result.state == "converged" else opt.NOT_CONVERGED
