"""``biaxbayes plot``: figures of a run, sized for a paper."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from biaxbayes.output.run import Run

__all__ = ["command"]

FILES = {
    "corner": "corner",
    "bands": "stress-bands",
    "identifiability": "identifiability",
    "mounting": "mounting",
    "trace": "trace",
    "profile": "profile",
}
"""Figures and the stems of their files."""
TAKEN_BY = {
    "truth": ("corner", "mounting"),
    "compare": ("corner",),
    "parameters": ("profile", "trace"),
}
"""Options that go with some figures only."""
"""Profiles in a figure of one column."""


@click.command("plot")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--figure", type=click.Choice(list(FILES)), default="corner", show_default=True)
@click.option(
    "--format",
    "suffix",
    type=click.Choice(["pdf", "svg", "png"]),
    help="Kind of file  [default: that of --out, else pdf]",
)
@click.option(
    "--width-mm",
    type=click.FloatRange(60.0, 400.0),
    default=180.0,
    show_default=True,
    help="Width in print: 85 is a column, 180 a page.",
)
@click.option(
    "--style",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="A matplotlib style (.mplstyle) for fonts and colours.",
)
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    metavar="JSON",
    help="Known values to draw: corner and mounting.",
)
@click.option(
    "--compare",
    type=click.Path(path_type=Path),
    metavar="RUN",
    help="Another run to draw over this one: corner.",
)
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME",
    help="What to show, repeatable: profile and trace.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The file to write  [default: in the run folder]",
)
@click.option("--anyway", is_flag=True, help="Even if the run is not reliable.")
def command(run: Path, **options: Any) -> None:
    r"""Draw a figure of RUN for a paper: fonts embedded, 7 to 8 pt at print size.

    \b
    biaxbayes plot media-posterior --figure corner --width-mm 180
    biaxbayes plot media-posterior --figure bands --width-mm 85 --format svg --out fig3.svg
    biaxbayes plot media-posterior --compare adventitia-posterior --style journal.mplstyle
    biaxbayes plot media-posterior --figure profile --parameter kappa
    """
    from biaxbayes.output.style import read_style, save_figure

    _check(options)
    out = _file(run, options)
    style = read_style(options["style"]) if options["style"] else None
    save_figure(_draw(run, options, style), out, style)
    click.echo(str(out))


def _check(options: dict[str, Any]) -> None:
    for name, figures in TAKEN_BY.items():
        if options[name] and options["figure"] not in figures:
            raise InputError(
                f"--{name.removesuffix('s')} does not go with --figure {options['figure']}",
                remedy=f"it goes with {' and '.join(figures)}",
            )


def _file(run: Path, options: dict[str, Any]) -> Path:
    """Where the figure goes: --out, with the ending of its format."""
    out, suffix = options["out"], options["suffix"]
    if out is None:
        return run / f"{FILES[options['figure']]}.{suffix or 'pdf'}"
    ending = out.suffix.lower().removeprefix(".")
    if ending not in ("pdf", "svg", "png"):
        return out.with_name(f"{out.name}.{suffix or 'pdf'}")
    if suffix not in (None, ending):
        raise InputError(
            f"--format {suffix} does not go with the file name {out.name!r}",
            remedy="leave one of them out",
        )
    return out


def _draw(path: Path, options: dict[str, Any], style: dict[str, Any] | None) -> Figure:
    from biaxbayes.commands.run_state import open_usable_run
    from biaxbayes.output.figures.run_figure import run_figure
    from biaxbayes.output.run import open_run

    kind = options["figure"]
    # Traces are there to see why a run is not reliable; a profile rests on no draws.
    run = (
        open_run(path)
        if kind in ("trace", "profile")
        else open_usable_run(path, anyway=options["anyway"])
    )
    how: dict[str, Any] = {"width_mm": options["width_mm"], "style": style}
    if options["parameters"]:
        how["names"] = tuple(dict.fromkeys(options["parameters"]))
    if options["truth"] is not None:
        from biaxbayes.output.truth_file import read_truth

        how["truth"] = read_truth(options["truth"], run.specimen.name)
    if options["compare"] is not None:
        other = open_usable_run(options["compare"], anyway=options["anyway"])
        how |= {"compare": other.draws, "names": _names(run, other)}
    return run_figure(run, kind, **how)


def _names(run: Run, other: Run) -> tuple[str, str]:
    """What tells two runs apart: the specimen, or else the folder."""
    names = run.specimen.name, other.specimen.name
    return names if names[0] != names[1] else (run.path.name, other.path.name)
