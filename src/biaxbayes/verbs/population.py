"""``biaxbayes population``: a hierarchical posterior over the specimens of a study."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import click
import pandas as pd

import biaxbayes
from biaxbayes.errors import BiaxbayesError, InputError, Interrupted, printable
from biaxbayes.identifiability.verdict import NOT_IDENTIFIED
from biaxbayes.options import PopulationOptions, takes_options
from biaxbayes.populations.model import (
    Grouping,
    PooledValue,
    PopulationPriors,
    make_layout,
    pooled_values,
)
from biaxbayes.populations.result import Population, draw_sources
from biaxbayes.populations.reweighting import MAX_K
from biaxbayes.populations.sampler import PopulationCheckpoint, PopulationPlan
from biaxbayes.populations.specimens import Source, check_stretches, pooled_names
from biaxbayes.populations.text import contrast_rows, group_rows, spread_parts
from biaxbayes.progress_bar import Progress, with_progress
from biaxbayes.reports.text import plural
from biaxbayes.runs import checkpoint
from biaxbayes.runs.folder import POPULATION, staged
from biaxbayes.runs.provenance import settings_table, specimen_digest
from biaxbayes.runs.run import open_run
from biaxbayes.text_files import aligned
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.batch import batch
from biaxbayes.verbs.inputs import OnProgress, PathLike, Stop
from biaxbayes.verbs.population_files import (
    PopulationResult,
    StudyRun,
    members_of_study,
    write_population,
)


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
    resume : bool
        Continue from the folder's checkpoint where there is one.
    overwrite : bool
        Replace a finished population and everything derived from it.
    anyway : bool
        Use tentative runs, too.
    progress, stop : callable, optional
        As in :func:`biaxbayes.sample`.
    **options
        As in :class:`~biaxbayes.options.PopulationOptions`.
    """
    chosen = PopulationOptions.from_values(options)
    population_priors = (
        PopulationPriors() if priors is None else PopulationPriors.read(Path(priors))
    )
    inputs.refuse_finished(Path(out), POPULATION, resume=resume, overwrite=overwrite)
    source = Path(study)
    if not source.is_dir():
        folder = Path(runs) if runs is not None else Path(f"{source.stem}-study")
        executor: dict[str, Any] = {"workers": chosen.workers, "scheduler": scheduler}
        batch(source, out=folder, progress=progress, stop=stop, **executor)
        source = folder
    elif runs is not None:
        raise InputError("`runs` goes with a study file", file=source)
    name, members = members_of_study(source)
    return sample_population(
        name,
        members,
        Path(out),
        chosen,
        population_priors,
        anyway=anyway,
        resume=resume,
        overwrite=overwrite,
        progress=progress,
        stop=stop,
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
    names = pooled_names(sources)
    values = priors.apply_to(
        pooled_values(sources[0].posterior.law, names, mounting=options.pool_mounting)
    )
    plan = PopulationPlan(
        ess=options.ess, max_steps=options.max_steps, seed=options.seed, workers=options.processors
    )
    identity = _identity(sources, grouping, values, plan, options, priors)
    with inputs.lock_folder(folder, POPULATION, resume=resume, overwrite=overwrite):
        state = None
        if resume:
            state, note = checkpoint.load(folder, identity, PopulationCheckpoint.from_record)
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
            state=state,
            on_step=lambda s: checkpoint.save(folder, s, identity, PopulationCheckpoint.record),
            progress=progress,
            stop=stop,
        )
        if sampled is None:
            raise Interrupted(
                f"interrupted, all saved in {folder}; the same command with `resume=True` "
                "continues",
                stop(),
            )
        few = [s.label for s, k in zip(sources, sampled.pareto_k, strict=True) if k > MAX_K]
        if few:
            notes.append(
                f"few draws of {_names_text(few)} are where the population is (Pareto k above "
                f"{MAX_K:g}): the numbers of these specimens are less certain"
            )
        progress(Progress("writing"))
        fixed = name, tuple(sources), grouping, tuple(values)
        drawn = Population(*fixed, layout, sampled, options.seed, left_out, notes)
        with staged(folder, inputs.removal_note(progress, POPULATION), POPULATION) as staging:
            written = write_population(staging, drawn, identity)
        return replace(written, folder=folder)


def open_sources(members: list[StudyRun], *, anyway: bool) -> tuple[list[Source], dict[str, str]]:
    """The runs that can be pooled, and why the others cannot."""
    usable = ("converged", "tentative") if anyway else ("converged",)
    sources, left_out = [], {}
    for member in members:
        if member.state not in usable:
            words = {"tentative": "tentative, not converged", "unusable": "did not converge"}
            reason = words.get(member.state, member.state)
            left_out[member.label] = f"{reason}: {member.reason}" if member.reason else reason
            continue
        try:
            run = open_run(member.folder)
            if run.state not in usable:
                left_out[member.label] = f"its run is {run.state}"
                continue
            sources.append(Source.from_run(member.label, run))
        except BiaxbayesError as error:
            left_out[member.label] = str(error)
    if len(sources) < 2:
        reasons = "; ".join(f"{k}: {v}" for k, v in list(left_out.items())[:3])
        raise InputError(
            f"{len(sources)} of {len(members)} specimens can be pooled, and a population needs "
            f"two{f' ({reasons})' if reasons else ''}",
            remedy="sample longer with a larger max_steps, or add specimens",
        )
    return sources, left_out


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
        "options": {k: v for k, v in asdict(options).items() if k != "workers"},
        "priors": {
            **{v.name: {k: x for k, x in vars(v).items() if k != "parameter"} for v in values},
            "eta": [priors.eta_donors, priors.eta_specimens],
        },
        "sampler": {"ensembles": plan.ensembles, "chains": plan.chains},
        "runs": runs,
    }


# --- groups, donors and notes on them ------------------------------------------------------------

MAX_STRAIN_RATIO = 1.25
"""Ratio of the largest strains of two specimens from which a note says so."""


def group_sources(members: list[StudyRun], sources: list[Source]) -> tuple[Grouping, list[str]]:
    """Groups and donors of the pooled specimens, and notes that a reader needs first."""
    by_label = {m.label: m for m in members}
    pooled = [by_label[s.label] for s in sources]
    grouping = Grouping(
        tuple(m.label for m in pooled),
        tuple(m.group for m in pooled),
        tuple(m.donor or f"donor of {m.label}" for m in pooled),
    )
    out = []
    if nameless := [m.label for m in pooled if not m.donor]:
        out.append(
            f"no donor is given for {_names_text(nameless)}: each counts as a separate donor"
        )
    donors = len(grouping.donors)
    if donors == 1:
        out.append(
            "all specimens are of one donor, so the differences between donors are unknown: "
            "sd_donors is the prior's and widens mean, new_specimen and new_donor"
        )
    elif donors == len(pooled):
        out.append(
            "every donor gave one specimen, so the spread cannot be split between donors and "
            "specimens: sd_total and new_specimen contain both"
        )
    elif donors < 4:
        out.append(f"there are {donors} donors: sd_donors depends much on its prior")
    if len(pooled) < 4:
        out.append(f"there are {len(pooled)} specimens: the sds depend much on their priors")
    for group in grouping.groups:
        if len(grouping.members(group)) == 1:
            out.append(
                f"group {group} has one specimen: its mean is that specimen's within the spread "
                "that the other groups show"
                if len(grouping.groups) > 1
                else f"group {group} has one specimen"
            )
    by_group = {g: {grouping.donor[i] for i in grouping.members(g)} for g in grouping.groups}
    disjoint = [(a, b) for a, b in combinations(by_group, 2) if not by_group[a] & by_group[b]]
    if disjoint:
        groups = "; ".join(f"{a} and {b}" for a, b in disjoint[:3])
        out.append(
            f"no donor in common: {groups}: their contrasts include differences between donors"
        )
    return grouping, out + _notes_on_runs(sources)


def _notes_on_runs(sources: list[Source]) -> list[str]:
    """Notes on specimens that were tested or sampled differently."""
    out = []
    for key in ("mounting", "noise", "toe", "mounting_stretch"):
        values = {str(getattr(s.posterior.settings, key)) for s in sources}
        if len(values) > 1:
            out.append(f"the runs differ in {key}: {', '.join(sorted(values))}")
    counts = sorted({len(s.run.specimen.protocols) for s in sources})
    if len(counts) > 1:
        fewest = [s.label for s in sources if len(s.run.specimen.protocols) == counts[0]]
        out.append(
            f"specimens were tested with {counts[0]} to {counts[-1]} protocols "
            f"({counts[0]}: {_names_text(fewest)})"
        )
    tops = [s.largest_stretch for s in sources]
    low, high = min(tops), max(tops)
    if high - 1.0 > MAX_STRAIN_RATIO * (low - 1.0):
        fewest = [s.label for s, top in zip(sources, tops, strict=True) if top - low < high - top]
        out.append(
            f"specimens were stretched to {low:.3f} to {high:.3f} from the unloaded state (least: "
            f"{_names_text(fewest)}): stress and stiffness are given up to {low:.3f}, and above it "
            "the band of a new specimen does not rest on all specimens"
        )
    return out


def _names_text(names: list[str]) -> str:
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + more


# --- the command ---------------------------------------------------------------------------------


UNDETERMINED_MARK = "*"


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
        click.echo(closing_message(result))
    elif result.state != "converged":
        click.echo(f"biaxbayes: {result.reason}", err=True)
    return 0 if result.state == "converged" else opt.NOT_CONVERGED


def closing_message(result: PopulationResult) -> str:
    """Groups, differences between them and notes, for a terminal."""
    converged = result.state == "converged"
    state = result.state if converged else f"{result.state.upper()}: {result.reason}"
    lines = [f"{printable(result.name)}: {state}"]
    for group, part in result.groups.groupby("group", sort=False):
        lines += ["", *_group_lines(str(group), part)]
    groups = result.groups
    if any((groups[f"{side}_verdict"] == NOT_IDENTIFIED).any() for side in spread_parts(groups)):
        lines += [
            "",
            f"{UNDETERMINED_MARK} {NOT_IDENTIFIED}: the specimens determine little of this sd",
        ]
    for (a, b), part in result.contrasts.groupby(["group_a", "group_b"], sort=False):
        first, second = printable(str(a)), printable(str(b))
        table = [["quantity", "", "median", "5 to 95 %", f"in {second}"]]
        for row in contrast_rows(part):
            table.append([row.quantity, row.kind, row.median, row.interval, row.direction])
        lines += ["", f"{second} compared with {first}", *aligned(table)]
    lines += ["", *(f"note: {printable(note)}" for note in result.notes)]
    lines += [f"all tables and draws are in {result.folder}"]
    return "\n".join(lines)


def _group_lines(group: str, part: pd.DataFrame) -> list[str]:
    """Table of a group: medians, spreads and new specimens."""
    first = part.iloc[0]
    members = f"{plural(first['specimens'], 'specimen')} of {plural(first['donors'], 'donor')}"
    split = len(spread_parts(part)) > 1
    sds = ["sd donors", "sd specimens"] if split else ["sd total"]
    table = [["quantity", "unit", "median", "5 to 95 %", *sds, "new specimen", "verdict"]]
    for row in group_rows(part):
        spreads = [
            text + (UNDETERMINED_MARK if verdict == NOT_IDENTIFIED else "")
            for (text, _), verdict in zip(row.spreads, row.spread_verdicts, strict=True)
        ]
        cells = [row.quantity, row.unit, row.median, row.reported, *spreads, row.new[0][1]]
        table.append([*cells, row.verdict])
    return [f"{printable(group)}: {members}", *aligned(table)]
