"""``biaxbayes design``: what to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.commands.executor_options import executor_options
from biaxbayes.commands.number_pair import Pair
from biaxbayes.commands.progress_line import progress_line
from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from biaxbayes.findings.design import Design

__all__ = ["command"]

TOLD = ("C1", "k1", "k2", "alpha", "kappa")


@click.command("design")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--ratio",
    "ratios",
    type=Pair("ratio", ":", single=False, zero=True),
    multiple=True,
    metavar="X:Y",
    help="A further stretch ratio to try, as 1:0.75. Repeatable.",
)
@click.option(
    "--further",
    type=click.FloatRange(1.0, 3.0),
    default=1.25,
    show_default=True,
    help="How far the protocol goes that goes further, relative to the tested range.",
)
@click.option("--alpha-sd", type=float, default=5.0, show_default=True, help="Histology, degrees.")
@click.option("--kappa-sd", type=float, default=0.03, show_default=True, help="Histology.")
@click.option(
    "--image-sd", type=float, default=0.005, show_default=True, help="Mounting stretch by image."
)
@click.option(
    "--rank-by",
    default="parameters",
    show_default=True,
    help="The mean over the parameters, 'information', or one quantity, such as kappa.",
)
@click.option("--seed", type=int, default=1, show_default=True, help="Same seed, same bytes.")
@executor_options
@click.option("--quiet", is_flag=True, help="No progress.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the files [the run's].")
def command(
    run: Path,
    ratios: tuple[tuple[float, float], ...],
    further: float,
    alpha_sd: float,
    kappa_sd: float,
    image_sd: float,
    rank_by: str,
    seed: int,
    workers: int | None,
    scheduler: str | None,
    quiet: bool,
    out: Path | None,
) -> int:
    """Say which further measurement would narrow the posterior of RUN most.

    Outcomes of each candidate are simulated from the draws of the run, which are then reweighted;
    where an outcome leaves too few of them, new ones are drawn.
    Writes design.csv, design.pdf and design.png. Exit code 3 where the run is not reliable.
    """
    from biaxbayes.commands.run_state import open_usable_run
    from biaxbayes.executors.executor import executor_for
    from biaxbayes.findings.candidates import standard_candidates
    from biaxbayes.findings.design import design

    for name, value in (("alpha", alpha_sd), ("kappa", kappa_sd), ("image", image_sd)):
        if not 0.0 < value < 1e3:
            raise InputError(f"--{name}-sd must be a positive number")
    if seed < 0:
        raise InputError("--seed must not be negative")
    executor = executor_for(workers, scheduler)
    opened = open_usable_run(run, anyway=False)
    posterior = opened.posterior()
    candidates = standard_candidates(
        posterior,
        ratios=ratios,
        further=further,
        alpha_sd_deg=alpha_sd,
        kappa_sd=kappa_sd,
        image_sd=image_sd,
    )
    with progress_line(quiet=quiet) as tell:
        found = design(
            posterior,
            opened.draws,
            candidates,
            rank_by=rank_by,
            seed=seed,
            executor=executor,
            progress=tell,
        )
    folder = out or run
    _write(found, folder)
    _tell(found, opened.draws, opened.specimen.unit)
    click.echo(f"\n{folder / 'design.csv'}, {folder / 'design.pdf'}")
    return 0 if opened.state == "reliable" else 3


def _write(found: Design, folder: Path) -> None:
    from biaxbayes.output.figures.design import design_figure
    from biaxbayes.output.style import save_figure
    from biaxbayes.specimens.text_file import atomic_write_text

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=folder) from None
    text = found.to_frame().to_csv(index=False, float_format="%.5g", lineterminator="\n")
    atomic_write_text(folder / "design.csv", text)
    figure = design_figure(found)
    for suffix in ("pdf", "png"):
        save_figure(figure, folder / f"design.{suffix}")


def _tell(found: Design, draws: Any, unit: str) -> None:
    from biaxbayes.findings.candidates import FurtherProtocol

    names = [n for n in TOLD if n in found.quantities]
    click.echo("expected reduction of the standard deviation, per cent; information in nats\n")
    head = "".join(f"{n:>9}" for n in names)
    click.echo(f"{'':<24}{'information':>14}{head}{'draws':>8}{'peak load (' + unit + ')':>18}")
    for expected, candidate in zip(found.expected, found.candidates, strict=True):
        cells = ""
        for name in names:
            i = found.quantities.index(name)
            percent = 100.0 * expected.reduction[i], 100.0 * expected.error[i]
            cells += f"{'{:.0f}±{:.0f}'.format(*percent):>9}"
        gain = f"{expected.gain:.1f} ± {expected.gain_error:.1f}"
        peak = ""
        if isinstance(candidate, FurtherProtocol):
            peak = "{:.3g} to {:.3g}".format(*candidate.peak_load(draws.iloc[::20]))
        mark = "" if expected.trusted else "*"
        click.echo(
            f"{expected.name + mark:<24}{gain:>14}{cells}{expected.effective:>8.0f}{peak:>18}"
        )
    if not all(e.trusted for e in found.expected):
        click.echo(
            "\n* too few draws could be had for these outcomes: the true reduction "
            "is at least the column at_least of design.csv"
        )
    for name in found.skipped:
        click.echo(f"note: {name} left out, its loads are beyond any number for some draws")
    click.echo(
        "note: new protocols are taken to have errors of their own, of the size and correlation "
        "of the run's;\na misfit that comes back in every repeat is not averaged away"
    )
