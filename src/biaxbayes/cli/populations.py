"""``biaxbayes population``: what the specimens of a study have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.cli.options import argument, file_option, options, quiet_option
from biaxbayes.cli.progress import graceful_stop, plain, progress_line
from biaxbayes.errors import NotConverged
from biaxbayes.options import PopulationOptions

if TYPE_CHECKING:
    from biaxbayes.jobs.population_files import PopulationFound

__all__ = ["population"]

NOT_CONVERGED = NotConverged.exit_code
MARK = "*"


@click.command("population")
@argument("study", metavar="STUDY.toml|FOLDER")
@file_option("out", "Folder [<stem>-population].", "DIR")
@file_option("runs", "For a study file: the study folder [<stem>-study].", "DIR")
@file_option("priors", "Priors of means, sds and correlations.", "FILE.toml")
@options(PopulationOptions, "pool_mounting", "spread", "correlations")
@options(PopulationOptions, "seed", "ess", "max_steps", "workers")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler for specimens that have to be sampled first, as tcp://host:8786.",
)
@click.option("--resume", is_flag=True, help="Continue from the folder's checkpoint.")
@click.option("--anyway", is_flag=True, help="Take specimens whose runs are tentative, too.")
@quiet_option
def population(
    study: Path,
    out: Path | None,
    runs: Path | None,
    priors: Path | None,
    scheduler: str | None,
    resume: bool,
    anyway: bool,
    quiet: bool,
    **chosen: Any,
) -> int:
    r"""What the specimens of STUDY have in common: a hierarchical posterior over them.

    STUDY is the folder of a finished batch, or a study file, whose specimens are sampled first
    where that has not been done. Groups are the layers, or what the study file names in columns.
    Writes population.csv (means and spreads of donors and of specimens with verdicts, new specimens
    and donors), specimens.csv (each specimen before and after pooling), contrasts.csv and
    population.nc. Exit code 0 when the posterior has converged, 3 when the chains did not converge,
    2 when the input cannot be used.

    \b
    biaxbayes population study.toml --out aortas-population
    biaxbayes population study-study --out population --priors population-priors.toml
    """
    from biaxbayes import api

    folder = out or Path(f"{study.stem}-population")
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        found = api.population(
            study,
            out=folder,
            runs=runs,
            priors=priors,
            scheduler=scheduler,
            resume=resume,
            anyway=anyway,
            progress=tell,
            stop=stop,
            **chosen,
        )
    for label, reason in found.left_out.items():
        click.echo(f"biaxbayes: left out: {plain(label)}: {plain(reason)}", err=True)
    if not quiet:
        click.echo(_closing(found))
    elif found.state != "converged":
        click.echo(f"biaxbayes: {found.reason}", err=True)
    return 0 if found.state == "converged" else NOT_CONVERGED


def _closing(found: PopulationFound) -> str:
    """One screen that says what was found."""
    from biaxbayes.identifiability.verdict import PRIOR
    from biaxbayes.populations.result import SDS
    from biaxbayes.reports.population import three_digits
    from biaxbayes.reports.words import counted

    def sd(row: dict[Any, Any], side: str) -> str:
        mark = MARK if row[f"{side}_verdict"] == PRIOR else " "
        return f"{three_digits(row[f'{side}_q50']) + mark:>11}"

    said = found.state if found.state == "converged" else f"{found.state.upper()}: {found.reason}"
    lines = [f"{plain(found.name)}: {said}"]
    for group, part in found.groups.groupby("group", sort=False):
        first = part.iloc[0]
        lines += [
            "",
            f"{plain(str(group))}: {counted(first['specimens'], 'specimen')} of "
            f"{counted(first['donors'], 'donor')}",
            f"{'quantity':<22}{'unit':<6}{'median':>9}{'5 %':>9}{'95 %':>9}"
            f"{'sd donors':>10}{'sd spec.':>11}    {'new specimen':<19}verdict on the median",
        ]
        for r in part.to_dict("records"):
            mean = "".join(f"{three_digits(r[f'mean_{q}']):>9}" for q in ("q50", "q05", "q95"))
            sds = "".join(sd(r, side) for side in SDS)
            new = f"{three_digits(r['new_specimen_q05'])} to {three_digits(r['new_specimen_q95'])}"
            unit = "" if r["unit"] == "1" else str(r["unit"])
            head = f"{str(r['quantity'])[:21]:<22}{unit:<6}"
            lines.append(f"{head}{mean}{sds}   {new:<19}{r['verdict']}")
    lines += ["", "sds of logs where the scale is log (population.csv)"]
    if any((found.groups[f"{side}_verdict"] == PRIOR).any() for side in SDS):
        lines.append(f"{MARK} {PRIOR}: the specimens say little of this sd")
    lines += [f"note: {plain(note)}" for note in found.notes]
    lines += ["", f"all tables and draws are in {found.folder}"]
    return "\n".join(lines)
