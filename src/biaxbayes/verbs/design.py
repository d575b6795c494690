"""``biaxbayes design``: further measurements ranked by their expected benefit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.options import DesignOptions, takes_options
from biaxbayes.progress_bar import progress_line, with_progress
from biaxbayes.text_files import aligned, write_csv
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, RunLike

if TYPE_CHECKING:
    from biaxbayes.optimal_design.design import Design


@with_progress
@takes_options(DesignOptions)
def design(
    run: RunLike,
    *,
    out: PathLike | None = None,
    workers: int | None = 1,
    scheduler: str | None = None,
    progress: OnProgress = inputs.no_progress,
    **options: Any,
) -> Design:
    """Rank further measurements by how much they would narrow the posterior of a run.

    Parameters
    ----------
    run : Run or path-like
    out : path-like, optional
        Folder for design.csv, design.pdf and design.png.
    workers, scheduler : optional
        As in :func:`biaxbayes.batch`, but one process by default.
    progress : callable or bool, optional
        As in :func:`biaxbayes.sample`.
    **options
        As in :class:`~biaxbayes.options.DesignOptions`.
    """
    from biaxbayes.optimal_design.candidates import standard_candidates
    from biaxbayes.optimal_design.design import design as rank
    from biaxbayes.parallel import executor_for

    candidates = dict(vars(DesignOptions.from_values(options)))
    ranking = {name: candidates.pop(name) for name in ("rank_by", "seed")}
    executor = executor_for(workers, scheduler)
    opened = inputs.usable_run(run)
    inputs.refuse_other_tests(opened.specimen, "design")
    posterior = opened.posterior()
    tried = standard_candidates(posterior, opened.draws, **candidates)
    result = rank(posterior, opened.draws, tried, executor=executor, progress=progress, **ranking)
    if out is not None:
        from biaxbayes.figures.simulations import design_figure
        from biaxbayes.figures.style import save_pictures

        folder = inputs.make_folder(out)
        write_csv(folder / "design.csv", result.to_frame(), digits=5)
        save_pictures(design_figure(result), folder, "design")
    return result


@click.command("design")
@opt.argument("run")
@opt.options(DesignOptions, ratios={"multiple": True, "type": opt.RATIO, "show_default": False})
@opt.executor_options
@opt.flag("quiet", "No progress.")
@opt.file_option("out", "Folder of the files [the run's].")
def command(run: Path, quiet: bool, out: Path | None, **given: Any) -> int:
    """Rank further measurements by how much they would narrow the posterior of RUN.

    Outcomes of each candidate are simulated from the draws of the run, which are then reweighted;
    if an outcome leaves too few of them, new ones are drawn.
    Writes design.csv, design.pdf and design.png. Exit code 3 if the run has not converged.
    """
    opened = opt.open_usable_run(run, anyway=False)
    folder = out or run
    with progress_line(quiet=quiet) as progress:
        result = design(opened, out=folder, progress=progress, **given)
    print_design(result, opened.specimen.unit)
    click.echo(f"\n{folder / 'design.csv'}, {folder / 'design.pdf'}")
    return 0 if opened.state == "converged" else opt.NOT_CONVERGED


def print_design(result: Design, unit: str) -> None:
    """Print a row per candidate, cautions, and what to measure next."""
    from biaxbayes.reports.text import GLOSSARY

    names = [p.name for p in result.known.material if p.name in result.quantities]
    columns = [result.quantities.index(name) for name in names]
    head = "expected reduction of the standard deviation, per cent; information in nats:"
    click.echo(f"{head}\n{GLOSSARY['nats']}\n")
    cells = [["", "information", *names, "draws", f"peak load ({unit})"]]
    for expected, load in zip(result.expected, result.peaks, strict=True):
        name = expected.name + ("" if expected.trusted else "*")
        gain = f"{expected.gain:.1f} ± {expected.gain_error:.1f}"
        per_cent = [
            f"{100 * expected.reduction[i]:.0f}±{100 * expected.error[i]:.0f}" for i in columns
        ]
        peak = "" if load is None else f"{load.low:.3g} to {load.high:.3g}"
        cells.append([name, gain, *per_cent, f"{expected.effective:.0f}", peak])
    click.echo("\n".join(aligned(cells, right=range(1, len(cells[0])))))
    if not all(e.trusted for e in result.expected):
        click.echo(
            "\n* too few draws are left for these outcomes: the true reduction is at least the "
            "column at_least of design.csv"
        )
    for name, words in result.cautions().items():
        click.echo(f"caution: {name} {words}")
    for name in result.skipped:
        click.echo(f"note: {name} is left out, because its loads overflow for some draws")
    click.echo(
        "note: readings of a new protocol have the errors of the run's: the noise of the load cell "
        "and the misfit of the law,\nwhich recurs in a repeat and does not average out"
    )
    click.echo(f"\n{result.conclusion}")
