"""The main job: a specimen sampled into a run folder, safely."""

from __future__ import annotations

import json
import os
import time
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
        for name, value, least in (("ess", ess, 50), ("max_steps", max_steps, 128)):
            if not value >= least:
                raise InputError(f"--{name.replace('_', '-')} must be at least {least}")
        if not 0 <= seed < 2**63:
            raise InputError("--seed must be a whole number from 0 up")
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
        stop: Callable[[], bool] = lambda: False,
    ) -> Path:
        """Sample, write the run folder, and return its path."""
        tell = progress or (lambda p: None)
        clock = time.perf_counter()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(
                f"{self.folder}: cannot be made ({error.strerror}); choose another --out"
            ) from None
        with folder_lock(self.folder):
            self._refuse_foreign(resume)
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
                steps = draws.chain.shape[1] * draws.thin
                raise Interrupted(
                    f"interrupted after {steps} kept steps, all saved in {self.folder}; "
                    "the same command with --resume continues"
                )
            tell(Progress("writing"))
            draws.seconds["before output"] = time.perf_counter() - clock
            self._write(posterior, draws, clock)
        return self.folder

    def _refuse_foreign(self, resume: bool) -> None:
        """Do not write into a folder that holds something else than a run."""
        names = {p.name for p in self.folder.iterdir() if not p.name.startswith(".")}
        if not names or "provenance.json" in names or checkpoint.NAME in names:
            return
        if resume and not names:
            return
        raise RunError(f"{self.folder}: is a folder that is not a run's; choose another --out")

    def _resumed(
        self, posterior: Posterior, resume: bool, tell: Callable[[Progress], None]
    ) -> State | None:
        if not resume:
            for name in (checkpoint.NAME, checkpoint.PREVIOUS):
                (self.folder / name).unlink(missing_ok=True)
            return None
        state, note = checkpoint.load(self.folder, identity(posterior, self.plan))
        if note:
            tell(Progress(f"note: {note}"))
        return state

    def _write(self, posterior: Posterior, draws: Draws, clock: float) -> None:
        """Every file of the run folder, provenance last: it marks the run as finished."""
        from biaxbayes.output.run_products import write_products

        specimen, folder = self.specimen, self.folder
        record = provenance(posterior, self.plan, draws, self.source)
        (folder / "provenance.json").unlink(missing_ok=True)
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
        atomic_write_text(folder / "provenance.json", _json(record))


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
