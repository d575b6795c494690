"""``biaxbayes sample``: the joint posterior of a specimen, sampled into a run folder."""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError, Interrupted, TaredSpecimen
from biaxbayes.fitting.fit_quality import swapped_columns
from biaxbayes.grips import correction as grips
from biaxbayes.grips.hooks import stated_hooks
from biaxbayes.laws import law_named
from biaxbayes.model import prior_checks
from biaxbayes.model.draw import as_sampled, draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import fitted
from biaxbayes.options import (
    INDEPENDENT,
    INFERRING_MODES,
    REPORTS,
    ModelOptions,
    SamplingPlan,
    takes_options,
)
from biaxbayes.parameters import STRETCH
from biaxbayes.progress_bar import Progress, with_progress
from biaxbayes.runs import checkpoint
from biaxbayes.runs.archive import draw_table, write_archive
from biaxbayes.runs.folder import PROVENANCE, lock_folder, manifest, piece_files, staged
from biaxbayes.runs.provenance import identity, provenance
from biaxbayes.runs.run import Run, open_run, summarise
from biaxbayes.sampling.sampler import Draws, Plan
from biaxbayes.specimens.check import Finding, check_round_trip, refuse_no_loading_curve
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.stored_data import json_text
from biaxbayes.tasks import process_lock
from biaxbayes.text_files import as_path, atomic_write_text, safe_file_name, write_csv
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, PiecesLike, Stop

if TYPE_CHECKING:
    import pandas as pd

    from biaxbayes.identifiability.identify import Identifiability
    from biaxbayes.runs.run_result import RunResult


@dataclass(frozen=True)
class SampleJob:
    """Checked inputs of one sampling run; ``batch`` checks all before it samples the first."""

    specimen: Specimen
    posterior: Posterior
    source: str
    folder: Path
    options: dict[str, Any]
    plan: Plan
    findings: tuple[Finding, ...] = ()
    correction: grips.GripCorrection | None = None

    @classmethod
    def prepare(
        cls,
        specimen: PiecesLike,
        *,
        out: PathLike | None,
        options: dict[str, Any],
        amount: SamplingPlan,
        mounting_force: Sequence[float] | None = None,
        anyway: bool = False,
    ) -> SampleJob:
        """Read the specimen and check it and the options; arguments as in ``biaxbayes.sample``."""
        first = specimen[0] if isinstance(specimen, list | tuple) and specimen else specimen
        if isinstance(first, Specimen):
            file: object = first.name
            source, stem = first.name, safe_file_name(first.name, "specimen")
            for piece in first.pieces:
                check_round_trip(piece, piece.name)
        else:
            file = as_path(first, "specimen")
            source, stem = file.name, file.stem
        specimen = inputs.open_specimen(specimen, mounting_force)
        options = ModelOptions.from_values(options).keywords()
        findings = refuse_no_loading_curve(specimen, None if anyway else file)
        law, count = law_named(options["law"]), len(specimen.protocols)
        if count < law.least_protocols:
            text = (
                f"with {count} protocol the posterior of the law {law.name} has several modes of "
                "similar mass: sampling takes long, and the chains may not converge. Test another "
                "ratio, or choose another law"
            )
            findings = (*findings, Finding("few-protocols", "warning", text))
        specimen, options = _resolve_mounting(specimen, options, file)
        if specimen.needs_grip_correction:
            grips.refuse_other_law(law.name, file)
            stated_hooks(specimen)
        if hooked := [p.name for p in specimen.further if p.needs_grip_correction]:
            problem = "the loads of a further piece are not corrected for its hooks"
            remedy = "sample it alone, and give specimen.csv of that run, which is corrected"
            raise InputError(problem, file=hooked[0], remedy=remedy)
        # refuses options before a folder is made
        posterior = Posterior(grips.mark_grip_corrected(specimen), **options)
        plan = Plan(**amount.keywords())
        folder = Path(out or f"{stem}-posterior")
        return cls(specimen, posterior, source, folder, options, plan, findings)

    def run(
        self,
        *,
        resume: bool = False,
        overwrite: bool = False,
        progress: OnProgress | None = None,
        stop: Stop = inputs.no_stop,
    ) -> Path:
        """Sample, write the run folder, and return its path."""
        progress = progress or _warn
        start = time.perf_counter()
        with lock_folder(self.folder, PROVENANCE, resume=resume, overwrite=overwrite):
            progress(Progress("fitting"))
            _show(self.findings, progress)
            fit_start = time.perf_counter()
            job = self._corrected_for_grips(progress)
            posterior = fitted(job.posterior, self.plan.seed)
            law = {n: getattr(posterior.settings, n) for n in ("law", "fibre_switch")}
            swapped = swapped_columns(posterior.specimen, posterior.fit.residuals, **law)
            findings = [
                *([swapped] if swapped else []),
                *prior_checks.unused_prior_findings(posterior),
                *prior_checks.radian_findings(posterior),
                *prior_checks.prior_findings(posterior),
            ]
            _show(findings, progress)
            fit_seconds = time.perf_counter() - fit_start
            draws = self._draw(posterior, resume, fit_seconds, progress, stop)
            posterior = as_sampled(posterior, draws.target.constants)
            names = [q.name for q in posterior.quantities.of_kind(STRETCH)]
            stretches = {n: draws.quantities[n] for n in names if n in draws.quantities}
            bracket = prior_checks.bracket_findings(stretches)
            _show(bracket, progress, "sampling")
            progress(Progress("writing"))
            draws.seconds["before output"] = time.perf_counter() - start
            # All files are replaced together.
            with staged(self.folder, progress=progress) as folder:
                findings = [*self.findings, *findings, *bracket]
                job._write_files(folder, posterior, draws, findings, start)
        return self.folder

    def _draw(
        self,
        posterior: Posterior,
        resume: bool,
        fit_seconds: float,
        progress: OnProgress,
        stop: Stop,
    ) -> Draws:
        """Draw from the posterior, from a checkpoint if there is one and ``resume``."""
        run_identity = identity(posterior, self.plan)
        stored = None  # an old checkpoint stays until the first new one is written
        if resume:
            stored, note = checkpoint.load(self.folder, run_identity)
            if note:
                progress(Progress("resuming", note=note))
        draws = draw_posterior(
            posterior,
            self.plan,
            state=stored,
            on_block=lambda s: checkpoint.save(self.folder, s, run_identity),
            progress=progress,
            stop=stop,
        )
        if draws.interrupted:
            steps = draws.chain.shape[1] * draws.thin
            done = f"after {steps} steps" if steps else "after the warm-up"
            raise Interrupted(f"interrupted {done}", stop(), folder=self.folder)
        progress(Progress("sampling", 1.0))
        if stored is None:
            draws.seconds["fit"] += fit_seconds
        return draws

    def _corrected_for_grips(self, progress: OnProgress) -> SampleJob:
        """The job with loads corrected to those of a uniform test, where they need it."""
        if not self.specimen.needs_grip_correction:
            return self
        progress(Progress("correcting for the grips"))
        correction = grips.correct_for_grips(
            self.specimen,
            lambda data: Posterior(data, **self.options).least_squares(self.plan.seed),
        )
        specimen = correction.specimen
        posterior = Posterior(specimen, **self.options)
        return replace(self, specimen=specimen, posterior=posterior, correction=correction)

    def _write_files(
        self,
        folder: Path,
        posterior: Posterior,
        draws: Draws,
        findings: Sequence[Finding],
        start: float,
    ) -> None:
        """Write every file of the run, its provenance last."""
        from biaxbayes.figures.mounting import grips_figure
        from biaxbayes.figures.style import save_pictures
        from biaxbayes.identifiability.identify import identify_run
        from biaxbayes.reports.run_page import report_page
        from biaxbayes.runs.run_result import run_result, write_result

        specimen, status = self.specimen, draws.convergence.state
        record = provenance(posterior, self.plan, draws, self.source)
        names = piece_files(len(specimen.pieces))
        for name, piece in zip(names, specimen.pieces, strict=True):
            write_specimen(piece, folder / name)
        if self.correction is not None:
            sd_log_ratio = self.correction.sd_log_ratio(draws.quantities, posterior.forward)
            ratios = self.correction.table(sd_log_ratio)
            record["grips"], found = grips.grip_record(self.correction, ratios)
            findings = (*findings, *found)
            write_csv(folder / "grips.csv", ratios, digits=8)
            save_pictures(grips_figure(specimen, ratios), folder, "grips")
        record["findings"] = [asdict(finding) for finding in findings]
        attributes = {
            "biaxbayes_version": record["biaxbayes"],
            "specimen": specimen.name,
            "settings": json.dumps(record["settings"], sort_keys=True),
            "convergence": status,
            "sampling_seed": self.plan.seed,
        }
        write_archive(folder / "posterior.nc", posterior, draws, attributes, self.plan.seed)
        parameters, known = posterior.parameter_names, posterior.quantities
        summary = summarise(draws.quantities, parameters, known, draws.convergence)
        atomic_write_text(folder / "fit.json", json_text([posterior.fit.record()]))
        write_csv(folder / "summary.csv", summary, digits=8)
        table = draw_table(draws.quantities)
        run = Run(folder, record).with_draws(table)
        verdicts = identify_run(posterior, table, status)
        convergence = record["convergence"]
        result = run_result(verdicts, posterior, table, summary, convergence, run.findings)
        write_result(result, folder)
        write_figures(folder, posterior, draws, table, verdicts, result)
        record["seconds"]["total"] = round(time.perf_counter() - start, 3)
        atomic_write_text(folder / REPORTS["html"], report_page(run))
        record["files"] = manifest(folder)
        atomic_write_text(folder / PROVENANCE, json_text(record))


def write_figures(
    folder: Path,
    posterior: Posterior,
    draws: Draws,
    table: pd.DataFrame,
    verdicts: Identifiability,
    result: RunResult,
) -> None:
    """Write the figures; of unusable draws only the traces."""
    from biaxbayes.figures.bands import bands_figure
    from biaxbayes.figures.corner import corner_figure
    from biaxbayes.figures.identifiability import identifiability_figure
    from biaxbayes.figures.style import save_pictures
    from biaxbayes.figures.trace import trace_figure

    specimen, known = posterior.specimen, posterior.quantities
    if result.state != "converged":
        trace = trace_figure(draws.quantities, unit=specimen.unit, known=known)
        save_pictures(trace, folder, "trace")
    if result.state == "unusable":
        return
    how: dict[str, Any] = {"law": posterior.law.short_name, "reported": [result.reported]}
    save_pictures(corner_figure(table, known=known, **how), folder, "corner")
    for i in range(len(posterior.pieces)):
        stem = "stress-bands" if i == 0 else f"stress-bands-{i + 1}"
        save_pictures(bands_figure(posterior, table, piece=i), folder, stem)
    save_pictures(identifiability_figure(verdicts, result.reported), folder, "identifiability")


def _show(findings: Sequence[Finding], progress: OnProgress, phase: str = "fitting") -> None:
    for finding in findings:
        progress(Progress(phase, note=str(finding)))


def _warn(progress: Progress) -> None:
    """Without a progress callback, notes are issued as warnings."""
    if progress.note:
        # past this package, and NumPy, whose error state wraps every verb
        frame, level = sys._getframe(), 1
        while frame.f_back and frame.f_globals["__name__"].startswith(("biaxbayes.", "numpy.")):
            frame, level = frame.f_back, level + 1
        warnings.warn(progress.note, RuntimeWarning, stacklevel=level)


def _resolve_mounting(
    specimen: Specimen, options: dict[str, Any], file: object
) -> tuple[Specimen, dict[str, Any]]:
    """Refuse a tared specimen; independent errors without load noise have an exact force."""
    tared = next((p.name for p in specimen.pieces if p.is_tared), None)
    if options["mounting"] in INFERRING_MODES and tared is not None:
        raise TaredSpecimen(
            "the force at the mounted state is zero: the load cell was tared after mounting, and "
            "prestretch cannot be inferred from this file",
            file=tared if specimen.further else file,
            remedy="state the force before taring with `mounting_force=(X, Y)`, or take the "
            "mounted state as unloaded with `mounting=zeroed`",
        )
    if options["mounting"] == "noisy" and options["noise"] == INDEPENDENT:
        shared = options["mounting_stretch"] == "shared"
        sds = [
            piece.mounting_readings(shared=shared)[1][:, list(piece.experiment.axes)]
            for piece in specimen.pieces
        ]
        if any((sd <= 0.0).any() for sd in sds):
            note = "the file shows no load noise: the mounting force is taken as exact"
            specimen = replace(specimen, notes=(*specimen.notes, note))
            options = options | {"mounting": "exact"}
    return specimen, options


@with_progress
@takes_options(SamplingPlan, ModelOptions)
def sample(
    specimen: PiecesLike,
    *,
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    anyway: bool = False,
    resume: bool = False,
    overwrite: bool = False,
    progress: OnProgress | None = None,
    stop: Stop = inputs.no_stop,
    **options: Any,
) -> Run:
    """Sample the posterior of a tissue into a run folder.

    Parameters
    ----------
    specimen : Specimen, path-like or list of them
        A specimen, or the CSV to read it from; several are pieces of one tissue, each with its own
        mounted state, misfit and stiffness (see ``piece_sd``).
    out : path-like, optional
        The run folder; default ``<stem>-posterior`` in the current directory.
    mounting_force : (float, float), optional
        For a tared file: the force (or stress) at the mounted state, added back.
    anyway : bool
        Sample even if the data do not look like a loading curve (see ``biaxbayes check``).
    resume : bool
        Continue from the folder's checkpoint where there is one.
    overwrite : bool
        Replace a finished run and everything derived from it.
    progress : callable or bool, optional
        Called with each step; True or False shows a line or none, by default on a terminal and
        in a notebook.
    stop : callable, optional
        As in :func:`biaxbayes.sampling.sampler.draw`.
    **options
        As in :class:`~biaxbayes.options.SamplingPlan` and
        :class:`~biaxbayes.options.ModelOptions`.

    Returns
    -------
    Run
        Also where it has not converged: check ``run.state``.

    Raises
    ------
    InputError
        If the specimen or an option cannot be used, or its record cannot be a loading curve.
    TaredSpecimen
        If the mounting force was zeroed and the mounting stretch is to be inferred.
    RunError
        If the folder is in use, cannot be written, or holds a finished run or a checkpoint of
        something else.
    """
    amount, model = SamplingPlan.split(options)
    how: dict[str, Any] = {"options": model, "amount": amount, "mounting_force": mounting_force}
    with process_lock:
        job = SampleJob.prepare(specimen, out=out, anyway=anyway, **how)
        return open_run(job.run(resume=resume, overwrite=overwrite, progress=progress, stop=stop))


# --- the command ---------------------------------------------------------------------------------


@click.command("sample")
@opt.argument("specimen", metavar="CSV...", nargs=-1, required=True)
@opt.file_option("out", "Run folder [<stem>-posterior].")
@opt.options(SamplingPlan, "seed")
@opt.model_options()
@opt.options(SamplingPlan, "ess", "max_steps", "workers")
@opt.anyway_option
@opt.resume_option
@opt.overwrite_option("run")
@opt.quiet_option
def command(specimen: tuple[Path, ...], quiet: bool, **given: Any) -> int:
    """Joint posterior of material parameters and mounting stretches of a specimen.

    Several CSV are pieces of one tissue: a square and strips cut beside it, for example.

    Writes a run folder with the draws, tables, figures and verdicts. Exit code 0 when the
    posterior has converged, 3 when the chains did not converge, 2 when the input cannot be used.
    """
    from biaxbayes.reports.methods import closing_message

    given = opt.with_priors(**given)
    with opt.progress_and_stop(quiet) as work:
        run = sample(list(specimen), **work, **given)
    if not quiet:
        click.echo(closing_message(run))
    elif run.state != "converged":
        click.echo(f"biaxbayes: {run.provenance['convergence']['reason']}", err=True)
    return 0 if run.state == "converged" else opt.NOT_CONVERGED
