"""``biaxbayes ledger``: the cost of ignoring the mounting stretch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError
from biaxbayes.options import (
    ALL_ROWS,
    ESS_HELP,
    INFERRING_MODES,
    MAX_COUNT,
    InferringOptions,
    SamplingPlan,
    option,
    takes_options,
)
from biaxbayes.progress_bar import Progress, progress_line, with_progress
from biaxbayes.text_files import aligned, write_csv
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, RunLike, SpecimenLike

if TYPE_CHECKING:
    from biaxbayes.comparison.mounting_bias import Ledger


@dataclass(frozen=True)
class LedgerPlan(SamplingPlan):
    """Options of ``sample`` with fewer draws, which are enough for medians."""

    ess: float = option(1000.0, ESS_HELP, minimum=50, maximum=MAX_COUNT)


@with_progress
@takes_options(LedgerPlan, InferringOptions)
def ledger(
    source: RunLike | SpecimenLike,
    *,
    stretches: Sequence[float] = (),
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    anyway: bool = False,
    progress: OnProgress = inputs.no_progress,
    **options: Any,
) -> Ledger:
    """Compare inferred, ignored and zeroed mounting stretches: the cost of ignoring them.

    Parameters
    ----------
    source : Run, Specimen or path-like
        A run serves as the inferred posterior, with its own model; a specimen is sampled.
    stretches : sequence of float
        Total equibiaxial stretches of the stresses; by default five up to the largest tested one.
    out : path-like, optional
        Folder for ledger.csv, ledger.pdf and ledger.png.
    mounting_force, anyway, progress : optional
        As in :func:`biaxbayes.sample`, for a specimen.
    **options
        As in :class:`LedgerPlan`, and for a specimen
        :class:`~biaxbayes.options.InferringOptions`.
    """
    from biaxbayes.comparison.mounting_bias import MountingModelDraws, sample_mounting_models
    from biaxbayes.comparison.mounting_bias import ledger as make_ledger
    from biaxbayes.verbs.sample import SampleJob

    plan, model = LedgerPlan.split(options)
    if inputs.is_run(source):
        inputs.refuse_model(model, mounting_force)
        run = inputs.usable_run(source)  # type: ignore[arg-type]
        posterior, specimen = run.posterior(), run.specimen
        model = posterior.options()
        model["thin"] = model["thin"] or ALL_ROWS
        if model["mounting"] not in INFERRING_MODES:
            raise InputError(
                f"this run's mounting stretch is {model['mounting']}, not inferred",
                file=run.path,
                remedy="give a run whose mounting is noisy, exact or free, or the specimen's CSV",
            )
        inferred = MountingModelDraws(posterior, run.draws, run.state)
    else:
        model, inferred = InferringOptions.from_values(model).keywords(), None
        specimen = inputs.open_specimen(source, mounting_force)  # type: ignore[arg-type]
    if not any(piece.experiment.is_mounted for piece in specimen.pieces):
        raise InputError(
            "stretches of a tube are total: it has no mounting stretch that could be ignored",
            file=specimen.name,
            remedy="give a square or a strip",
        )
    prepared = SampleJob.prepare(
        specimen, out=None, options=model, amount=plan, anyway=anyway or inferred is not None
    )
    for finding in prepared.findings if inferred is None else ():
        progress(Progress("fitting", note=str(finding)))
    models = sample_mounting_models(
        prepared.specimen, prepared.options, prepared.plan, inferred, progress
    )
    result = make_ledger(models, stretches or None)
    if out is not None:
        from biaxbayes.figures.comparisons import ledger_figure
        from biaxbayes.figures.style import save_pictures

        folder = inputs.make_folder(out)
        write_csv(folder / "ledger.csv", result.table, digits=6)
        save_pictures(ledger_figure(result), folder, "ledger")
    return result


@click.command("ledger")
@opt.argument("source", metavar="SPECIMEN|RUN")
@click.option(
    "--stretch",
    "stretches",
    type=float,
    multiple=True,
    help="Total equibiaxial stretch of the stresses. Repeatable  [five up to the largest tested]",
)
@opt.file_option("out", "Folder [<stem>-ledger].")
@opt.options(LedgerPlan, "seed")
@opt.model_options(InferringOptions)
@opt.options(LedgerPlan, "ess", "workers")
@opt.anyway_option
@opt.quiet_option
def command(source: Path, out: Path | None, quiet: bool, **given: Any) -> int:
    """Sample a specimen with its mounting stretch inferred, ignored and zeroed, side by side.

    Writes ledger.csv, ledger.pdf and ledger.png. A RUN folder serves as the inferred posterior,
    with its own model options; a specimen CSV is sampled. Exit code 3 when one of the three is
    not converged.
    """
    data = opt.open_usable_run(source, anyway=False) if source.is_dir() else source
    folder = out or Path(f"{source.name if source.is_dir() else source.stem}-ledger")
    given = opt.model_of(source, **given)
    with progress_line(quiet=quiet) as progress:
        result = ledger(data, out=folder, progress=progress, **given)
    if not quiet:
        _print_ledger(result, folder)
    doubtful = [name for name, state in result.states.items() if state != "converged"]
    if doubtful:
        click.echo(f"biaxbayes: not converged: {', '.join(doubtful)}; sample more", err=True)
    return opt.NOT_CONVERGED if doubtful else 0


def _print_ledger(result: Ledger, folder: Path) -> None:
    from biaxbayes.prediction.stress import INSIDE

    click.echo(f"{result.specimen}: median (5 %, 95 %); shift in sd of the inferred posterior\n")
    lines = [["", "inferred", "ignored", "shift", "zeroed", "shift"]]
    for _, row in result.table.iterrows():
        name = str(row["quantity"])
        if row["total_stretch"] == row["total_stretch"]:
            mark = "" if row["extrapolation"] == INSIDE else "*"
            name = f"{name} at {row['total_stretch']:.4g}{mark}"
        unit = f" ({row['unit']})" if row["unit"] else ""
        cells = [name + unit, cell(row, "inferred")]
        for mounting_model in ("ignored", "zeroed"):
            cells += [cell(row, mounting_model), f"{row[f'shift_{mounting_model}_sd']:+.1f}"]
        lines.append(cells)
    click.echo("\n".join(aligned(lines, right=range(1, 6))))
    outside = result.stresses["extrapolation"] != INSIDE
    if outside.any():
        click.echo("\n* outside the tested range, or below the mounted state")
    click.echo(f"\n{folder / 'ledger.csv'}, {folder / 'ledger.pdf'}")


def cell(row: Any, name: str) -> str:
    """Median and interval of a mounting model, with the digits that distinguish its ends."""
    from biaxbayes.figures.quantities import number

    low, median, high = (row[f"{name}_{q}"] for q in ("q05", "median", "q95"))
    if low == high:
        return f"{median:.4g} (assumed)"
    shown = [number(v, low, high) for v in (median, low, high)]
    return f"{shown[0]} ({shown[1]}, {shown[2]})"
