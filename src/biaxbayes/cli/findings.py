"""``biaxbayes identify``, ``profile``, ``ledger`` and ``design``: what data say."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.cli.options import (
    MODEL,
    Pair,
    any_record_option,
    argument,
    executor_options,
    file_option,
    fix_option,
    model_options,
    mounting_force_option,
    open_usable_run,
    options,
    quiet_option,
    read_model_options,
    refuse_given,
)
from biaxbayes.errors import NotConverged, printable
from biaxbayes.options import DesignOptions, InferringOptions, LedgerPlan, ProfileOptions
from biaxbayes.progress_bar import progress_line

if TYPE_CHECKING:
    from biaxbayes.comparison.mounting_bias import Ledger
    from biaxbayes.optimal_design.design import Design

__all__ = ["design", "identify", "ledger", "profile"]

NOT_CONVERGED = NotConverged.exit_code


# --- identify: which parameters the data determine -----------------------------------------------


@click.command("identify")
@argument("run")
@click.option("--json", "as_json", is_flag=True, help="Verdicts and evidence as JSON.")
@click.option("--no-figure", is_flag=True, help="Leave the figure out.")
def identify(run: Path, as_json: bool, no_figure: bool) -> int:
    """Say which parameters of RUN the data determine, alone or only in combination.

    Writes identifiability.csv and .pdf, determined.csv and same-curves.csv into the run folder.
    Exit code 3 where the chains have not converged: there is no verdict then.
    """
    from biaxbayes import api
    from biaxbayes.jobs.identified import as_json as identified_as_json
    from biaxbayes.jobs.identified import terminal_lines

    result = api.identify(run, out=run, figure=not no_figure)
    if as_json:
        click.echo(identified_as_json(result))
    else:
        for line in terminal_lines(result):
            click.echo(printable(line))
        click.echo(f"\nevidence in {run / 'identifiability.csv'}")
    return 0 if result.state == "converged" else NOT_CONVERGED


# --- profile: the likelihood along one parameter, everything else re-optimised -------------------


@click.command("profile")
@argument("specimen")
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME",
    help="C1, k1, k2, alpha, kappa, mounting_stretch_x or _y; repeatable [the first five].",
)
@options(ProfileOptions, "law", "mounting", "noise", "mounting_stretch")
@fix_option("Hold a parameter; repeatable.")
@options(ProfileOptions, "fibre_switch")
@mounting_force_option()
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@file_option("out", "Folder [<stem>-profile].")
@click.option("--json", "as_json", is_flag=True, help="Intervals and curves as JSON.")
def profile(
    specimen: Path,
    parameters: tuple[str, ...],
    mounting_force: tuple[float, float] | None,
    workers: int,
    out: Path | None,
    as_json: bool,
    **model: Any,
) -> None:
    r"""Profile likelihood of parameters of SPECIMEN (a CSV): what the data alone say.

    At every value of the parameter all others and the mounting stretches are fitted again. Writes
    profile.csv, profile-intervals.csv and profile.pdf.

    \b
    biaxbayes profile media.csv --parameter kappa
    """
    chosen = read_model_options(**model)
    from biaxbayes import api
    from biaxbayes.jobs.identified import profiles_as_json

    folder = out or Path(f"{specimen.stem}-profile")
    found = api.profile(
        specimen, parameters, out=folder, mounting_force=mounting_force, workers=workers, **chosen
    )
    if as_json:
        click.echo(profiles_as_json(found))
        return
    for one in found:
        click.echo(one.in_words())
    click.echo(f"curves in {folder / 'profile.csv'}, figure {folder / 'profile.pdf'}")


# --- ledger: what ignoring the mounting stretch costs --------------------------------------------


@click.command("ledger")
@argument("source", metavar="SPECIMEN|RUN")
@click.option(
    "--stretch",
    "stretches",
    type=float,
    multiple=True,
    help="Total equibiaxial stretch of the stresses. Repeatable  [five up to the largest tested]",
)
@file_option("out", "Folder [<stem>-ledger].")
@options(LedgerPlan, "seed")
@model_options(InferringOptions)
@options(LedgerPlan, "ess", "workers")
@any_record_option
@quiet_option
@click.pass_context
def ledger(
    context: click.Context,
    source: Path,
    stretches: tuple[float, ...],
    out: Path | None,
    seed: int,
    mounting_force: tuple[float, float] | None,
    ess: float,
    workers: int | None,
    anyway: bool,
    quiet: bool,
    **model: Any,
) -> int:
    """Sample a specimen with its mounting stretch inferred, ignored and zeroed, side by side.

    Writes ledger.csv, ledger.pdf and ledger.png. A RUN folder serves as the inferred posterior,
    with its own model options; a specimen CSV is sampled. Exit code 3 when one of the three is
    not converged.
    """
    chosen: dict[str, Any] = {}
    begun: Any = source
    if source.is_dir():
        refuse_given(
            context,
            ("mounting_force", *MODEL, "fix", "priors"),
            "{} does not go with a run, which has its own",
            remedy="give the specimen's CSV instead",
        )
        begun = open_usable_run(source, anyway=False)
    else:
        chosen = read_model_options(**model)
    from biaxbayes import api

    folder = out or Path(f"{source.name if source.is_dir() else source.stem}-ledger")
    with progress_line(quiet=quiet) as tell:
        found = api.ledger(
            begun,
            stretches=stretches,
            out=folder,
            mounting_force=mounting_force,
            anyway=anyway,
            progress=tell,
            seed=seed,
            ess=ess,
            workers=workers,
            **chosen,
        )
    if not quiet:
        _tell_ledger(found, folder)
    not_converged = [name for name, state in found.states.items() if state != "converged"]
    if not_converged:
        click.echo(f"biaxbayes: not converged: {', '.join(not_converged)}; ask for more", err=True)
    return NOT_CONVERGED if not_converged else 0


def _tell_ledger(found: Ledger, folder: Path) -> None:
    from biaxbayes.prediction.stress import INSIDE

    click.echo(f"{found.specimen}: median (5 %, 95 %); shift in sd of the inferred posterior\n")
    click.echo(f"{'':<27}{'inferred':>24}{'ignored':>24}{'shift':>8}{'zeroed':>24}{'shift':>8}")
    for _, row in found.table.iterrows():
        name = str(row["quantity"])
        if row["total_stretch"] == row["total_stretch"]:
            mark = "" if row["extrapolation"] == INSIDE else "*"
            name = f"{name} at {row['total_stretch']:.4g}{mark}"
        cells = [_cell(row, t) for t in ("inferred", "ignored", "zeroed")]
        shifts = [f"{row[f'shift_{t}_sd']:+.1f}" for t in ("ignored", "zeroed")]
        unit = f" ({row['unit']})" if row["unit"] else ""
        click.echo(
            f"{name + unit:<27}{cells[0]:>24}{cells[1]:>24}{shifts[0]:>8}{cells[2]:>24}"
            f"{shifts[1]:>8}"
        )
    outside = found.stresses["extrapolation"] != INSIDE
    if outside.any():
        click.echo("\n* outside of what the test covered, or below the mounted state")
    click.echo(f"\n{folder / 'ledger.csv'}, {folder / 'ledger.pdf'}")


def _cell(row: Any, name: str) -> str:
    from biaxbayes.figures.quantities import number

    low, median, high = (row[f"{name}_{q}"] for q in ("q05", "median", "q95"))
    if low == high:
        return f"{median:.4g} (taken)"
    shown = [number(v, low, high) for v in (median, low, high)]
    return f"{shown[0]} ({shown[1]}, {shown[2]})"


# --- design: what to measure next ----------------------------------------------------------------


@click.command("design")
@argument("run")
@options(
    DesignOptions,
    ratios={
        "multiple": True,
        "type": Pair("ratio", ":", "1:0.5", zero=True),
        "show_default": False,
    },
)
@executor_options
@click.option("--quiet", is_flag=True, help="No progress.")
@file_option("out", "Folder of the files [the run's].")
def design(
    run: Path,
    workers: int | None,
    scheduler: str | None,
    quiet: bool,
    out: Path | None,
    **how: Any,
) -> int:
    """Say which further measurement would narrow the posterior of RUN most.

    Outcomes of each candidate are simulated from the draws of the run, which are then reweighted;
    where an outcome leaves too few of them, new ones are drawn.
    Writes design.csv, design.pdf and design.png. Exit code 3 where the run has not converged.
    """
    from biaxbayes import api

    opened = open_usable_run(run, anyway=False)
    folder = out or run
    with progress_line(quiet=quiet) as tell:
        found = api.design(
            opened, out=folder, workers=workers, scheduler=scheduler, progress=tell, **how
        )
    _tell_design(found, opened.specimen.unit)
    click.echo(f"\n{folder / 'design.csv'}, {folder / 'design.pdf'}")
    return 0 if opened.state == "converged" else NOT_CONVERGED


def _tell_design(found: Design, unit: str) -> None:
    from biaxbayes.reports.words import NATS

    names = [p.name for p in found.known.material if p.name in found.quantities]
    click.echo(
        f"expected reduction of the standard deviation, per cent; information in nats:\n{NATS}\n"
    )
    head = "".join(f"{n:>9}" for n in names)
    click.echo(f"{'':<24}{'information':>14}{head}{'draws':>8}{'peak load (' + unit + ')':>18}")
    for expected, load in zip(found.expected, found.peaks, strict=True):
        cells = ""
        for name in names:
            i = found.quantities.index(name)
            percent = 100.0 * expected.reduction[i], 100.0 * expected.error[i]
            cells += f"{'{:.0f}±{:.0f}'.format(*percent):>9}"
        gain = f"{expected.gain:.1f} ± {expected.gain_error:.1f}"
        peak = "" if load is None else f"{load.low:.3g} to {load.high:.3g}"
        mark = "" if expected.trusted else "*"
        click.echo(
            f"{expected.name + mark:<24}{gain:>14}{cells}{expected.effective:>8.0f}{peak:>18}"
        )
    if not all(e.trusted for e in found.expected):
        click.echo(
            "\n* too few draws could be had for these outcomes: the true reduction "
            "is at least the column at_least of design.csv"
        )
    for name, words in found.cautions().items():
        click.echo(f"caution: {name} {words}")
    for name in found.skipped:
        click.echo(f"note: {name} left out, its loads are beyond any number for some draws")
    click.echo(
        "note: new protocols are taken to have errors of their own, of the size and correlation "
        "of the run's;\na misfit that comes back in every repeat is not averaged away"
    )
