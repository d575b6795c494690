"""``biaxbayes report``: the page of a run again, or its table for a paper."""

from __future__ import annotations

from pathlib import Path

import click

from biaxbayes.errors import InputError
from biaxbayes.options import REPORTS, for_users
from biaxbayes.text_files import as_path, atomic_write_text, refuse_foreign
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import PathLike, RunLike, as_run


@for_users
def report(run: RunLike, kind: str = "html", *, out: PathLike | None = None) -> Path:
    """Write the report of a run again, and return its path.

    Parameters
    ----------
    run : Run or path-like
    kind : {"html", "latex"}
    out : path-like, optional
        Default report.html or report.tex in the run.
    """
    opened = as_run(run)
    text = report_text(opened, kind)
    path = opened.path / REPORTS[kind] if out is None else as_path(out, "out")
    if out is not None:
        refuse_foreign(path)
    atomic_write_text(path, text)
    return path


def report_text(run: RunLike, kind: str = "html") -> str:
    """The report of a run."""
    from biaxbayes.reports.methods import latex_table
    from biaxbayes.reports.run_page import report_page

    opened = as_run(run)
    match kind:
        case "html":
            return report_page(opened)
        case "latex":
            return latex_table(opened)
    raise InputError(f"unknown report {kind[:40]!r}", remedy=f"one of {', '.join(REPORTS)}")


@click.command("report")
@opt.argument("run")
@opt.choice_option("kind", "format", REPORTS, "A page, or the table as LaTeX.")
@opt.file_option(
    "out", "The file to write; - prints  [default: report.html or report.tex in RUN]", "FILE"
)
def command(run: Path, kind: str, out: Path | None) -> int:
    r"""Report RUN: one self-contained HTML page, or the table for a paper.

    \b
    biaxbayes report media-run
    biaxbayes report media-run --format latex --out table2.tex

    Exit code 3 if the chains did not converge, as the report says, too.
    """
    opened = as_run(run)
    if out is not None and str(out) == "-":
        click.echo(report_text(opened, kind), nl=False)
    else:
        click.echo(str(report(opened, kind, out=out)))
    return 0 if opened.state == "converged" else opt.NOT_CONVERGED
