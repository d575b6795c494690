"""``biaxbayes identify``: which parameters the data determine."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from biaxbayes.output.identifiability_products import Identified

__all__ = ["command"]

NOT_RELIABLE = 3
SHOWN = ("Hx", "Hy", "Hz", "small-strain stiffness xx", "small-strain stiffness yy")


@click.command("identify")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Verdicts and evidence as JSON.")
@click.option("--no-figure", is_flag=True, help="Leave the figure out.")
def command(run: Path, as_json: bool, no_figure: bool) -> int:
    """Say which parameters of RUN the data determine, alone or only in combination.

    Writes identifiability.csv and .pdf, determined.csv and same-curves.csv into the run folder.
    Exit code 3 where the chains are not reliable: there is no verdict then.
    """
    from biaxbayes.output.identifiability_products import write_identifiability_products
    from biaxbayes.output.run import open_run

    opened = open_run(run)
    found = write_identifiability_products(
        run, opened.posterior(), opened.draws, opened.state, figure=not no_figure
    )
    if as_json:
        from biaxbayes.output.identifiability_file import as_json as told

        click.echo(told(found.verdicts, found.determined, found.directions))
    else:
        _tell(found, run)
    return 0 if opened.state == "reliable" else NOT_RELIABLE


def _tell(found: Identified, run: Path) -> None:
    for line in found.verdicts.in_words():
        click.echo(line)
    if found.determined is not None:
        click.echo("\nwhat the curves themselves say:")
        directions = found.directions.in_words() if found.directions else []
        for line in [*_determined_words(found), *directions]:
            click.echo(f"  {line}")
    click.echo(f"\nevidence in {run / 'identifiability.csv'}")


def _determined_words(found: Identified) -> list[str]:
    """A few quantities, and the stress at the end of the first test."""
    from biaxbayes.findings.determined import FARTHEST

    assert found.determined is not None
    table = found.determined
    stress = table[table["quantity"].isin(("Cauchy stress x", "Cauchy stress y"))]
    shown = [*table[table["quantity"].isin(SHOWN)].itertuples(), *list(stress.itertuples())[2:4]]
    lines = []
    for row in shown:
        where = f" at {row.stretch_x:g}, {row.stretch_y:g}" if "stress" in str(row.quantity) else ""
        numbers = f"{row.median:.3g} ({row.low_90:.3g} to {row.high_90:.3g})"
        line = f"{row.quantity}{where} {numbers} {row.unit}".rstrip()
        ends = [float(str(v)) for v in (row.tissue_low_90, row.tissue_high_90)]
        if not math.isnan(ends[0]):  # the interval to state: with the error of the model
            line += f"; of the tissue {ends[0]:.3g} to {ends[1]:.3g}"
        elif str(row.quantity).startswith("Cauchy stress"):
            line += f"; of the tissue not stated, the mounting stretch may be {FARTHEST:g} or more"
        lines.append(line)
    return lines
