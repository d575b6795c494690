"""``biaxbayes identify``: interval or bound, verdict and reason of each parameter."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from biaxbayes.errors import printable
from biaxbayes.options import for_users
from biaxbayes.verbs.inputs import PathLike, RunLike, as_run, make_folder
from biaxbayes.verbs.options import NOT_CONVERGED, argument, flag, json_option

if TYPE_CHECKING:
    from biaxbayes.runs.run_result import RunResult


@for_users
def identify(run: RunLike, *, out: PathLike | None = None, figure: bool = True) -> RunResult:
    """Compute the result of a run again: what to report of each parameter, with the evidence.

    Parameters
    ----------
    run : Run or path-like
    out : path-like, optional
        Folder, such as the run's, for results.json, report.csv, the tables of evidence and
        identifiability.pdf.
    figure : bool
        Whether to draw the figure there.
    """
    from biaxbayes.figures.identifiability import identifiability_figure
    from biaxbayes.figures.style import save_pictures
    from biaxbayes.runs.folder import updated
    from biaxbayes.runs.run_result import write_result

    opened = as_run(run)
    result, verdicts = opened.analyse()
    if out is not None:
        folder = make_folder(out)
        own = folder.resolve() == opened.path.resolve()
        with updated(opened.path, opened.provenance) if own else nullcontext(folder) as target:
            write_result(result, target)
            if figure:
                drawn = identifiability_figure(verdicts, result.reported)
                save_pictures(drawn, target, "identifiability")
    return result


@click.command("identify")
@argument("run")
@json_option("The content of results.json.")
@flag("no-figure", "Leave the figure out.")
def command(run: Path, as_json: bool, no_figure: bool) -> int:
    """List what to report of each parameter of RUN: an interval or a bound, a verdict, a reason.

    Writes results.json, report.csv, the tables in evidence and identifiability.pdf into the run
    folder. Exit code 3 if the chains have not converged: nothing is reported then.
    """
    from biaxbayes.reports.methods import result_lines
    from biaxbayes.reports.text import capital
    from biaxbayes.runs.run_result import as_record

    result = identify(run, out=run, figure=not no_figure)
    if as_json:
        click.echo(json.dumps(as_record(result), indent=2, allow_nan=False, ensure_ascii=False))
    else:
        lines, more = result_lines(result), list(result.warnings[1:])
        if result.directions:
            more += [result.directions[0]["in_words"], result.same_curves_in_words]
        lines += [capital(printable(text)) for text in more if text]
        click.echo("\n".join(lines).lstrip("\n"))
        click.echo(f"\nevidence in {run / 'evidence'}")
    return 0 if result.state == "converged" else NOT_CONVERGED
