"""``biaxbayes laws``: material laws side by side, weighed by what they predict."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.cli.options import (
    argument,
    executor_options,
    file_option,
    mounting_force_option,
    options,
    quiet_option,
)
from biaxbayes.cli.progress import graceful_stop, progress_line
from biaxbayes.errors import NotConverged
from biaxbayes.options import LawsPlan, ModelOptions

if TYPE_CHECKING:
    from biaxbayes.comparison.law_weights import LawComparison

__all__ = ["laws"]

NOT_CONVERGED = NotConverged.exit_code


@click.command("laws")
@argument("specimen")
@options(LawsPlan, "laws")
@file_option("out", "Folder [<stem>-laws].")
@options(ModelOptions, "mounting", "mounting_sd", "noise", "noise_growth", "thin")
@mounting_force_option()
@options(LawsPlan, "seed", "ess", "max_steps")
@executor_options
@click.option("--resume", is_flag=True, help="Go on with what the folder holds.")
@quiet_option
def laws(
    specimen: Path,
    out: Path | None,
    mounting_force: tuple[float, float] | None,
    workers: int | None,
    scheduler: str | None,
    resume: bool,
    quiet: bool,
    **how: Any,
) -> int:
    r"""Fit and sample every material law on SPECIMEN, and weigh them by what they predict.

    Each protocol is left out in turn, or each quarter of the only one, and foretold from the rest.
    Writes laws.csv, stated.csv, left-out.csv, stacked-draws.csv, stacked-bands.csv, three figures
    and laws.html. Exit code 3 when a law has not converged on some part of the record.

    \b
    biaxbayes laws media.csv --laws goh,fung
    """
    from biaxbayes import api

    folder = out or Path(f"{specimen.stem}-laws")
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        found = api.compare_laws(
            specimen,
            out=folder,
            mounting_force=mounting_force,
            resume=resume,
            workers=workers,
            scheduler=scheduler,
            progress=tell,
            stop=stop,
            **how,
        )
    if not quiet:
        _tell(found, folder)
    for law, why in found.left_out.items():
        click.echo(f"biaxbayes: {law} is left out: {why}", err=True)
    return 0 if found.converged else NOT_CONVERGED


def _tell(found: LawComparison, folder: Path) -> None:
    """The table, the heaviest law first, and what is stated of the mounting stretches."""
    from biaxbayes.reports.comparison import stated_rows

    stretches = [c for c in found.table if str(c).startswith("mounting_stretch_x")]
    head = f"{'':<18}{'rms':>9}{'left out':>10}{'density':>10}{'weight':>8}{'(range)':>14}"
    click.echo(head + ("   mounting stretch x, 90 %" if stretches else ""))
    click.echo(f"{'':<18}{'kPa':>9}{'kPa':>10}{'nats':>10}")
    table = found.table.sort_values("weight", ascending=False, kind="stable", na_position="last")
    for row in (*table.iloc[1:].to_dict("records"), table.iloc[0].to_dict()):
        if row["left_out_rms"] != row["left_out_rms"]:
            click.echo(f"{row['law']:<18}{row['state']}")
            continue
        rms = f"{row['rms']:.3g}" if row["rms"] == row["rms"] else ""
        spread = ""
        if row["weight_low"] == row["weight_low"]:
            spread = f"({row['weight_low']:.2f}-{row['weight_high']:.2f})"
        line = f"{row['law']:<18}{rms:>9}{row['left_out_rms']:>10.3g}"
        line += f"{row['left_out_density']:>10.1f}{row['weight']:>8.2f}{spread:>14}"
        if stretches:
            low, high = row["mounting_stretch_x_q05"], row["mounting_stretch_x_q95"]
            line += f"   {low:.4f} to {high:.4f}"
        click.echo(line)
    click.echo(
        "\nrms (typical miss) of the fit to all, and of parts left out; density: how well these\n"
        "were foretold, larger is better, 2.3 nats more are ten times as probable; weights by\n"
        "stacking, the shares of the mixture that foretells best. The mixture is a prediction\n"
        "of stresses, no posterior of the mounting stretch."
    )
    for said in stated_rows(found.stated):
        click.echo(f"{said['quantity'].name} of the tissue: {said['words']}; {said['reason']}")
    click.echo(f"\nopen {folder / 'laws.html'}; tables and figures are beside it")
