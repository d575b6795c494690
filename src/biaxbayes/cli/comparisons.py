"""``biaxbayes compare``, ``laws`` and ``population``: runs, laws and specimens side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.cli.options import (
    argument,
    executor_options,
    file_option,
    model_options,
    mounting_force_option,
    open_usable_run,
    options,
    overwrite_option,
    quiet_option,
    read_model_options,
)
from biaxbayes.errors import NotConverged, printable
from biaxbayes.options import LawsPlan, ModelOptions, PopulationOptions, SamplingPlan
from biaxbayes.progress_bar import graceful_stop, progress_line

if TYPE_CHECKING:
    from biaxbayes.comparison.compare import Comparison
    from biaxbayes.comparison.law_weights import LawComparison
    from biaxbayes.jobs.population_files import PopulationFound

__all__ = ["compare", "laws", "population"]


# --- compare: several runs side by side ----------------------------------------------------------

NOT_CONVERGED = NotConverged.exit_code


@click.command("compare")
@argument("sources", metavar="RUN|CSV...", nargs=-1, required=True)
@click.option("--labels", metavar="A,B,...", help="Names of the runs, in their order.")
@file_option(
    "out",
    "Folder of the tables, figures and the page.",
    default=Path("comparison"),
    show_default=True,
)
@options(SamplingPlan, "seed", seed={"help": "For specimens to sample."})
@model_options()
@options(SamplingPlan, "ess", "workers")
@click.option(
    "--anyway",
    is_flag=True,
    help="Take runs whose chains have not converged, and records that cannot be loading curves.",
)
@overwrite_option("run")
@quiet_option
def compare(
    sources: tuple[Path, ...],
    labels: str | None,
    out: Path,
    seed: int,
    mounting_force: tuple[float, float] | None,
    ess: float,
    workers: int | None,
    anyway: bool,
    overwrite: bool,
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
    chosen = read_model_options(**model)
    from biaxbayes import api

    names = None if labels is None else [name.strip() for name in labels.split(",")]
    api.check_comparison(sources, names)
    runs = [open_usable_run(s, anyway=anyway) if s.is_dir() else s for s in sources]
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        found = api.compare(
            runs,
            labels=names,
            out=out,
            mounting_force=mounting_force,
            anyway=anyway,
            overwrite=overwrite,
            progress=tell,
            stop=stop,
            seed=seed,
            ess=ess,
            workers=workers,
            **chosen,
        )
    if not quiet:
        _tell_compared(found, out)
    if not found.converged:
        click.echo("biaxbayes: not every run has converged, see compare.html", err=True)
    return 0 if found.converged else NOT_CONVERGED


def _tell_compared(found: Comparison, out: Path) -> None:
    from biaxbayes.comparison.compare import WARNING

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
    click.echo(f"\n{out / 'compare.html'}")


def _name(row: dict[Any, Any]) -> str:
    at = row["total_stretch"]
    return str(row["quantity"]) if at != at or at is None else f"{row['quantity']} at {at:.4g}"


# --- laws: material laws side by side, weighed by what they predict ------------------------------


@click.command("laws")
@argument("specimen")
@options(LawsPlan, "laws")
@file_option("out", "Folder [<stem>-laws].")
@options(ModelOptions, "mounting", "mounting_sd", "noise", "noise_growth", "thin")
@mounting_force_option()
@options(LawsPlan, "seed", "ess", "max_steps")
@executor_options
@click.option("--resume", is_flag=True, help="Go on with what the folder holds.")
@quiet_option
def laws(
    specimen: Path,
    out: Path | None,
    mounting_force: tuple[float, float] | None,
    workers: int | None,
    scheduler: str | None,
    resume: bool,
    quiet: bool,
    **how: Any,
) -> int:
    r"""Fit and sample every material law on SPECIMEN, and weigh them by what they predict.

    Each protocol is left out in turn, or each quarter of the only one, and foretold from the rest.
    Writes laws.csv, stated.csv, left-out.csv, stacked-draws.csv, stacked-bands.csv, three figures
    and laws.html. Exit code 3 when a law has not converged on some part of the record.

    \b
    biaxbayes laws media.csv --laws goh,fung
    """
    from biaxbayes import api

    folder = out or Path(f"{specimen.stem}-laws")
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        found = api.compare_laws(
            specimen,
            out=folder,
            mounting_force=mounting_force,
            resume=resume,
            workers=workers,
            scheduler=scheduler,
            progress=tell,
            stop=stop,
            **how,
        )
    if not quiet:
        _tell_weighed(found, folder)
    for law, why in found.left_out.items():
        click.echo(f"biaxbayes: {law} is left out: {why}", err=True)
    return 0 if found.converged else NOT_CONVERGED


def _tell_weighed(found: LawComparison, folder: Path) -> None:
    """The table, the heaviest law first, and what is stated of the mounting stretches."""
    from biaxbayes.reports.comparison import stated_rows

    stretches = [c for c in found.table if str(c).startswith("mounting_stretch_x")]
    head = f"{'':<18}{'rms':>9}{'left out':>10}{'density':>10}{'weight':>8}{'(range)':>14}"
    click.echo(head + ("   mounting stretch x, 90 %" if stretches else ""))
    click.echo(f"{'':<18}{'kPa':>9}{'kPa':>10}{'nats':>10}")
    table = found.table.sort_values("weight", ascending=False, kind="stable", na_position="last")
    for row in (*table.iloc[1:].to_dict("records"), table.iloc[0].to_dict()):
        if row["left_out_rms"] != row["left_out_rms"]:
            click.echo(f"{row['law']:<18}{row['state']}")
            continue
        rms = f"{row['rms']:.3g}" if row["rms"] == row["rms"] else ""
        spread = ""
        if row["weight_low"] == row["weight_low"]:
            spread = f"({row['weight_low']:.2f}-{row['weight_high']:.2f})"
        line = f"{row['law']:<18}{rms:>9}{row['left_out_rms']:>10.3g}"
        line += f"{row['left_out_density']:>10.1f}{row['weight']:>8.2f}{spread:>14}"
        if stretches:
            low, high = row["mounting_stretch_x_q05"], row["mounting_stretch_x_q95"]
            line += f"   {low:.4f} to {high:.4f}"
        click.echo(line)
    click.echo(
        "\nrms (typical miss) of the fit to all, and of parts left out; density: how well these\n"
        "were foretold, larger is better, 2.3 nats more are ten times as probable; weights by\n"
        "stacking, the shares of the mixture that foretells best. The mixture is a prediction\n"
        "of stresses, no posterior of the mounting stretch."
    )
    for said in stated_rows(found.stated):
        click.echo(f"{said['quantity'].name} of the tissue: {said['words']}; {said['reason']}")
    click.echo(f"\nopen {folder / 'laws.html'}; tables and figures are beside it")


# --- population: what the specimens of a study have in common ------------------------------------

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
@overwrite_option("population")
@click.option("--anyway", is_flag=True, help="Take specimens whose runs are tentative, too.")
@quiet_option
def population(
    study: Path,
    out: Path | None,
    runs: Path | None,
    priors: Path | None,
    scheduler: str | None,
    resume: bool,
    overwrite: bool,
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
            overwrite=overwrite,
            anyway=anyway,
            progress=tell,
            stop=stop,
            **chosen,
        )
    for label, reason in found.left_out.items():
        click.echo(f"biaxbayes: left out: {printable(label)}: {printable(reason)}", err=True)
    if not quiet:
        click.echo(_closing(found))
    elif found.state != "converged":
        click.echo(f"biaxbayes: {found.reason}", err=True)
    return 0 if found.state == "converged" else NOT_CONVERGED


QUALIFIED = (", but loosely", "; sensitive to the prior")
"""What the sentence on a verdict may add to it."""


def _qualified(row: dict[Any, Any]) -> str:
    """A verdict with what its sentence adds to it."""
    sentence = str(row["in_words"])
    return "".join((str(row["verdict"]), *(told for told in QUALIFIED if told in sentence)))


def _closing(found: PopulationFound) -> str:
    """One screen that says what was found."""
    from biaxbayes.identifiability.verdict_names import PRIOR
    from biaxbayes.populations.result import SDS
    from biaxbayes.reports.population import three_digits
    from biaxbayes.reports.words import counted

    def sd(row: dict[Any, Any], side: str) -> str:
        mark = MARK if row[f"{side}_verdict"] == PRIOR else " "
        return f"{three_digits(row[f'{side}_q50']) + mark:>11}"

    said = found.state if found.state == "converged" else f"{found.state.upper()}: {found.reason}"
    lines = [f"{printable(found.name)}: {said}"]
    for group, part in found.groups.groupby("group", sort=False):
        first = part.iloc[0]
        lines += [
            "",
            f"{printable(str(group))}: {counted(first['specimens'], 'specimen')} of "
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
            lines.append(f"{head}{mean}{sds}   {new:<19}{_qualified(r)}")
    lines += ["", "sds of logs where the scale is log (population.csv)"]
    if any((found.groups[f"{side}_verdict"] == PRIOR).any() for side in SDS):
        lines.append(f"{MARK} {PRIOR}: the specimens say little of this sd")
    lines += [f"note: {printable(note)}" for note in found.notes]
    lines += ["", f"all tables and draws are in {found.folder}"]
    return "\n".join(lines)
