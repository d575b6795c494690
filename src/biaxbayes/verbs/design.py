"""``biaxbayes design``: further measurements ranked by their expected benefit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.options import DesignOptions, takes_options
from biaxbayes.progress_bar import Progress, with_progress
from biaxbayes.reports.text import GLOSSARY
from biaxbayes.text_files import write_csv
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, RunLike, Stop

if TYPE_CHECKING:
    from biaxbayes.optimal_design.design import Design


@with_progress
@takes_options(DesignOptions)
def design(
    run: RunLike,
    *,
    out: PathLike | None = None,
    progress: OnProgress = inputs.no_progress,
    stop: Stop = inputs.no_stop,
    **options: Any,
) -> Design:
    """Rank further measurements by how much they would narrow the posterior of a run.

    Parameters
    ----------
    run : Run or path-like
    out : path-like, optional
        Folder for design.csv, design.pdf and design.png.
    progress, stop : callable, optional
        As in :func:`biaxbayes.sample`.
    **options
        As in :class:`~biaxbayes.options.DesignOptions`.
    """
    from biaxbayes.optimal_design.candidates import standard_candidates
    from biaxbayes.optimal_design.design import design as rank

    candidates = dict(vars(DesignOptions.from_values(options)))
    rank_by = candidates.pop("rank_by")
    progress(Progress("reading the run"))
    opened = inputs.usable_run(run)
    inputs.refuse_other_tests(opened.specimen, "design")
    posterior = opened.posterior()
    tried = standard_candidates(posterior, opened.draws, **candidates)
    result = rank(posterior, opened.draws, tried, rank_by=rank_by, progress=progress, stop=stop)
    if out is not None:
        progress(Progress("writing"))
        from biaxbayes.figures.simulations import design_figure
        from biaxbayes.figures.style import save_pictures

        folder = inputs.make_folder(out)
        write_csv(folder / "design.csv", result.to_frame(), digits=5)
        save_pictures(design_figure(result), folder, "design")
    return result


@click.command("design")
@opt.argument("run")
@opt.options(DesignOptions, ratios={"multiple": True, "type": opt.RATIO, "show_default": False})
@opt.file_option("out", "Folder of the files [the run's].")
def command(run: Path, out: Path | None, **given: Any) -> int:
    """Rank further measurements by how much they would narrow the posterior of RUN.

    Writes design.csv, design.pdf and design.png. Exit code 3 if the run has not converged.
    """
    opened = opt.open_usable_run(run, anyway=False)
    folder = out or run
    result = design(opened, out=folder, **given)
    print_design(result)
    click.echo(f"\n{folder / 'design.csv'}, {folder / 'design.pdf'}")
    return 0 if opened.state == "converged" else opt.NOT_CONVERGED


def print_design(result: Design) -> None:
    """Print a row per candidate, cautions, and what to measure next."""
    click.echo(f"{result.table.label}; nats: {GLOSSARY['nats']}\n")
    click.echo("\n".join(result.table.lines()))
    for name, words in result.cautions().items():
        click.echo(f"caution: {name} {words}")
    for name in result.skipped:
        click.echo(f"note: {name} is left out, because its loads overflow for some draws")
    click.echo(
        "note: readings of a new protocol have the errors of the run's: the noise of the load cell "
        "and the misfit of the law,\nwhich recurs in a repeat and does not average out"
    )
    click.echo(f"\n{result.conclusion}")
