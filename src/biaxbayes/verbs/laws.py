"""``biaxbayes laws``: material laws compared by their predictions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

import biaxbayes
from biaxbayes.comparison.law_tasks import law_tasks, sample_parts
from biaxbayes.comparison.law_weights import LawComparison, weigh_laws
from biaxbayes.errors import InputError
from biaxbayes.laws import LAWS, law_named
from biaxbayes.options import LawsPlan, ModelOptions, takes_options
from biaxbayes.parallel import executor_for
from biaxbayes.progress_bar import Progress, with_progress
from biaxbayes.runs.folder import claim_folder, refuse_other_work
from biaxbayes.runs.provenance import specimen_digest
from biaxbayes.stored_data import json_text
from biaxbayes.text_files import atomic_write_text
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, SpecimenLike, Stop

RECORD, PARTS = "laws.json", "parts"
SINGLE_LAW_OPTIONS = ("law", "fibre_switch", "priors")


def chosen_laws(named: Sequence[str] | str | None) -> tuple[str, ...]:
    """Laws from a sequence or a text with commas; by default all."""
    parts = named.split(",") if isinstance(named, str) else list(named or ())
    names = [name.strip() for name in parts if name.strip()]
    if named is not None and not names:
        remedy = f"laws are {', '.join(LAWS)}; leave it out for all"
        raise InputError("`laws` names no law", remedy=remedy)
    for name in names:
        law_named(name)
    return tuple(name for name in LAWS if not names or name in names)


@with_progress
@takes_options(LawsPlan, ModelOptions, without=SINGLE_LAW_OPTIONS)
def compare_laws(
    specimen: SpecimenLike,
    *,
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    resume: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: OnProgress = inputs.no_progress,
    stop: Stop = inputs.no_stop,
    **options: Any,
) -> LawComparison:
    """Fit and sample every law on a specimen, and weight them by their predictions.

    Each protocol is left out in turn, or each quarter of the only one.

    Parameters
    ----------
    specimen : Specimen or path-like
    out : path-like, optional
        Folder for laws.csv, left-out.csv, the figures and laws.html.
    mounting_force, progress, stop : optional
        As in :func:`biaxbayes.sample`.
    resume : bool
        Continue the comparison in the folder.
    workers, scheduler : optional
        As in :func:`biaxbayes.batch`; the result does not depend on them.
    **options
        As in :class:`~biaxbayes.options.LawsPlan` and :class:`~biaxbayes.options.ModelOptions`,
        without what belongs to one law.
    """
    from biaxbayes.reports.laws import write_law_comparison

    plan, others = LawsPlan.split(options)
    for name in SINGLE_LAW_OPTIONS:
        if others.get(name):
            problem = f"`{name}` cannot be given for several laws"
            raise InputError(problem, remedy="sample one law with it")
    model = ModelOptions.from_values(others).keywords()
    common = {k: v for k, v in model.items() if k not in SINGLE_LAW_OPTIONS}
    laws = chosen_laws(plan.laws)
    specimen = inputs.open_specimen(specimen, mounting_force)
    inputs.refuse_other_tests(specimen, "laws")
    executor = executor_for(workers, scheduler)
    if common["mounting_stretch"] == "per-protocol":
        problem = "a protocol with its own mounted state cannot be predicted from the others"
        raise InputError(problem, remedy="leave out `mounting_stretch=per-protocol`")
    if len(laws) < 2:
        remedy = "name at least two laws, or sample one with `law`"
        raise InputError(f"{', '.join(laws)} alone cannot be compared", remedy=remedy)
    tasks = law_tasks(laws, specimen, common, plan)
    if out is None:
        predictions = sample_parts(tasks, None, executor, progress, stop)
        return weigh_laws(specimen, predictions, laws)
    folder = Path(out)
    identity = {
        "specimen_sha256": specimen_digest(specimen),
        "options": {k: str(v) for k, v in common.items()},
        "laws": list(laws),
        **{name: getattr(plan, name) for name in ("seed", "ess", "max_steps")},
        "biaxbayes": biaxbayes.__version__,
    }
    with claim_folder(folder, RECORD):
        refuse_other_work(folder, RECORD, identity, resume=resume)
        record = {"specimen": specimen.name, "identity": identity}
        atomic_write_text(folder / RECORD, json_text(record))
        predictions = sample_parts(tasks, folder / PARTS, executor, progress, stop)
        progress(Progress("weighing"))
        result = weigh_laws(specimen, predictions, laws)
        write_law_comparison(result, folder)
    return result


# --- the command ---------------------------------------------------------------------------------


@click.command("laws")
@opt.argument("specimen")
@opt.options(LawsPlan, "laws")
@opt.file_option("out", "Folder [<stem>-laws].")
@opt.options(
    ModelOptions, *(n for n in opt.MODEL if n not in (*SINGLE_LAW_OPTIONS, "mounting_stretch"))
)
@opt.mounting_force_option()
@opt.options(LawsPlan, "seed", "ess", "max_steps")
@opt.executor_options
@opt.flag("resume", "Continue the comparison in the folder.")
@opt.quiet_option
def command(specimen: Path, out: Path | None, quiet: bool, **given: Any) -> int:
    r"""Fit and sample every material law on SPECIMEN, and compare their predictions.

    Each protocol is left out in turn, or each quarter of the only one, and predicted from the rest.
    Writes laws.csv, left-out.csv, two figures and laws.html. Exit code 3 when a law has not
    converged on some part of the record.

    \b
    biaxbayes laws media.csv --laws goh,fung
    """
    from biaxbayes.reports.laws import laws_text

    folder = out or Path(f"{specimen.stem}-laws")
    with opt.progress_and_stop(quiet) as work:
        result = compare_laws(specimen, out=folder, **work, **given)
    if not quiet:
        click.echo(laws_text(result, folder))
    for law, reason in result.left_out.items():
        click.echo(f"biaxbayes: {law} is left out: {reason}", err=True)
    return 0 if result.converged else opt.NOT_CONVERGED
