"""``biaxbayes compare``: several runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.commands.model_options import (
    model_options,
    read_model_options,
    specimen_with_mounting_force,
)
from biaxbayes.commands.progress_line import graceful_stop, progress_line
from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from biaxbayes.findings.compare import Comparison

__all__ = ["command"]


@click.command("compare")
@click.argument(
    "sources", metavar="RUN|CSV...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--labels", metavar="A,B,...", help="Names of the runs, in their order.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("comparison"),
    show_default=True,
    help="Folder of the tables, figures and the page.",
)
@click.option("--seed", type=int, default=1, show_default=True, help="For specimens to sample.")
@model_options
@click.option("--ess", type=float, default=2000, show_default=True, help="Effective draws wanted.")
@click.option("--workers", type=int, default=None, help="Threads [processors, at most 4].")
@click.option("--anyway", is_flag=True, help="Take runs whose chains have not converged.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def command(
    sources: tuple[Path, ...],
    labels: str | None,
    out: Path,
    seed: int,
    mounting_force: tuple[float, float] | None,
    ess: float,
    workers: int | None,
    anyway: bool,
    quiet: bool,
    **model: Any,
) -> int:
    r"""Compare runs of different layers, specimens or settings.

    Writes the matrix of verdicts, the overlaid posteriors, the forest of intervals, the distances
    between the runs and a page, compare.html. A specimen CSV is sampled first, with the model
    options given here, into a run folder inside of --out.

    \b
    biaxbayes compare intima.run media.run adventitia.run --out layers
    biaxbayes compare media.run media.csv --fix alpha=41 --labels "free,alpha from histology"
    """
    from biaxbayes.findings.compare import Member, compare, labels_of
    from biaxbayes.output.comparison import write_comparison

    options = read_model_options(**model)
    names = _labels(labels, len(sources))
    runs = []
    for source in sources:
        if not source.is_dir():
            source = _sampled(source, out, seed, mounting_force, ess, workers, quiet, options)
        runs.append(_opened(source, anyway=anyway))
    if names is None:
        names = labels_of([r.specimen for r in runs], [r.path.name for r in runs])
    found = compare(
        [
            Member(name, run.posterior(), run.draws, _state(run.state, anyway=anyway))
            for name, run in zip(names, runs, strict=True)
        ]
    )
    written = write_comparison(found, out)
    if not quiet:
        _tell(found, written)
    if not found.reliable:
        click.echo("biaxbayes: not every run is reliable, see compare.html", err=True)
    return 0 if found.reliable else 3


def _labels(text: str | None, count: int) -> list[str] | None:
    if count < 2:
        raise InputError("a comparison needs two runs or more")
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if len(names) != count or not all(names):
        raise InputError(
            f"--labels names {len(names)} runs of {count}", remedy="one each, between commas"
        )
    return names


def _opened(path: Path, *, anyway: bool) -> Any:
    from biaxbayes.commands.run_state import open_usable_run

    return open_usable_run(path, anyway=anyway)


def _state(state: str, *, anyway: bool) -> str:
    """Draws taken anyway still get no verdict."""
    return "tentative" if anyway and state == "unusable" else state


def _sampled(
    source: Path,
    out: Path,
    seed: int,
    force: tuple[float, float] | None,
    ess: float,
    workers: int | None,
    quiet: bool,
    options: dict[str, Any],
) -> Path:
    """Sample a specimen into a run folder inside of the comparison's."""
    from biaxbayes.output.sampling import Sampling

    specimen = specimen_with_mounting_force(source, force)
    sampling = Sampling.prepare(
        specimen,
        out=out / f"{source.stem}-posterior",
        options=options,
        seed=seed,
        ess=ess,
        max_steps=20_000,
        workers=workers,
    )
    sampling.source = source.name
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        return sampling.execute(progress=tell, stop=stop)


def _tell(found: Comparison, written: list[Path]) -> None:
    from biaxbayes.findings.compare import WARNING

    for label, verdicts in zip(found.labels, found.verdicts, strict=True):
        click.echo(f"{label}:")
        for parameter in verdicts.parameters:
            share = ""
            if parameter.evidence is not None:
                share = f"{min(100.0 * max(parameter.evidence.contraction, 0.0), 99.9):.1f} %"
            click.echo(f"  {parameter.name:<22}{parameter.verdict:<22}{share:>8}")
    apart = found.distances[found.distances["determined_in_both"]]
    click.echo("\ndetermined in both, largest distances (in sd):")
    for (a, b), rows in apart.groupby(["run_a", "run_b"], sort=False):
        most = rows.reindex(rows["standardised"].abs().sort_values(ascending=False).index).head(4)
        cells = [f"{_name(r)} {r['standardised']:+.1f}" for r in most.to_dict("records")]
        click.echo(f"  {b} minus {a}: {', '.join(cells)}")
    for note in found.notes:
        click.echo(f"note: {note}")
    click.echo(f"note: {WARNING}")
    click.echo(f"\n{written[-1]}")


def _name(row: dict[Any, Any]) -> str:
    at = row["total_stretch"]
    return str(row["quantity"]) if at != at or at is None else f"{row['quantity']} at {at:.4g}"
