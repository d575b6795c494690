"""``biaxbayes report``: the page of a run again, or its table for a paper."""

from __future__ import annotations

from pathlib import Path

import click

from biaxbayes.errors import InputError
from biaxbayes.options import REPORTS, for_users
from biaxbayes.text_files import as_path, atomic_write_text
from biaxbayes.verbs.inputs import PathLike, RunLike, as_run
from biaxbayes.verbs.options import NOT_CONVERGED, argument, choice_option, file_option


@for_users
def report(run: RunLike, kind: str = "html", *, out: PathLike | None = None) -> Path:
    """Write the report of a run again, and return its path.

    Parameters
    ----------
    run : Run or path-like
    kind : {"html", "latex", "explore"}
        ``explore`` in the run itself adds a link to the report.
    out : path-like, optional
        Default report.html, report.tex or explore.html in the run.
    """
    from biaxbayes.reports.page import write_report

    opened = as_run(run)
    if kind == "html" and out is None:
        return write_report(opened.path, opened)
    linked = kind == "explore" and out is None
    text = report_text(opened, kind, linked=linked)
    path = opened.path / REPORTS[kind] if out is None else as_path(out, "out")
    if path.is_dir():
        raise InputError("is a folder", file=path, remedy="give a file name with `out`")
    atomic_write_text(path, text)
    if linked:
        write_report(opened.path, opened)
    return path


def report_text(run: RunLike, kind: str = "html", *, linked: bool = False) -> str:
    """The report of a run; a page to explore is ``linked`` to the report in the same folder."""
    from biaxbayes.reports.explore import explore_page
    from biaxbayes.reports.methods import latex_table
    from biaxbayes.reports.page import report_page

    opened = as_run(run)
    match kind:
        case "html":
            return report_page(opened)
        case "latex":
            return latex_table(opened)
        case "explore":
            report = REPORTS["html"] if linked else ""
            return explore_page(opened.posterior(), opened.draws, opened.state, report=report)
    raise InputError(f"unknown report {kind[:40]!r}", remedy=f"one of {', '.join(REPORTS)}")


@click.command("report")
@argument("run")
@choice_option(
    "format", REPORTS, "A page, the table as LaTeX, or the page to explore.", name="kind"
)
@file_option(
    "out",
    "The file to write; - prints  [default: report.html, report.tex or explore.html in RUN]",
    "FILE",
)
def command(run: Path, kind: str, out: Path | None) -> int:
    r"""Report RUN: one self-contained HTML page, tables for a paper, or a page to explore.

    The page to explore holds draws to brush in any pair of parameters, with their curves, and
    sliders for other priors; it needs no network.

    \b
    biaxbayes report media-run
    biaxbayes report media-run --format explore
    biaxbayes report media-run --format latex --out table2.tex

    Exit code 3 if the chains did not converge, as the report says, too.
    """
    opened = as_run(run)
    if out is not None and str(out) == "-":
        click.echo(report_text(opened, kind), nl=False)
    else:
        click.echo(str(report(opened, kind, out=out)))
    return 0 if opened.state == "converged" else NOT_CONVERGED
