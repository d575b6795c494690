"""``biaxbayes ledger``: what ignoring the mounting stretch costs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.commands.model_options import (
    model_options,
    read_model_options,
    specimen_with_mounting_force,
)
from biaxbayes.commands.progress_line import progress_line
from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from biaxbayes.findings.ledger import Ledger, Treated
    from biaxbayes.inference.sampler import Plan

__all__ = ["command"]

INFERRED = ("noisy", "exact", "free")


@click.command("ledger")
@click.argument("source", metavar="SPECIMEN|RUN", type=click.Path(path_type=Path))
@click.option(
    "--stretch",
    "stretches",
    type=float,
    multiple=True,
    help="Total equibiaxial stretch of the stresses. Repeatable  [five up to the largest tested]",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder [<stem>-ledger].")
@click.option("--seed", type=int, default=1, show_default=True, help="Same seed, same bytes.")
@model_options
@click.option("--ess", type=float, default=1000, show_default=True, help="Effective draws wanted.")
@click.option("--workers", type=int, default=None, help="Threads [processors, at most 4].")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.pass_context
def command(
    ctx: click.Context,
    source: Path,
    stretches: tuple[float, ...],
    out: Path | None,
    seed: int,
    mounting_force: tuple[float, float] | None,
    ess: float,
    workers: int | None,
    quiet: bool,
    **model: Any,
) -> int:
    """Sample a specimen with its mounting stretch inferred, ignored and zeroed, side by side.

    Writes ledger.csv, ledger.pdf and ledger.png. A RUN folder serves as the inferred posterior,
    with its own model options; a specimen CSV is sampled. Exit code 3 when one of the three is
    not reliable.
    """
    from biaxbayes.findings.ledger import classical, ledger, treat

    folder = out or Path(f"{source.name if source.is_dir() else source.stem}-ledger")
    with progress_line(quiet=quiet) as tell:
        if source.is_dir():
            _no_model_options(ctx)
            inferred, options, plan = _from_run(source, seed, ess, workers)
        else:
            prepared = _prepared(source, mounting_force, model, seed, ess, workers)
            options, plan = prepared.options, prepared.plan
            inferred = treat(prepared.specimen, options, plan, tell)
        treated = {"inferred": inferred}
        for name in ("ignored", "zeroed"):
            specimen = inferred.posterior.specimen
            treated[name] = treat(specimen, classical(options, name), plan, tell)
    found = ledger(treated, stretches or None)
    _write(found, folder)
    if not quiet:
        _tell(found, folder)
    unreliable = [name for name, state in found.states.items() if state != "reliable"]
    if unreliable:
        click.echo(f"biaxbayes: not reliable: {', '.join(unreliable)}; ask for more", err=True)
    return 3 if unreliable else 0


def _no_model_options(ctx: click.Context) -> None:
    given = ("mounting_force", "mounting", "noise", "mounting_stretch", "noise_growth")
    for name in (*given, "fibre_switch", "fix", "priors"):
        if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(
                f"--{name.replace('_', '-')} does not go with a run, which has its own",
                remedy="give the specimen's CSV instead",
            )


def _prepared(
    source: Path,
    force: tuple[float, float] | None,
    model: dict[str, Any],
    seed: int,
    ess: float,
    workers: int | None,
) -> Any:
    """The specimen, the options it allows and the plan."""
    from biaxbayes.output.sampling import Sampling

    options = read_model_options(**model)
    if options["mounting"] not in INFERRED:
        raise InputError(
            f"--mounting {options['mounting']} is what the ledger compares with",
            remedy=f"choose {', '.join(INFERRED)}: how the force enters where it is inferred",
        )
    read = specimen_with_mounting_force(source, force)
    prepared = Sampling.prepare(
        read, out=None, options=options, seed=seed, ess=ess, max_steps=20_000, workers=workers
    )
    return prepared


def _from_run(
    source: Path, seed: int, ess: float, workers: int | None
) -> tuple[Treated, dict[str, Any], Plan]:
    from biaxbayes.commands.run_state import open_usable_run
    from biaxbayes.findings.ledger import Treated
    from biaxbayes.output.sampling import Sampling

    run = open_usable_run(source, anyway=False)
    posterior = run.posterior()
    options = posterior.options()
    if options["mounting"] not in INFERRED:
        raise InputError(
            f"this run's mounting stretch is {options['mounting']}, not inferred",
            file=source,
            remedy="give a run with --mounting noisy, exact or free, or the specimen's CSV",
        )
    plan = Sampling.prepare(
        run.specimen,
        out=None,
        options=dict(options),
        seed=seed,
        ess=ess,
        max_steps=20_000,
        workers=workers,
    ).plan
    return Treated(posterior, run.draws, run.state), options, plan


def _write(found: Ledger, folder: Path) -> None:
    from biaxbayes.output.figures.ledger import ledger_figure
    from biaxbayes.output.style import save_figure
    from biaxbayes.specimens.text_file import atomic_write_text

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=folder) from None
    text = found.table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    atomic_write_text(folder / "ledger.csv", text)
    figure = ledger_figure(found)
    for suffix in ("pdf", "png"):
        save_figure(figure, folder / f"ledger.{suffix}")


def _tell(found: Ledger, folder: Path) -> None:
    from biaxbayes.findings.covered_stretches import INSIDE

    click.echo(f"{found.specimen}: median (5 %, 95 %); shift in sd of the inferred posterior\n")
    click.echo(f"{'':<27}{'inferred':>24}{'ignored':>24}{'shift':>8}{'zeroed':>24}{'shift':>8}")
    for _, row in found.table.iterrows():
        name = str(row["quantity"])
        if row["total_stretch"] == row["total_stretch"]:
            mark = "" if row["extrapolation"] == INSIDE else "*"
            name = f"{name} at {row['total_stretch']:.4g}{mark}"
        cells = [_cell(row, t) for t in ("inferred", "ignored", "zeroed")]
        shifts = [f"{row[f'shift_{t}_sd']:+.1f}" for t in ("ignored", "zeroed")]
        unit = f" ({row['unit']})" if row["unit"] else ""
        click.echo(
            f"{name + unit:<27}{cells[0]:>24}{cells[1]:>24}{shifts[0]:>8}{cells[2]:>24}"
            f"{shifts[1]:>8}"
        )
    outside = found.stresses["extrapolation"] != INSIDE
    if outside.any():
        click.echo("\n* outside of what the test covered, or below the mounted state")
    click.echo(f"\n{folder / 'ledger.csv'}, {folder / 'ledger.pdf'}")


def _cell(row: Any, name: str) -> str:
    low, median, high = (row[f"{name}_{q}"] for q in ("q05", "median", "q95"))
    if low == high:
        return f"{median:.4g} (taken)"
    return f"{median:.4g} ({low:.3g}, {high:.3g})"
