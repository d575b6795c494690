"""``biaxbayes laws``: material laws compared by their predictions."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.comparison.law_comparison import (
    WHOLE,
    PredictedReadings,
    Prediction,
    Task,
    left_out_parts,
    sample_part,
)
from biaxbayes.comparison.law_weights import LawComparison, weigh_laws
from biaxbayes.errors import InputError, Interrupted, RunError
from biaxbayes.laws import LAWS, law_named
from biaxbayes.options import (
    MAX_COUNT,
    MAX_INT64,
    SEED_HELP,
    ModelOptions,
    Options,
    option,
    takes_options,
)
from biaxbayes.parallel import executor_for
from biaxbayes.parameters import STRETCH, Quantities
from biaxbayes.progress_bar import Progress, time_left, with_progress
from biaxbayes.runs.checkpoint import DamagedCheckpoint, pack_record, unpack_record
from biaxbayes.runs.folder import claim_folder, record_text, stored_identity
from biaxbayes.runs.provenance import specimen_digest
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tasks import Executor
from biaxbayes.text_files import (
    aligned,
    atomic_write_bytes,
    atomic_write_text,
    read_bytes,
    write_csv,
)
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, SpecimenLike, Stop

RECORD, PARTS = "laws.json", "parts"
SINGLE_LAW_OPTIONS = ("law", "fibre_switch", "priors")


@dataclass(frozen=True)
class LawsPlan(Options):
    """Laws to compare, and how much is sampled for each."""

    laws: Sequence[str] | str | None = option(
        None, "Laws, separated by commas  [all]", metavar="NAME,NAME"
    )
    seed: int = option(1, SEED_HELP, minimum=0, maximum=MAX_INT64)
    ess: float = option(500.0, "Effective draws of each posterior.", minimum=50, maximum=MAX_COUNT)
    max_steps: int = option(20_000, "When to give up.", minimum=128, maximum=MAX_COUNT)


def chosen_laws(named: Sequence[str] | str | None) -> tuple[str, ...]:
    """Laws from a sequence or a text with commas; by default all."""
    parts = named.split(",") if isinstance(named, str) else list(named or ())
    names = [name.strip() for name in parts if name.strip()]
    if named is not None and not names:
        raise InputError(
            "`laws` names no law", remedy=f"laws are {', '.join(LAWS)}; leave it out for all"
        )
    for name in names:
        law_named(name)
    return tuple(name for name in LAWS if not names or name in names)


@with_progress
@takes_options(LawsPlan, ModelOptions, without=SINGLE_LAW_OPTIONS)
def compare_laws(
    specimen: SpecimenLike,
    *,
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    resume: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: OnProgress = inputs.no_progress,
    stop: Stop = inputs.no_stop,
    **options: Any,
) -> LawComparison:
    """Fit and sample every law on a specimen, and weight them by their predictions.

    Each protocol is left out in turn, or each quarter of the only one.

    Parameters
    ----------
    specimen : Specimen or path-like
    out : path-like, optional
        Folder for laws.csv, left-out.csv, stacked-draws.csv, stacked-bands.csv, the figures and
        laws.html.
    mounting_force : (float, float), optional
        For a tared specimen: the force (or stress) at the mounted state, added back.
    resume : bool
        Continue the comparison in the folder.
    workers : int, optional
        Local processes; the result does not depend on them.
    scheduler : str, optional
        Address of a Dask scheduler to use instead.
    progress, stop : callable
    **options
        As in :class:`LawsPlan` and :class:`~biaxbayes.options.ModelOptions`,
        without what belongs to one law.

    Returns
    -------
    LawComparison
    """
    plan, others = LawsPlan.split(options)
    for name in SINGLE_LAW_OPTIONS:
        if others.get(name):
            raise InputError(f"`{name}` belongs to one law", remedy="use sample for that")
    model = ModelOptions.from_values(others).keywords()
    common = {k: v for k, v in model.items() if k not in SINGLE_LAW_OPTIONS}
    laws = chosen_laws(plan.laws)
    specimen = inputs.open_specimen(specimen, mounting_force)
    inputs.refuse_other_tests(specimen, "laws")
    executor = executor_for(workers, scheduler)
    if common["mounting_stretch"] == "per-protocol":
        raise InputError(
            "a protocol with its own mounted state cannot be predicted from the others",
            remedy="leave out `mounting_stretch=per-protocol`",
        )
    if len(laws) < 2:
        raise InputError(
            f"{', '.join(laws)} alone cannot be compared",
            remedy="name at least two laws, or sample one with `law`",
        )
    tasks = []
    for law in laws:
        for part in (None, *left_out_parts(specimen)):
            # The seed of a law and part does not depend on which others are sampled.
            text = f"{law}/{part.name if part else WHOLE}"
            key = int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")
            seed = int(np.random.default_rng([plan.seed, key]).integers(2**62))
            tasks.append(Task(law, specimen, part, common, seed, plan.ess, plan.max_steps))
    if out is None:
        predictions = _sample_parts(tasks, None, executor, progress, stop)
        return weigh_laws(specimen, predictions, laws)
    folder = Path(out)
    with claim_folder(folder, {RECORD}, "a comparison of laws"):
        _record(folder, specimen, common, laws, plan, resume=resume)
        predictions = _sample_parts(tasks, folder / PARTS, executor, progress, stop)
        progress(Progress("weighing"))
        result = weigh_laws(specimen, predictions, laws)
        _write(result, specimen, folder)
    return result


def _record(
    folder: Path,
    specimen: Specimen,
    options: dict[str, Any],
    laws: Sequence[str],
    plan: LawsPlan,
    *,
    resume: bool,
) -> None:
    """Record what the folder compares; refuse one that holds another comparison."""
    identity = {
        "specimen_sha256": specimen_digest(specimen),
        "options": {k: str(v) for k, v in options.items()},
        "laws": list(laws),
        "seed": plan.seed,
        "ess": plan.ess,
        "max_steps": plan.max_steps,
        "biaxbayes": biaxbayes.__version__,
    }
    record = folder / RECORD
    if record.exists() and not resume:
        raise InputError(
            "already holds a comparison of laws",
            file=folder,
            remedy="choose another `out`, or continue it with `resume=True`",
        )
    if record.exists() and stored_identity(record) != identity:
        raise RunError(
            f"{folder}: holds another comparison (specimen, options, laws, seed or version "
            "differ); choose another `out`"
        )
    atomic_write_text(record, record_text({"specimen": specimen.name, "identity": identity}))


def _sample_parts(
    tasks: Sequence[Task], folder: Path | None, executor: Executor, progress: OnProgress, stop: Stop
) -> dict[tuple[str, str], Prediction]:
    """Predictions by law and part, read from the folder or computed and stored there."""
    files = [None if folder is None else folder / f"{i:03d}.npz" for i in range(len(tasks))]
    results = [None if file is None else _read(file) for file in files]
    missing = [i for i, result in enumerate(results) if result is None]
    before = done = len(tasks) - len(missing)
    clock = time.monotonic()
    if missing:
        progress(Progress(f"{done} of {len(tasks)} posteriors; first {tasks[missing[0]].name}"))
    for outcome in executor.run(sample_part, [tasks[i] for i in missing], stop=stop):
        index = missing[outcome.index]
        if outcome.failure:
            raise RunError(f"{tasks[index].name}: {outcome.failure}")
        results[index], file = outcome.value, files[index]
        if file is not None:
            _store(file, outcome.value)
        done += 1
        # one that does not converge takes many times the mean of the others: it is named
        running = [tasks[i].name for i in missing if results[i] is None][:1]
        named = f", {running[0]} is running" if running else ""
        left = time_left(clock, done - before, len(tasks) - done)
        text = f"{done} of {len(tasks)} posteriors{named}{left}"
        progress(Progress(text, done / len(tasks)))
    if done < len(tasks):
        saved = ""
        if folder is not None:
            saved = f", all saved in {folder.parent}; the same command with `resume=True` continues"
        raise Interrupted(f"interrupted after {done} of {len(tasks)} posteriors{saved}", stop())
    return {
        (task.law, task.part.name if task.part else WHOLE): result
        for task, result in zip(tasks, results, strict=True)
        if result is not None
    }


def _store(path: Path, prediction: Prediction) -> None:
    draws = {"draws": prediction.draws.to_numpy(), "columns": list(prediction.draws.columns)}
    readings = {} if prediction.readings is None else vars(prediction.readings)
    path.parent.mkdir(exist_ok=True)
    atomic_write_bytes(path, pack_record(vars(prediction) | draws | {"readings": readings}))


def _read(path: Path) -> Prediction | None:
    """A stored prediction; None if it is missing or damaged and has to be made again."""
    try:
        record = unpack_record(read_bytes(path))
        draws = pd.DataFrame(record["draws"], columns=record.pop("columns"))
        readings = PredictedReadings(**record["readings"]) if record["readings"] else None
        return Prediction(**record | {"readings": readings, "draws": draws})
    except (InputError, DamagedCheckpoint, ValueError, KeyError, TypeError):
        return None


def _write(compared: LawComparison, specimen: Specimen, folder: Path) -> None:
    """Tables, draws and bands of the mixture, figures and the page."""
    from biaxbayes.figures.comparisons import (
        law_bands_figure,
        law_misfit_figure,
        law_mounting_figure,
    )
    from biaxbayes.figures.style import save_pictures
    from biaxbayes.reports.comparison import laws_page

    tables = {
        "laws.csv": compared.table,
        "left-out.csv": compared.parts,
        "stacked-draws.csv": compared.draws,
        "stacked-bands.csv": compared.bands,
    }
    for name, table in tables.items():
        write_csv(folder / name, table, digits=8)
    drawn = {
        "law-misfit": law_misfit_figure(compared),
        "law-mounting": law_mounting_figure(compared),
        "stacked-bands": law_bands_figure(compared, specimen),
    }
    figures = {stem: figure for stem, figure in drawn.items() if figure is not None}
    for stem, figure in figures.items():
        save_pictures(figure, folder, stem)
    atomic_write_text(folder / "laws.html", laws_page(compared, figures))


# --- the command ---------------------------------------------------------------------------------


@click.command("laws")
@opt.argument("specimen")
@opt.options(LawsPlan, "laws")
@opt.file_option("out", "Folder [<stem>-laws].")
@opt.options(
    ModelOptions, *(n for n in opt.MODEL if n not in (*SINGLE_LAW_OPTIONS, "mounting_stretch"))
)
@opt.mounting_force_option()
@opt.options(LawsPlan, "seed", "ess", "max_steps")
@opt.executor_options
@opt.flag("resume", "Continue the comparison in the folder.")
@opt.quiet_option
def command(specimen: Path, out: Path | None, quiet: bool, **given: Any) -> int:
    r"""Fit and sample every material law on SPECIMEN, and compare their predictions.

    Each protocol is left out in turn, or each quarter of the only one, and predicted from the rest.
    Writes laws.csv, left-out.csv, stacked-draws.csv, stacked-bands.csv, three figures and
    laws.html. Exit code 3 when a law has not converged on some part of the record.

    \b
    biaxbayes laws media.csv --laws goh,fung
    """
    folder = out or Path(f"{specimen.stem}-laws")
    with opt.progress_and_stop(quiet) as work:
        result = compare_laws(specimen, out=folder, **work, **given)
    if not quiet:
        _print_laws(result, folder)
    for law, reason in result.left_out.items():
        click.echo(f"biaxbayes: {law} is left out: {reason}", err=True)
    return 0 if result.converged else opt.NOT_CONVERGED


def _print_laws(result: LawComparison, folder: Path) -> None:
    """Print the table, largest weight first, with the mounting stretches."""
    from biaxbayes.reports.comparison import stretch_texts

    stretches = [q for q in Quantities(()).of_kind(STRETCH) if f"{q.name}_q50" in result.table]
    lines = [
        ["", "rms_kPa", "left out", "density", "weight", "(range)", *(q.name for q in stretches)],
        ["", "kPa", "kPa", "nats", "", "", *(["median, 90 %"] * len(stretches))],
    ]
    table = result.table.sort_values("weight", ascending=False, kind="stable", na_position="last")
    for row in (*table.iloc[1:].to_dict("records"), table.iloc[0].to_dict()):
        if pd.isna(row["left_out_rms_kPa"]):
            lines.append([row["law"], *[""] * 5, row["state"]])
            continue
        rms = "" if pd.isna(row["rms_kPa"]) else f"{row['rms_kPa']:.3g}"
        low, high = row["weight_low"], row["weight_high"]
        spread = "" if pd.isna(low) else f"({low:.2f}-{high:.2f})"
        left_out = f"{row['left_out_rms_kPa']:.3g}", f"{row['left_out_density_nats']:.1f}"
        lines.append([row["law"], rms, *left_out, f"{row['weight']:.2f}", spread])
        lines[-1] += [f"{m}, {low} to {high}" for m, low, high in stretch_texts(row)]
    for line in aligned(lines, right=range(1, 6)):
        click.echo(line)
    click.echo(
        "\nrms: error of the fit to all rows; left out: error of predicting the parts left out;\n"
        "density: log predictive density of these, larger is better (2.3 nats more: ten times as\n"
        "probable); weights: shares of the mixture that predicts best (stacking). The mixture\n"
        "predicts stresses; below the tested stretches, and so for the mounting stretch, its\n"
        "weights are untested."
    )
    click.echo(f"\nopen {folder / 'laws.html'}; tables and figures are beside it")
