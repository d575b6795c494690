"""``biaxbayes sample``, ``batch``, ``fit`` and ``calibrate``: what begins with specimens."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.cli.options import (
    MODEL,
    any_record_option,
    argument,
    executor_options,
    file_option,
    fix_option,
    fixed_values,
    model_options,
    mounting_force_option,
    options,
    overwrite_option,
    quiet_option,
    read_model_options,
    refuse_given,
)
from biaxbayes.errors import InputError, NotConverged, printable
from biaxbayes.options import (
    ALL_FITS,
    FIT_METHODS,
    FIT_WORDS,
    WHICH_FIT,
    CalibrationPlan,
    FitOptions,
    InferringOptions,
    SamplingPlan,
)
from biaxbayes.progress_bar import graceful_stop, progress_line

if TYPE_CHECKING:
    from rich.table import Table

    from biaxbayes.fitting.result import FitResult
    from biaxbayes.jobs.calibrate import Outcome
    from biaxbayes.laws.law import Law
    from biaxbayes.parameters import Parameter
    from biaxbayes.specimens.specimen import Specimen
    from biaxbayes.studies.result import StudyResult

__all__ = ["batch", "calibrate", "fit", "sample"]

NOT_CONVERGED = NotConverged.exit_code


# --- sample: the main job ------------------------------------------------------------------------


@click.command("sample")
@argument("specimen")
@file_option("out", "Run folder [<stem>-posterior].")
@options(SamplingPlan, "seed")
@model_options()
@options(SamplingPlan, "ess", "max_steps", "workers")
@any_record_option
@click.option("--resume", is_flag=True, help="Continue from the folder's checkpoint.")
@overwrite_option("run")
@quiet_option
def sample(
    specimen: Path,
    out: Path | None,
    seed: int,
    mounting_force: tuple[float, float] | None,
    ess: float,
    max_steps: int,
    workers: int | None,
    anyway: bool,
    resume: bool,
    overwrite: bool,
    quiet: bool,
    **model: Any,
) -> int:
    """Joint posterior of material parameters and mounting stretches of SPECIMEN (a CSV).

    Writes a run folder with the draws, tables, figures and verdicts. Exit code 0 when the
    posterior has converged, 3 when the chains did not converge, 2 when the input cannot be used.
    """
    chosen = read_model_options(**model)
    from biaxbayes import api

    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        run = api.sample(
            specimen,
            out=out,
            mounting_force=mounting_force,
            anyway=anyway,
            resume=resume,
            overwrite=overwrite,
            progress=tell,
            stop=stop,
            seed=seed,
            ess=ess,
            max_steps=max_steps,
            workers=workers,
            **chosen,
        )
    if not quiet:
        from biaxbayes.reports.facts import closing_message

        click.echo(closing_message(run))
    elif run.state != "converged":
        click.echo(f"biaxbayes: {run.provenance['convergence']['reason']}", err=True)
    return 0 if run.state == "converged" else NOT_CONVERGED


# --- batch: a whole study ------------------------------------------------------------------------


IN_FILE = {
    **dict.fromkeys(("seed", "ess", "max_steps", "anyway"), "{}"),
    **dict.fromkeys(MODEL, "options"),
    **dict.fromkeys(("fix", "priors"), "priors"),
    "mounting_force": "{}",
}
"""Where a study file states what is an option for CSV files; {} is the option's own name."""


@click.command("batch")
@argument("sources", metavar="STUDY.toml|CSV...", nargs=-1, required=True)
@executor_options
@file_option("out", "Study folder [<stem>-study].")
@options(SamplingPlan, "seed")
@model_options()
@options(SamplingPlan, "ess", "max_steps")
@any_record_option
@quiet_option
@click.pass_context
def batch(
    context: click.Context,
    sources: tuple[Path, ...],
    workers: int | None,
    scheduler: str | None,
    out: Path | None,
    seed: int,
    mounting_force: tuple[float, float] | None,
    ess: float,
    max_steps: int,
    anyway: bool,
    quiet: bool,
    **model: Any,
) -> int:
    r"""Sample many specimens: those of a study file, or the CSV files given.

    Writes a study folder: study.csv with a row for each specimen and quantity, summaries across
    layers and donors, study.html with the layers compared, and in runs/ a run folder of each
    specimen. The same command again does what is missing: a finished specimen is not sampled
    again, an interrupted one continues. A specimen that fails does not stop the others. Exit
    code 0 when every specimen has converged, 3 when one has not or has failed, 2 when nothing
    could be begun: a file is missing, a study file, an option or a folder cannot be used.

    \b
    biaxbayes batch study.toml --workers 4
    biaxbayes batch study.toml --scheduler tcp://head:8786
    biaxbayes batch *.csv --out aortas --noise independent
    """
    chosen: dict[str, Any] = {}
    study: Any = sources[0]
    if _is_study(sources[0]) and len(sources) == 1:
        for name, key in IN_FILE.items():
            refuse_given(
                context,
                (name,),
                "{} is for CSV files",
                file=study,
                remedy=f"state it in the study file, under {key.format(name)}",
            )
    else:
        _check_csvs(sources, mounting_force)
        study = sources
        numbers = {"seed": seed, "ess": ess, "max_steps": max_steps, "anyway": anyway}
        chosen = read_model_options(**model) | numbers
    from biaxbayes.jobs.batch import batch as batch_verb

    folder = out or Path(f"{sources[0].stem}-study" if len(sources) == 1 else "study")
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        result = batch_verb(
            study,
            out=folder,
            workers=workers,
            scheduler=scheduler,
            progress=tell,
            stop=stop,
            **chosen,
        )
    if not quiet:
        click.echo(_study_closing(result))
    for label, reason in result.failures.items():
        click.echo(f"biaxbayes: {printable(label)}: {printable(reason)}", err=True)
    return 0 if result.converged else NOT_CONVERGED


def _is_study(path: Path) -> bool:
    return path.suffix.lower() == ".toml"


def _check_csvs(sources: tuple[Path, ...], mounting_force: object) -> None:
    if mounting_force is not None:
        raise InputError(
            "--mounting-force is that of one specimen",
            remedy="state mounting_force for each in a study file",
        )
    for path in sources:
        if _is_study(path):
            raise InputError(
                "a study file stands alone", file=path, remedy="list all specimens in it"
            )


def _study_closing(result: StudyResult) -> str:
    lines = [f"{'specimen':<28}{'donor':<12}{'layer':<14}state"]
    for s in result.specimens.to_dict("records"):
        cells = [
            printable(str(s[k]))[: n - 2]
            for k, n in (("specimen", 28), ("donor", 12), ("layer", 14))
        ]
        lines.append(f"{cells[0]:<28}{cells[1]:<12}{cells[2]:<14}{s['state']}")
    counts = ", ".join(f"{n} {state}" for state, n in result.states.items())
    lines += ["", f"{len(result.specimens)} specimens: {counts}"]
    lines.append(f"open {result.folder / 'study.html'}; all numbers are in study.csv beside it")
    return "\n".join(lines)


# --- fit: deterministic fits side by side --------------------------------------------------------


STRETCHES = ("mounting_stretch_x", "mounting_stretch_y")
COARSE = {"deg": "{:.2f}", "1": "{:.4f}"}
"""Formats of what is no scale: of angles, and of shares and stretches."""
AFTER = (
    *((name.replace("_", " "), "", name, "{:.4f}") for name in STRETCHES),
    ("R2", "", "r2", "{:.5f}"),
    ("RMSE", "kPa", "rmse_kPa", "{:.4g}"),
    ("iterations", "", "iterations", "{:d}"),
)


def _fit_rows(law: Law) -> list[tuple[str, str, str, str]]:
    """Label, unit, key of the record and format of each row of the table of fits."""
    of_law = [
        (p.name, "" if p.unit == "1" else p.unit, p.label, _format(p)) for p in law.parameters
    ]
    return [*of_law, *AFTER]


def _format(parameter: Parameter) -> str:
    return "{:.4g}" if parameter.logarithmic else COARSE[parameter.unit]


@click.command("fit")
@argument("specimen")
@click.option(
    "--method",
    type=click.Choice([*FIT_METHODS, ALL_FITS]),
    default=ALL_FITS,
    show_default=True,
    help="; ".join(f"{name} {words}" for name, words in FIT_WORDS.items()) + ".",
)
@click.option("--json", "as_json", is_flag=True, help="A list of objects instead of the table.")
@fix_option("Hold a parameter, e.g. kappa=0.")
@options(FitOptions, "mounting_stretch")
@mounting_force_option(
    "Force (N, or stress in kPa) at the mounted state of a tared file, known from elsewhere."
)
@options(FitOptions, "starts", "seed", "law", "fibre_switch")
@file_option("out", "Folder for fits.csv and a figure of the fits over the data.", "DIR")
def fit(
    specimen: Path,
    method: str,
    as_json: bool,
    fix: tuple[str, ...],
    mounting_force: tuple[float, float] | None,
    out: Path | None,
    **how: Any,
) -> int:
    """Fit the material by least squares, with and without the mounting stretch.

    With --out the table goes into fits.csv, the fits over the data into fits.pdf and fits.png.
    """
    from biaxbayes import api
    from biaxbayes.identifiability.mounting_stretch.toe import poor_fit
    from biaxbayes.jobs.opening import opened_specimen
    from biaxbayes.laws import law_named

    fixed = fixed_values(fix, law_named(how["law"], fibre_switch=how["fibre_switch"]))
    data = opened_specimen(specimen, mounting_force)
    if method == ALL_FITS:
        fits = api.fit_all(data, fixed=fixed, out=out, **how)
    else:
        found = api.fit(data, method, fixed=fixed, out=out, **how)
        fits = found if isinstance(found, list) else [found]
    if as_json:
        import json

        click.echo(json.dumps([found.record() for found in fits], indent=2, allow_nan=False))
    else:
        _print_table(data, fits, fixed)
    if out is not None and not as_json:
        click.echo(f"{out / 'fits.csv'}, {out / 'fits.pdf'}")
    if method == ALL_FITS and data.is_tared:
        click.echo(
            "note: the force at the mounted state is zero (a tared load cell), so fip, linden and "
            "constrained cannot infer prestretch; give it with --mounting-force X Y",
            err=True,
        )
    if poor := poor_fit(data, fits):
        click.echo(f"warning: {poor}", err=True)
    missed = [found.method for found in fits if not found.converged]
    if missed:
        click.echo(f"not converged: {', '.join(missed)}", err=True)
    return NOT_CONVERGED if missed else 0


def _print_table(specimen: Specimen, fits: list[FitResult], fixed: dict[str, float]) -> None:
    from rich.console import Console

    console = Console(highlight=False)
    for note in specimen.notes:
        console.print(f"note: {note}", markup=False)
    console.print(_table(specimen, fits, fixed))
    if any(found.at_bound for found in fits):
        console.print("* ended on a bound", markup=False)
    if fixed:
        console.print("= held", markup=False)
    for found in fits:
        console.print(f"{found.method}: {FIT_WORDS[found.method]}", markup=False)
    console.print(WHICH_FIT, markup=False)
    if any(found.method in ("standard", "zeroed") for found in fits):
        console.print(
            "standard and zeroed fit their own data; R2 does not tell how far they are from the "
            "tissue.",
            markup=False,
        )


def _table(specimen: Specimen, fits: list[FitResult], fixed: dict[str, float]) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(specimen.name), box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False
    )
    table.add_column("", no_wrap=True)
    for found in fits:
        table.add_column(found.method, justify="right", no_wrap=True)
    records = [found.record() for found in fits]
    for label, unit, key, form in _fit_rows(fits[0].material.law):
        cells = []
        for found, record in zip(fits, records, strict=True):
            value = record[key]
            values = value if isinstance(value, list) else [value]
            shown = [_shown(value, form) for value in values]
            mark = "*" if label in found.at_bound else "=" if label in fixed else ""
            if key in STRETCHES and found.method in ("standard", "zeroed"):
                shown = ["-"]
            cells.append("\n".join(shown) + mark)
        table.add_row(f"{label} {unit}".rstrip(), *cells)
    table.add_row("converged", *("yes" if found.converged else "NO" for found in fits))
    return table


def _shown(value: object, form: str) -> str:
    return "-" if value is None else form.format(value)


# --- calibrate: whether the intervals are right on this protocol and noise -----------------------


@click.command("calibrate")
@argument("specimen")
@options(CalibrationPlan, "replications")
@executor_options
@options(CalibrationPlan, "source")
@file_option("out", "Folder [<stem>-calibration].")
@options(CalibrationPlan, "seed", "ess")
@click.option("--resume", is_flag=True, help="Continue, or add replications to, a study.")
@quiet_option
@options(CalibrationPlan, "broken", broken={"hidden": True})
@model_options(InferringOptions)
def calibrate(
    specimen: Path,
    workers: int | None,
    scheduler: str | None,
    out: Path | None,
    resume: bool,
    quiet: bool,
    replications: int,
    source: str,
    seed: int,
    ess: float,
    broken: str,
    mounting_force: tuple[float, float] | None,
    **model: Any,
) -> int:
    """Simulation-based calibration on the protocols, dimensions and load noise of SPECIMEN.

    True values are drawn, readings simulated and sampled as a measured specimen's are, and
    the true values ranked among the draws. Writes ranks.csv, calibration.csv, a figure and the
    priors used. With independent noise the ranks must be uniform; with effective noise, whose
    weight is estimated from each record, the coverage is reported. Exit code 3 when the ranks
    are not uniform.
    """
    chosen = read_model_options(**model)
    from biaxbayes import api

    folder = out or Path(f"{specimen.stem}-calibration")
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        outcome = api.calibrate(
            specimen,
            out=folder,
            mounting_force=mounting_force,
            workers=workers,
            scheduler=scheduler,
            resume=resume,
            progress=tell,
            stop=stop,
            replications=replications,
            source=source,
            seed=seed,
            ess=ess,
            broken=broken,
            **chosen,
        )
    tested = chosen["noise"] == "independent"
    if not quiet:
        click.echo(_calibration_closing(folder, outcome, tested))
    return NOT_CONVERGED if tested and not outcome.calibrated else 0


def _calibration_closing(folder: Path, outcome: Outcome, tested: bool) -> str:
    from biaxbayes.calibration.ranks import FEWEST

    total = sum(outcome.states.values())
    lines = [f"{'':18s} {'uniform p':>9s} {'in band':>8s}   coverage of 50, 80, 90, 95 %"]
    for row in outcome.table.to_dict("records"):
        shares = "  ".join(f"{100 * row[f'coverage_{level}']:5.1f}" for level in (50, 80, 90, 95))
        lines.append(
            f"{row['parameter']:18s} {row['uniformity_p']:9.3f} {row['inside_band']:>8s}   {shares}"
        )
    doubtful = {k: v for k, v in outcome.states.items() if k != "converged"}
    lines.append(
        f"{total} replications, "
        + (", ".join(f"{v} {k}" for k, v in doubtful.items()) if doubtful else "all converged")
    )
    if total < FEWEST and (outcome.calibrated or not tested):
        lines.append(
            f"nothing follows from {total} replications: wrong intervals would look like this; "
            f"run {FEWEST} or more (--replications, with --resume)"
        )
    elif tested:
        said = "uniform" if outcome.calibrated else "NOT uniform"
        lines.append(f"the ranks of all quantities together are {said} (p = {outcome.p:.3g})")
    else:
        lines.append(
            "the weight of the likelihood is estimated from each record: uniform ranks are not "
            "promised, coverage is what counts"
        )
    lines.append(f"written to {folder}")
    return "\n".join(lines)
