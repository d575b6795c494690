"""``biaxbayes identify``: which parameters the data determine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from biaxbayes.errors import printable
from biaxbayes.verbs.inputs import PathLike, RunLike, make_folder, opened_run
from biaxbayes.verbs.options import NOT_CONVERGED, argument, flag, json_option

if TYPE_CHECKING:
    from biaxbayes.verbs.identified import Identified


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
    from biaxbayes.verbs.identified import identified, write_tables

    opened = opened_run(run)
    posterior = opened.posterior()
    result = identified(posterior, opened.draws, opened.state)
    if out is not None:
        folder = make_folder(out)
        write_tables(result, posterior, folder)
        if figure:
            save_figure(identifiability_figure(result.verdicts), folder / "identifiability.pdf")
    return result


@click.command("identify")
@argument("run")
@json_option("Verdicts and evidence as JSON.")
@flag("no-figure", "Leave the figure out.")
def command(run: Path, as_json: bool, no_figure: bool) -> int:
    """Say which parameters of RUN the data determine, alone or only in combination.

    Writes identifiability.csv and .pdf, determined.csv and same-curves.csv into the run folder.
    Exit code 3 where the chains have not converged: there is no verdict then.
    """
    from biaxbayes.verbs.identified import as_json as identified_as_json
    from biaxbayes.verbs.identified import terminal_lines

    result = identify(run, out=run, figure=not no_figure)
    if as_json:
        click.echo(identified_as_json(result))
    else:
        for line in terminal_lines(result):
            click.echo(printable(line))
        click.echo(f"\nevidence in {run / 'identifiability.csv'}")
    return 0 if result.state == "converged" else NOT_CONVERGED
