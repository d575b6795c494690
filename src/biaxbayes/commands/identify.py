"""``biaxbayes identify``: which parameters the data determine."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["command"]


@click.command("identify")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Verdicts and evidence as JSON.")
@click.option("--no-figure", is_flag=True, help="Leave the figure out.")
def command(run: Path, as_json: bool, no_figure: bool) -> int:
    """Say which parameters of RUN the data determine, alone or only in combination.

    Writes identifiability.csv and identifiability.pdf into the run folder. Exit code 3 where the
    chains are not reliable: there is no verdict then.
    """
    from biaxbayes.findings.identifiability import identify
    from biaxbayes.output.identifiability_file import write_identifiability
    from biaxbayes.output.run import open_run

    opened = open_run(run)
    found = identify(opened)
    write_identifiability(found, run / "identifiability.csv")
    if not no_figure:
        from biaxbayes.output.figures.identifiability import identifiability_figure
        from biaxbayes.output.style import save_figure

        save_figure(identifiability_figure(found), run / "identifiability.pdf")
    if as_json:
        from biaxbayes.output.identifiability_file import as_json as told

        click.echo(told(found))
    else:
        for line in found.in_words():
            click.echo(line)
    return 0 if found.state == "reliable" else 3
