"""The main job: a specimen sampled into a run folder, safely."""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from biaxbayes.errors import InputError, Interrupted, RunError, TaredSpecimen
from biaxbayes.inference import checkpoint
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Draws, Plan, Progress, State, draw
from biaxbayes.output.archive import write_archive
from biaxbayes.output.lock import folder_lock
from biaxbayes.output.provenance import identity, provenance
from biaxbayes.output.staging import (
    PROVENANCE,
    clear_leftovers,
    finish_moving,
    is_run,
    manifest,
    staged,
)
from biaxbayes.output.summary import summarise, write_summary
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen, write_specimen
from biaxbayes.specimens.text_file import atomic_write_text

__all__ = ["Sampling"]


@dataclass
class Sampling:
    """A prepared run: what to sample, how, and where to put it.

    Made by :meth:`prepare`, which checks everything that can be checked before the work.
    """

    specimen: Specimen
    source: str
    folder: Path
    options: dict[str, Any]
    plan: Plan

    @classmethod
    def prepare(
        cls,
        specimen: Specimen | str | Path,
        *,
        out: str | Path | None,
        options: dict[str, Any],
        seed: int,
        ess: float,
        max_steps: int,
        workers: int | None,
    ) -> Sampling:
        """Read the specimen and check the options; arguments as in ``biaxbayes.sample``."""
        if isinstance(specimen, Specimen):
            source, stem = specimen.name, _safe_stem(specimen.name)
        else:
            source, stem = Path(specimen).name, Path(specimen).stem
            specimen = read_specimen(specimen)
        for name, value, least in (("--ess", ess, 50), ("--max-steps", max_steps, 128)):
            if not least <= value < 2**63:
                raise InputError(f"{name} must be a number from {least} to 9e18")
        if not 0 <= seed < 2**63:
            raise InputError("--seed must be a whole number from 0 to 9223372036854775807")
        if workers is None:
            workers = min(os.cpu_count() or 1, 4)
        elif workers < 1:
            raise InputError("--workers must be at least 1")
        specimen, options = _fitting_options(specimen, options, source)
        plan = Plan(ess=ess, max_steps=max_steps, seed=seed, workers=workers)
        return cls(specimen, source, Path(out or f"{stem}-posterior"), options, plan)

    def execute(
        self,
        *,
        resume: bool = False,
        progress: Callable[[Progress], None] | None = None,
        stop: Callable[[], int] = lambda: False,
    ) -> Path:
        """Sample, write the run folder, and return its path."""
        tell = progress or _warn
        clock = time.perf_counter()
        self._make_folder()
        with folder_lock(self.folder):
            clear_leftovers(self.folder)
            finish_moving(self.folder)
            posterior = Posterior(self.specimen, **self.options, seed=self.plan.seed)
            state = self._resumed(posterior, resume, tell)
            draws = draw(
                posterior,
                self.plan,
                state=state,
                on_block=lambda s: checkpoint.save(self.folder, s, identity(posterior, self.plan)),
                progress=tell,
                stop=stop,
            )
            if draws.interrupted:
                raise self._interruption(draws, stop())
            tell(Progress("writing"))
            draws.seconds["before output"] = time.perf_counter() - clock
            self._write(posterior, draws, clock)
        return self.folder

    def _interruption(self, draws: Draws, signal: int) -> Interrupted:
        steps = draws.chain.shape[1] * draws.thin
        done = f"after {steps} kept steps" if steps else "after the warm-up"
        error = Interrupted(
            f"interrupted {done}, all saved in {self.folder}; "
            "the same command with --resume continues"
        )
        if not isinstance(signal, bool):  # the number of a signal (a hang-up is 1)
            error.exit_code = 128 + signal
        return error

    def _make_folder(self) -> None:
        """Make the folder, and do not write into one that holds something else than a run."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = {p.name for p in self.folder.iterdir() if not p.name.startswith(".")}
        except OSError as error:
            raise RunError(
                f"{self.folder}: cannot be used ({error.strerror}); choose another --out"
            ) from None
        ours = not names or names & {checkpoint.NAME, checkpoint.PREVIOUS} or is_run(self.folder)
        if not ours:
            raise RunError(f"{self.folder}: is a folder that is not a run's; choose another --out")

    def _resumed(
        self, posterior: Posterior, resume: bool, tell: Callable[[Progress], None]
    ) -> State | None:
        if not resume:
            return None  # a checkpoint that is there stays until the first one of this run
        state, note = checkpoint.load(self.folder, identity(posterior, self.plan))
        if note:
            tell(Progress("resuming", note=note))
        return state

    def _write(self, posterior: Posterior, draws: Draws, clock: float) -> None:
        """Every file of the run, in place of those of a run before."""
        with staged(self.folder) as folder:
            self._write_files(folder, posterior, draws, clock)

    def _write_files(self, folder: Path, posterior: Posterior, draws: Draws, clock: float) -> None:
        from biaxbayes.output.report.page import write_report
        from biaxbayes.output.run import Run
        from biaxbayes.output.run_products import write_products

        specimen = self.specimen
        record = provenance(posterior, self.plan, draws, self.source)
        write_specimen(specimen, folder / "specimen.csv")
        attributes = {
            "biaxbayes_version": record["biaxbayes"],
            "specimen": specimen.name,
            "settings": json.dumps(record["settings"], sort_keys=True),
            "convergence": draws.convergence.state,
            "beta": posterior.beta,
            "sampling_seed": self.plan.seed,
        }
        write_archive(folder / "posterior.nc", posterior, draws, attributes, self.plan.seed)
        table = summarise(
            draws.quantities, posterior.parameter_names, specimen.unit, draws.convergence
        )
        write_summary(folder / "summary.csv", table)
        atomic_write_text(folder / "fit.json", _json([posterior.start.record()]))
        write_products(folder, posterior, draws)
        record["seconds"]["total"] = round(time.perf_counter() - clock, 3)
        write_report(folder, Run(folder, record))
        record["files"] = manifest(folder)
        atomic_write_text(folder / PROVENANCE, _json(record))


def _warn(progress: Progress) -> None:
    """Where nobody watches the progress, what must be known becomes a warning."""
    if progress.note:
        warnings.warn(progress.note, RuntimeWarning, stacklevel=4)


def _json(value: Any) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=True, default=str) + "\n"


def _safe_stem(name: str) -> str:
    kept = "".join(c if c.isalnum() or c in "-_." else "-" for c in name).strip(".-")
    return kept[:60] or "specimen"


def _fitting_options(
    specimen: Specimen, options: dict[str, Any], source: str
) -> tuple[Specimen, dict[str, Any]]:
    """Options that the specimen allows, or the reason why there are none."""
    infers = options["mounting"] in ("noisy", "exact", "free")
    if infers and specimen.is_tared:
        raise TaredSpecimen(
            "the force at the mounted state is zero: the load cell was tared after mounting, and "
            "prestretch cannot be inferred from this file",
            file=source,
            remedy="state the force before taring with --mounting-force X Y, or take the mounted "
            "state as unloaded with --mounting zeroed",
        )
    if options["mounting"] in ("noisy", "free"):
        shared = options["mounting_stretch"] == "shared"
        _, sd = specimen.mounting_readings(shared=shared)
        if (sd <= 0.0).any():
            note = "the file shows no load noise: the mounting force is taken as exact"
            notes = (*specimen.notes, note)
            specimen = Specimen(
                **{k: getattr(specimen, k) for k in specimen.__dataclass_fields__ if k != "notes"},
                notes=notes,
            )
            options = options | {"mounting": "exact"}
    return specimen, options
