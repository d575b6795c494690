"""``biaxbayes laws``: material laws compared by their predictions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import pandas as pd

import biaxbayes
from biaxbayes.comparison.law_tasks import law_tasks, sample_parts
from biaxbayes.comparison.law_weights import LawComparison, weigh_laws
from biaxbayes.errors import InputError, RunError
from biaxbayes.laws import LAWS, law_named
from biaxbayes.options import (
    LawsPlan,
    ModelOptions,
    takes_options,
)
from biaxbayes.parallel import executor_for
from biaxbayes.parameters import STRETCH, Quantities
from biaxbayes.progress_bar import Progress, with_progress
from biaxbayes.runs.folder import claim_folder, record_text, stored_identity
from biaxbayes.runs.provenance import specimen_digest
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import (
    aligned,
    atomic_write_text,
    write_csv,
)
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
        raise InputError(
            "`laws` names no law", remedy=f"laws are {', '.join(LAWS)}; leave it out for all"
        )
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
        Folder for laws.csv, left-out.csv, stacked-draws.csv, stacked-bands.csv, the figures and
        laws.html.
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
    plan, others = LawsPlan.split(options)
    for name in SINGLE_LAW_OPTIONS:
        if others.get(name):
            raise InputError(f"`{name}` belongs to one law", remedy="use sample for that")
    model = ModelOptions.from_values(others).keywords()
    common = {k: v for k, v in model.items() if k not in SINGLE_LAW_OPTIONS}
    laws = chosen_laws(plan.laws)
    specimen = inputs.open_specimen(specimen, mounting_force)
    inputs.refuse_other_tests(specimen, "laws")
    executor = executor_for(workers, scheduler)
    if common["mounting_stretch"] == "per-protocol":
        raise InputError(
            "a protocol with its own mounted state cannot be predicted from the others",
            remedy="leave out `mounting_stretch=per-protocol`",
        )
    if len(laws) < 2:
        raise InputError(
            f"{', '.join(laws)} alone cannot be compared",
            remedy="name at least two laws, or sample one with `law`",
        )
    tasks = law_tasks(laws, specimen, common, plan)
    if out is None:
        predictions = sample_parts(tasks, None, executor, progress, stop)
        return weigh_laws(specimen, predictions, laws)
    folder = Path(out)
    with claim_folder(folder, {RECORD}, "a comparison of laws"):
        _record(folder, specimen, common, laws, plan, resume=resume)
        predictions = sample_parts(tasks, folder / PARTS, executor, progress, stop)
        progress(Progress("weighing"))
        result = weigh_laws(specimen, predictions, laws)
        _write(result, specimen, folder)
    return result


def _record(
    folder: Path,
    specimen: Specimen,
    options: dict[str, Any],
    laws: Sequence[str],
    plan: LawsPlan,
    *,
    resume: bool,
) -> None:
    """Record what the folder compares; refuse one that holds another comparison."""
    identity = {
        "specimen_sha256": specimen_digest(specimen),
        "options": {k: str(v) for k, v in options.items()},
        "laws": list(laws),
        "seed": plan.seed,
        "ess": plan.ess,
        "max_steps": plan.max_steps,
        "biaxbayes": biaxbayes.__version__,
    }
    record = folder / RECORD
    if record.exists() and not resume:
        raise InputError(
            "already holds a comparison of laws",
            file=folder,
            remedy="choose another `out`, or continue it with `resume=True`",
        )
    if record.exists() and stored_identity(record) != identity:
        raise RunError(
            f"{folder}: holds another comparison (specimen, options, laws, seed or version "
            "differ); choose another `out`"
        )
    atomic_write_text(record, record_text({"specimen": specimen.name, "identity": identity}))


def _write(compared: LawComparison, specimen: Specimen, folder: Path) -> None:
    """Tables, draws and bands of the mixture, figures and the page."""
    from biaxbayes.figures.comparisons import (
        law_bands_figure,
        law_misfit_figure,
        law_mounting_figure,
    )
    from biaxbayes.figures.style import save_pictures
    from biaxbayes.reports.comparison import laws_page

    tables = {
        "laws.csv": compared.table,
        "left-out.csv": compared.parts,
        "stacked-draws.csv": compared.draws,
        "stacked-bands.csv": compared.bands,
    }
    for name, table in tables.items():
        write_csv(folder / name, table, digits=8)
    drawn = {
        "law-misfit": law_misfit_figure(compared),
        "law-mounting": law_mounting_figure(compared),
        "stacked-bands": law_bands_figure(compared, specimen),
    }
    figures = {stem: figure for stem, figure in drawn.items() if figure is not None}
    for stem, figure in figures.items():
        save_pictures(figure, folder, stem)
    atomic_write_text(folder / "laws.html", laws_page(compared, figures))


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
    Writes laws.csv, left-out.csv, stacked-draws.csv, stacked-bands.csv, three figures and
    laws.html. Exit code 3 when a law has not converged on some part of the record.

    \b
    biaxbayes laws media.csv --laws goh,fung
    """
    folder = out or Path(f"{specimen.stem}-laws")
    with opt.progress_and_stop(quiet) as work:
        result = compare_laws(specimen, out=folder, **work, **given)
    if not quiet:
        _print_laws(result, folder)
    for law, reason in result.left_out.items():
        click.echo(f"biaxbayes: {law} is left out: {reason}", err=True)
    return 0 if result.converged else opt.NOT_CONVERGED


def _print_laws(result: LawComparison, folder: Path) -> None:
    """Print the table, largest weight first, with the mounting stretches."""
    from biaxbayes.reports.comparison import stretch_texts

    stretches = [q for q in Quantities(()).of_kind(STRETCH) if f"{q.name}_q50" in result.table]
    lines = [
        ["", "rms_kPa", "left out", "density", "weight", "(range)", *(q.name for q in stretches)],
        ["", "kPa", "kPa", "nats", "", "", *(["median, 90 %"] * len(stretches))],
    ]
    table = result.table.sort_values("weight", ascending=False, kind="stable", na_position="last")
    for row in (*table.iloc[1:].to_dict("records"), table.iloc[0].to_dict()):
        if pd.isna(row["left_out_rms_kPa"]):
            lines.append([row["law"], *[""] * 5, row["state"]])
            continue
        rms = "" if pd.isna(row["rms_kPa"]) else f"{row['rms_kPa']:.3g}"
        low, high = row["weight_low"], row["weight_high"]
        spread = "" if pd.isna(low) else f"({low:.2f}-{high:.2f})"
        left_out = f"{row['left_out_rms_kPa']:.3g}", f"{row['left_out_density_nats']:.1f}"
        lines.append([row["law"], rms, *left_out, f"{row['weight']:.2f}", spread])
        lines[-1] += [f"{m}, {low} to {high}" for m, low, high in stretch_texts(row)]
    click.echo("\n".join(aligned(lines, right=range(1, 6))))
    click.echo(
        "\nrms: error of the fit to all rows; left out: error of predicting the parts left out;\n"
        "density: log predictive density of these, larger is better (2.3 nats more: ten times as\n"
        "probable); weights: shares of the mixture that predicts best (stacking). The mixture\n"
        "predicts stresses; below the tested stretches, and so for the mounting stretch, its\n"
        "weights are untested."
    )
    click.echo(f"\nopen {folder / 'laws.html'}; tables and figures are beside it")
