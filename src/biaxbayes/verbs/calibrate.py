"""``biaxbayes calibrate``: simulation-based calibration on your own protocol."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pandas as pd

import biaxbayes
from biaxbayes.calibration.calibration import (
    RANKED_DRAWS,
    Calibration,
    planned_calibration,
    run_replications,
)
from biaxbayes.calibration.ranks import (
    MIN_REPLICATIONS,
    calibration_table,
    rank_table,
    read_ranks,
    uniformity,
)
from biaxbayes.calibration.simulated_specimen import priors_toml
from biaxbayes.errors import Interrupted, NotConverged
from biaxbayes.figures.simulations import rank_figure
from biaxbayes.figures.style import save_pictures
from biaxbayes.model.priors import prior_value
from biaxbayes.options import CalibrationPlan, InferringOptions, takes_options
from biaxbayes.parallel import executor_for
from biaxbayes.progress_bar import Progress, with_progress
from biaxbayes.report_table import Column, Table
from biaxbayes.runs.folder import claim_folder, refuse_other_work
from biaxbayes.runs.provenance import specimen_digest
from biaxbayes.stored_data import json_text
from biaxbayes.tasks import Executor
from biaxbayes.text_files import atomic_write_text, write_csv
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, SpecimenLike, Stop

SAVE_SECONDS = 5.0
RECORD, RANKS = "calibration.json", "ranks.csv"


@dataclass(frozen=True)
class CalibrationResult:
    """The result of a finished calibration.

    Attributes
    ----------
    table : DataFrame
        As in ``calibration.csv``.
    states : dict of str to int
        Replications by the state of their draws.
    calibrated : bool
    p : float
        p-value of the test that the ranks of all quantities together are uniform.
    """

    table: pd.DataFrame
    states: dict[str, int]
    calibrated: bool
    p: float

    def __repr__(self) -> str:
        states = ", ".join(f"{n} {state}" for state, n in self.states.items())
        return f"CalibrationResult(replications {states}; p of uniform ranks {self.p:.3g})"


def run_calibration(
    calibration: Calibration,
    folder: Path,
    replications: int,
    executor: Executor | None = None,
    *,
    resume: bool = False,
    progress: OnProgress = inputs.no_progress,
    stop: Stop = inputs.no_stop,
) -> CalibrationResult:
    """Run the replications that are missing, and write every file."""
    with claim_folder(folder, RECORD):
        rows = _stored_rows(calibration, folder, resume=resume)
        missing = [i for i in range(replications) if i not in rows]
        if missing:
            progress(Progress("compiling (once; cached for later runs)"))
        saved, done = time.monotonic(), replications - len(missing)
        executor = executor or Executor()
        for i, made in run_replications(calibration, missing, executor, stop=stop):
            rows[i] = made
            done += 1
            progress(Progress(f"replication {done} of {replications}", done / replications))
            if time.monotonic() - saved > SAVE_SECONDS:
                write_csv(folder / RANKS, rank_table(rows))
                saved = time.monotonic()
        write_csv(folder / RANKS, rank_table(rows))
        if done < replications:
            text = f"interrupted after {done} of {replications} replications"
            raise Interrupted(text, stop(), folder=folder)
        progress(Progress("writing"))
        ranks = rank_table(rows)
        ranks = ranks[ranks["replication"] < replications]
        ranked = ranks[ranks["rank"].notna()]
        if ranked.empty:
            reason = str(ranks["reason"].iloc[0]) if len(ranks) else "no replication"
            raise NotConverged(f"no replication could be sampled: {reason}")
        table = calibration_table(ranked, RANKED_DRAWS)
        write_csv(folder / "calibration.csv", table, digits=4)
        save_pictures(rank_figure(ranked, RANKED_DRAWS), folder, "calibration")
    states = ranks.drop_duplicates("replication")["state"].value_counts().to_dict()
    return CalibrationResult(table, {str(k): int(v) for k, v in states.items()}, *uniformity(table))


def _stored_rows(
    calibration: Calibration, folder: Path, *, resume: bool
) -> dict[int, list[dict[str, Any]]]:
    """Rows of the replications already done, by replication; records the calibration."""
    others = {k: v for k, v in vars(calibration.plan).items() if k != "workers"}
    identity = {
        "specimen": calibration.specimen.name,
        "specimen_sha256": specimen_digest(calibration.specimen),
        "options": dict(calibration.options),
        "priors": {name: prior_value(prior) for name, prior in calibration.priors.items()},
        **others,
        "biaxbayes": biaxbayes.__version__,
    }
    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
    rows: dict[int, list[dict[str, Any]]] = {}
    refuse_other_work(folder, RECORD, digest, resume=resume)
    if (folder / RECORD).exists() and (folder / RANKS).exists():
        for row in read_ranks(folder / RANKS).to_dict("records"):
            rows.setdefault(row["replication"], []).append({str(k): v for k, v in row.items()})
    # the ranks first: after a crash the record never stands beside those of another calibration
    write_csv(folder / RANKS, rank_table(rows))
    atomic_write_text(folder / RECORD, json_text({**identity, "identity": digest}))
    priors = priors_toml(calibration.priors, calibration.specimen.unit, calibration.law)
    atomic_write_text(folder / "priors.toml", priors)
    return rows


# --- the verb ------------------------------------------------------------------------------------


@with_progress
@takes_options(CalibrationPlan, InferringOptions)
def calibrate(
    specimen: SpecimenLike,
    *,
    out: PathLike,
    mounting_force: Sequence[float] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    progress: OnProgress = inputs.no_progress,
    stop: Stop = inputs.no_stop,
    **options: Any,
) -> CalibrationResult:
    """Simulation-based calibration on the protocols of a specimen.

    Parameters
    ----------
    specimen : Specimen or path-like
    out : path-like
        Folder of the calibration.
    mounting_force, workers, scheduler, progress, stop : optional
        As in :func:`biaxbayes.sample` and :func:`biaxbayes.batch`.
    resume : bool
        Continue the calibration that the folder holds.
    **options
        As in :class:`~biaxbayes.options.CalibrationPlan` and
        :class:`~biaxbayes.options.InferringOptions`.
    """
    plan, others = CalibrationPlan.split(options)
    model = InferringOptions.from_values(others).keywords()
    executor = executor_for(workers, scheduler)
    data = inputs.open_specimen(specimen, mounting_force)
    work: dict[str, Any] = {"resume": resume, "progress": progress, "stop": stop}
    planned = planned_calibration(data, model, plan)
    return run_calibration(planned, Path(out), plan.replications, executor, **work)


@click.command("calibrate")
@opt.argument("specimen")
@opt.options(CalibrationPlan, "replications")
@opt.executor_options
@opt.options(CalibrationPlan, "source")
@opt.file_option("out", "Folder [<stem>-calibration].")
@opt.options(CalibrationPlan, "seed", "ess")
@opt.flag("resume", "Continue a calibration, or add replications to it.")
@opt.quiet_option
@opt.model_options(InferringOptions)
def command(specimen: Path, out: Path | None, quiet: bool, **given: Any) -> int:
    """Simulation-based calibration on the protocols, dimensions and load noise of SPECIMEN.

    True values are drawn, readings simulated, their posterior sampled as that of a measured
    specimen, and the true values ranked among the draws. A misfit of the law is drawn as well,
    relative to the loads that fit SPECIMEN. Writes ranks.csv, calibration.csv, a figure and the
    priors used. Exit code 3 when the ranks are not uniform.
    """
    given = opt.with_priors(**given)
    folder = out or Path(f"{specimen.stem}-calibration")
    with opt.progress_and_stop(quiet) as work:
        outcome = calibrate(specimen, out=folder, **work, **given)
    if not quiet:
        click.echo(closing_message(folder, outcome))
    return 0 if outcome.calibrated else opt.NOT_CONVERGED


def closing_message(folder: Path, outcome: CalibrationResult) -> str:
    """Uniformity and coverage of each quantity, and the conclusion."""
    total = sum(outcome.states.values())
    columns = [
        Column("parameter", "Parameter"),
        Column("uniformity_p", "Uniform p", format=".3f", number=True),
        Column("inside_band", "In band", number=True),
    ]
    for level in (50, 80, 90, 95):
        holds = f"{level} % interval holds"
        columns.append(Column(f"coverage_{level}", holds, format=".1f %", number=True))
    lines = Table(columns, outcome.table).lines()
    others = ", ".join(f"{v} {k}" for k, v in outcome.states.items() if k != "converged")
    lines.append(f"{total} replications, {others or 'all converged'}")
    if total < MIN_REPLICATIONS and outcome.calibrated:
        lines.append(
            f"{total} replications are too few to tell wrong intervals from right ones; run "
            f"{MIN_REPLICATIONS} or more (--replications, with --resume)"
        )
    else:
        result = "uniform" if outcome.calibrated else "NOT uniform"
        lines.append(f"the ranks of all quantities together are {result} (p = {outcome.p:.3g})")
    lines.append(f"written to {folder}")
    return "\n".join(lines)
