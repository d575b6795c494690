"""``biaxbayes sample``: the main job."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from biaxbayes.commands.model_options import (
    model_options,
    read_model_options,
    specimen_with_mounting_force,
)
from biaxbayes.commands.progress_line import graceful_stop, progress_line

__all__ = ["command"]


@click.command("sample")
@click.argument("specimen", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [<stem>-posterior].")
@click.option("--seed", type=int, default=1, show_default=True, help="Same seed, same bytes.")
@model_options
@click.option("--ess", type=float, default=2000, show_default=True, help="Effective draws wanted.")
@click.option("--max-steps", type=int, default=20_000, show_default=True, help="When to give up.")
@click.option("--workers", type=int, default=None, help="Threads [processors, at most 4].")
@click.option("--resume", is_flag=True, help="Continue from the folder's checkpoint.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def command(
    specimen: Path,
    out: Path | None,
    seed: int,
    mounting_force: tuple[float, float] | None,
    ess: float,
    max_steps: int,
    workers: int | None,
    resume: bool,
    quiet: bool,
    **model: Any,
) -> int:
    """Joint posterior of the GOH parameters and the mounting stretches of SPECIMEN (a CSV).

    Writes a run folder with the draws, tables, figures and verdicts. Exit code 0 when the
    posterior is reliable, 3 when the chains did not converge, 2 when the input cannot be used.
    """
    options = read_model_options(**model)
    read = specimen_with_mounting_force(specimen, mounting_force)
    from biaxbayes.output.run import open_run
    from biaxbayes.output.sampling import Sampling

    sampling = Sampling.prepare(
        read,
        out=out or Path(f"{specimen.stem}-posterior"),
        options=options,
        seed=seed,
        ess=ess,
        max_steps=max_steps,
        workers=workers,
    )
    sampling.source = specimen.name
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        folder = sampling.execute(resume=resume, progress=tell, stop=stop)
    run = open_run(folder)
    if not quiet:
        from biaxbayes.output.closing import closing_message

        click.echo(closing_message(run))
    elif run.state != "reliable":
        click.echo(f"biaxbayes: {run.provenance['convergence']['reason']}", err=True)
    return 0 if run.state == "reliable" else 3
