"""``biaxbayes plot``: figures of a run, sized for a paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import pandas as pd
from matplotlib.figure import Figure

from biaxbayes.errors import InputError
from biaxbayes.figures import style as look
from biaxbayes.figures.bands import bands_figure
from biaxbayes.figures.corner import corner_figure
from biaxbayes.figures.identifiability import identifiability_figure
from biaxbayes.figures.mounting import mounting_figure
from biaxbayes.figures.profile import profile_figure
from biaxbayes.figures.trace import trace_figure
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.options import FIGURE_FORMATS, PLOTS, Option, for_users
from biaxbayes.profiles.profile import profiles
from biaxbayes.runs.run import Run
from biaxbayes.specimens.truth import read_truth
from biaxbayes.tasks import process_lock
from biaxbayes.text_files import as_path, refuse_foreign, safe_file_name
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import PathLike, RunLike, as_run, as_style, usable_run

PLOT_TAKES = {
    "truth": ("corner", "bands", "mounting"),
    "compare": ("corner",),
    "parameters": ("corner", "profile", "trace"),
}
"""Options of some figures only."""
FIGURES_OF_UNCONVERGED_RUNS = ("trace", "profile")
"""Figures of runs that have not converged: traces show why, and a profile uses no draws."""
WIDTH = Option(kind=float, minimum=50.0, maximum=400.0)
"""Width of a figure in print, mm."""
MAX_PROFILES_IN_COLUMN = 3
"""Profiles that fit one column of a page."""


# --- the figures of a run, by name ---------------------------------------------------------------


def run_figure(run: Run, kind: str, **how: Any) -> Figure:
    """Draw a figure of a run; ``how`` are the arguments of its function in ``figures``."""
    match kind:
        case "corner":
            how = {"law": run.law.short_name, "reported": [run.result.reported]} | how
            return corner_figure(run.draws, known=run.quantities, **how)
        case "bands":
            return bands_figure(run.posterior(), run.draws, **how)
        case "mounting":
            return mounting_figure(run.specimen, run.draws, **how)
        case "trace":
            rhat = dict(zip(run.summary["parameter"], run.summary["rhat"], strict=True))
            how |= {"unit": run.specimen.unit, "known": run.quantities}
            return trace_figure(run.chains, rhat=rhat, **how)
        case "identifiability":
            verdicts = identify_draws(run.posterior(), run.draws, run.state)
            return identifiability_figure(verdicts, run.result.reported, **how)
        case "profile":
            posterior = run.posterior()
            names = how.pop("names", ()) or [n for n in posterior.law.names if n in posterior.free]
            most = MAX_PROFILES_IN_COLUMN
            if how["width_mm"] < look.SIDE_BY_SIDE_MM and len(names) > most:
                problem = f"{len(names)} profiles do not fit one column of a page"
                remedy = f"name up to {most} with `parameters`, or choose `width_mm=180`"
                raise InputError(problem, remedy=remedy)
            return profile_figure(profiles(posterior, names), **how)
    raise InputError(f"unknown figure {str(kind)[:40]!r}", remedy=f"one of {', '.join(PLOTS)}")


# --- a figure in the style of a paper ------------------------------------------------------------


@for_users
def plot(
    run: RunLike,
    figure: str = "corner",
    *,
    out: PathLike | None = None,
    suffix: str | None = None,
    width_mm: float = look.PAGE_MM,
    style: Any = None,
    truth: Any = None,
    compare: Any = None,
    parameters: Sequence[str] = (),
    anyway: bool = True,
) -> Figure:
    """Draw a figure of a run, in the style of a paper.

    Parameters
    ----------
    run : Run or path-like
    figure : {"corner", "bands", "identifiability", "mounting", "trace", "profile"}
    out : path-like, optional
        File to write; see :func:`picture_file`. Not one of the run's own figures.
    suffix : {"pdf", "svg", "png"}, optional
        Kind of file; default that of ``out``, else pdf.
    width_mm : float
        In print.
    style : mapping or path-like, optional
        Settings of matplotlib, or the file to read them from.
    truth : mapping or path-like, optional
        Known values to draw, or the JSON to read them from: corner, bands and mounting.
    compare : Run, path-like or DataFrame, optional
        Another run, or its draws, to draw over this one: corner.
    parameters : sequence of str
        What to show: corner, profile and trace.
    anyway : bool
        Use the draws of a run that has not converged.
    """
    given = {"truth": truth, "compare": compare, "parameters": tuple(parameters) or None}
    for name, figures in PLOT_TAKES.items():
        if given[name] is not None and figure not in figures:
            problem = f"`{name}` does not go with `figure={figure}`"
            raise InputError(problem, remedy=f"it goes with {' and '.join(figures)}")
    if not WIDTH.allows(width_mm):
        raise InputError(f"`width_mm` must be {WIDTH.allowed}")
    target = None if out is None else picture_file(out, suffix)
    how: dict[str, Any] = {"width_mm": width_mm}
    with process_lock, look.print_style(as_style(style)):
        opened = as_run(run) if anyway or figure in FIGURES_OF_UNCONVERGED_RUNS else usable_run(run)
        files = opened.provenance.get("files") or {}
        if target is not None:
            if target.name in files and target.resolve().parent == opened.path.resolve():
                remedy = "choose another name with `out`"
                raise InputError("is a figure of the run itself", file=target, remedy=remedy)
            refuse_foreign(target)
        if len(parameters):
            key = "parameters" if figure == "corner" else "names"  # names of a corner are its runs
            how[key] = tuple(dict.fromkeys(parameters))
        if truth is not None:
            if not isinstance(truth, Mapping):
                truth = read_truth(as_path(truth, "truth"), opened.specimen.name)
            how["truth"] = truth
        if isinstance(compare, pd.DataFrame):
            how["compare"] = compare
        elif compare is not None:
            other = as_run(compare) if anyway else usable_run(compare)
            names = opened.specimen.name, other.specimen.name
            if names[0] == names[1]:
                names = opened.path.name, other.path.name
            how |= {"compare": other.draws, "names": names}
            how["reported"] = [opened.result.reported, other.result.reported]
        drawn = run_figure(opened, figure, **how)
        if target is not None:
            look.save_figure(drawn, target)
        return drawn


def picture_file(out: PathLike, suffix: str | None = None) -> Path:
    """The file of a figure: ``out``, with the suffix of its format if it has none."""
    path = as_path(out, "out")
    if not path.suffix:
        return path.with_name(f"{path.name}.{suffix or FIGURE_FORMATS[0]}")
    if suffix not in (None, look.picture_suffix(path)):
        problem = f"`suffix={suffix}` does not go with the file name {path.name!r}"
        raise InputError(problem, remedy="leave one of them out")
    return path


# --- the command ---------------------------------------------------------------------------------


@click.command("plot")
@opt.argument("run")
@opt.choice_option("figure", "figure", PLOTS)
@click.option(
    "--format",
    "suffix",
    type=click.Choice(FIGURE_FORMATS),
    help="Kind of file  [default: that of --out, else pdf]",
)
@click.option(
    "--width-mm",
    default=look.PAGE_MM,
    show_default=True,
    help="Width in print: 85 is a column, 180 a page.",
)
@opt.file_option("style", "A matplotlib style (.mplstyle) for fonts and colours.", "FILE")
@opt.file_option("truth", "Known values to draw: corner, bands and mounting.", "JSON")
@opt.file_option("compare", "Another run to draw over this one: corner.", "RUN")
@opt.parameters_option("What to show, repeatable: corner, profile and trace.")
@opt.file_option(
    "out", "The file to write  [default: in the run folder, named by figure and width]", "FILE"
)
@opt.unconverged_option
def command(
    run: Path, figure: str, suffix: str | None, out: Path | None, anyway: bool, **given: Any
) -> None:
    r"""Draw a figure of RUN for a paper: letters as text, 7 to 8 pt at print size.

    \b
    biaxbayes plot media-posterior --figure corner --width-mm 180
    biaxbayes plot media-posterior --figure bands --width-mm 85 --format svg --out fig3.svg
    biaxbayes plot media-posterior --compare adventitia-posterior --style journal.mplstyle
    biaxbayes plot media-posterior --figure profile --parameter kappa
    """
    compare = given.pop("compare")
    # The run's own figures have no width in their names.
    parts = [PLOTS[figure], *dict.fromkeys(given["parameters"])]
    parts += [] if compare is None else ["with", compare.resolve().name]
    name = "-".join([*parts, f"{given['width_mm']:g}mm"])
    file = f"{safe_file_name(name, limit=120)}.{suffix or FIGURE_FORMATS[0]}"
    target = picture_file(out or run / file, suffix)
    usable = figure not in FIGURES_OF_UNCONVERGED_RUNS
    opened: Any = opt.open_usable_run(run, anyway=anyway) if usable else run
    other = None if compare is None else opt.open_usable_run(compare, anyway=anyway)
    plot(opened, figure, out=target, compare=other, anyway=anyway, **given)
    click.echo(str(target))
