"""``biaxbayes report``: the page of a run again, or its tables for a paper."""

from __future__ import annotations

from pathlib import Path

import click

from biaxbayes.errors import InputError

__all__ = ["command"]


@click.command("report")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "kind",
    type=click.Choice(["html", "md", "latex"]),
    default="html",
    show_default=True,
    help="A page, or the tables as Markdown or LaTeX.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The file to write; - prints  [default: report.html, .md or .tex in RUN]",
)
def command(run: Path, kind: str, out: Path | None) -> int:
    r"""Report RUN: one self-contained HTML page, or tables for a paper.

    \b
    biaxbayes report media-run
    biaxbayes report media-run --format latex --out table2.tex

    Exit code 3 where the chains did not converge: the report says so, too.
    """
    from biaxbayes.output.report.page import report_page
    from biaxbayes.output.report.tables import latex_table, markdown_table
    from biaxbayes.output.run import open_run
    from biaxbayes.specimens.text_file import atomic_write_text

    opened = open_run(run)
    write = {"html": report_page, "md": markdown_table, "latex": latex_table}[kind]
    text = write(opened)
    if out is not None and str(out) == "-":
        click.echo(text, nl=False)
    else:
        path = out or run / {"html": "report.html", "md": "report.md", "latex": "report.tex"}[kind]
        if path.is_dir():
            raise InputError("is a folder", file=path, remedy="give a file name with --out")
        atomic_write_text(path, text)
        click.echo(str(path))
    return 0 if opened.state == "reliable" else 3
