"""A calibration study in a folder: resumable, with its table and figure."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

import biaxbayes
from biaxbayes.errors import Interrupted, NotConverged, RunError
from biaxbayes.executors.executor import Executor, InThisProcess
from biaxbayes.findings.calibration import RANKED_DRAWS, Replication, Study
from biaxbayes.findings.calibration_table import calibration_table, verdict
from biaxbayes.findings.replications import run_replications
from biaxbayes.findings.study_prior import prior_value, priors_toml
from biaxbayes.inference.sampler import Progress
from biaxbayes.output.figures.calibration import rank_figure
from biaxbayes.output.lock import folder_lock
from biaxbayes.output.provenance import specimen_digest
from biaxbayes.output.style import save_figure
from biaxbayes.specimens.text_file import atomic_write_text

__all__ = ["CalibrationStudy", "read_ranks"]

SAVE_SECONDS = 5.0
COLUMNS = (
    "replication",
    "parameter",
    "unit",
    "truth",
    "rank",
    "below",
    "median",
    "sd",
    "state",
    "reason",
    "worst_ess",
    "worst_rhat",
    "beta",
    "rejected_draws",
    "seconds",
)
TEXT = ("parameter", "unit", "state", "reason")


@dataclass(frozen=True)
class Outcome:
    """What a finished study found.

    Attributes
    ----------
    table : DataFrame
        As in ``calibration.csv``.
    states : dict of str to int
        Replications by the state of their draws.
    calibrated : bool
    p : float
        Of uniform ranks of all quantities together.
    """

    table: pd.DataFrame
    states: dict[str, int]
    calibrated: bool
    p: float


@dataclass
class CalibrationStudy:
    """A study and the folder it is kept in."""

    study: Study
    folder: Path
    replications: int
    executor: Executor = field(default_factory=InThisProcess)

    def execute(
        self,
        *,
        resume: bool = False,
        progress: Callable[[Progress], None] = lambda p: None,
        stop: Callable[[], object] = lambda: False,
    ) -> Outcome:
        """Run the replications that are missing, and write every file.

        Raises
        ------
        RunError
            If the folder is in use or holds something else.
        Interrupted
            If stopped; what was done is saved.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(
                f"{self.folder}: cannot be made ({error.strerror}); choose another --out"
            ) from None
        with folder_lock(self.folder):
            rows = self._start(resume)
            self._run(rows, progress, stop)
            progress(Progress("writing"))
            return self._finish(rows)

    def _start(self, resume: bool) -> dict[int, list[dict[str, Any]]]:
        """Rows of the replications already done, by replication."""
        stored, ranks = self.folder / "study.json", self.folder / "ranks.csv"
        names = {p.name for p in self.folder.iterdir() if not p.name.startswith(".")}
        if names and "study.json" not in names:
            raise RunError(
                f"{self.folder}: is a folder that is not a study's; choose another --out"
            )
        identity = study_identity(self.study)
        rows: dict[int, list[dict[str, Any]]] = {}
        if resume and stored.exists() and ranks.exists():
            if _read_identity(stored) != _digest(identity):
                raise RunError(
                    f"{self.folder}: holds another study (specimen, options, priors, seed or "
                    "version differ); choose another --out, or leave out --resume"
                )
            for row in read_ranks(ranks).to_dict("records"):
                named = {str(key): value for key, value in row.items()}
                rows.setdefault(int(named["replication"]), []).append(named)
        record = {**identity, "identity": _digest(identity)}
        atomic_write_text(stored, json.dumps(record, indent=2) + "\n")
        atomic_write_text(
            self.folder / "priors.toml",
            priors_toml(self.study.priors, self.study.specimen.unit),
        )
        if not rows:
            _write_ranks(ranks, rows)
        return rows

    def _run(
        self,
        rows: dict[int, list[dict[str, Any]]],
        progress: Callable[[Progress], None],
        stop: Callable[[], object],
    ) -> None:
        missing = [i for i in range(self.replications) if i not in rows]
        if not missing:
            return
        progress(Progress("compiling (once; cached for later runs)"))
        saved = time.monotonic()
        done = self.replications - len(missing)
        for replication in run_replications(self.study, missing, executor=self.executor, stop=stop):
            rows[replication.index] = rows_of(replication, self.study.specimen.unit)
            done += 1
            progress(
                Progress(f"replication {done} of {self.replications}", done / self.replications)
            )
            if time.monotonic() - saved > SAVE_SECONDS:
                _write_ranks(self.folder / "ranks.csv", rows)
                saved = time.monotonic()
        _write_ranks(self.folder / "ranks.csv", rows)
        if done < self.replications:
            raise Interrupted(
                f"interrupted after {done} of {self.replications} replications, all saved in "
                f"{self.folder}; the same command with --resume continues"
            )

    def _finish(self, rows: dict[int, list[dict[str, Any]]]) -> Outcome:
        ranks = _frame(rows)
        ranks = ranks[ranks["replication"] < self.replications]
        states = ranks.drop_duplicates("replication")["state"].value_counts().to_dict()
        ranked = ranks[ranks["rank"].notna()]
        if ranked.empty:
            reason = str(ranks["reason"].iloc[0]) if len(ranks) else "no replication"
            raise NotConverged(f"no replication could be sampled: {reason}")
        table = calibration_table(ranked, RANKED_DRAWS)
        atomic_write_text(
            self.folder / "calibration.csv", table.to_csv(index=False, float_format="%.4g")
        )
        figure = rank_figure(ranked, RANKED_DRAWS)
        for suffix in ("pdf", "png"):
            save_figure(figure, self.folder / f"calibration.{suffix}")
        calibrated, p = verdict(table)
        return Outcome(table, {str(k): int(v) for k, v in states.items()}, calibrated, p)


def rows_of(replication: Replication, unit: str) -> list[dict[str, Any]]:
    """Rows of ``ranks.csv`` of one replication."""
    names = list(replication.rank) or list(replication.truth)
    common = {
        "state": replication.state,
        "reason": replication.reason,
        "worst_ess": replication.worst_ess,
        "worst_rhat": replication.worst_rhat,
        "beta": replication.beta,
        "rejected_draws": replication.rejected,
        "seconds": round(replication.seconds, 3),
    }
    return [
        {
            "replication": replication.index,
            "parameter": name,
            "unit": unit_of(name, unit),
            "truth": replication.truth[name],
            "rank": replication.rank.get(name, math.nan),
            "below": replication.below.get(name, math.nan),
            "median": replication.median.get(name, math.nan),
            "sd": replication.sd.get(name, math.nan),
            **common,
        }
        for name in names
    ]


def unit_of(name: str, unit: str) -> str:
    """Unit of a ranked quantity, ``-`` where it has none."""
    if name in ("C1", "k1"):
        return "kPa"
    if name == "alpha":
        return "deg"
    loads = name == "noise_sd" or name.startswith(("mounting_force", "load_offset"))
    return unit if loads else "-"


def study_identity(study: Study) -> dict[str, Any]:
    """What determines the replications of a study."""
    return {
        "specimen": study.specimen.name,
        "specimen_sha256": specimen_digest(study.specimen),
        "options": dict(study.options),
        "priors": {name: prior_value(prior) for name, prior in study.priors.items()},
        "seed": study.seed,
        "ess": study.ess,
        "max_steps": study.max_steps,
        "ensembles": study.ensembles,
        "walkers": study.walkers,
        "population": study.population,
        "first_block": study.first_block,
        "broken": study.broken,
        "biaxbayes": biaxbayes.__version__,
    }


def _digest(identity: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


def _read_identity(path: Path) -> str:
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["identity"])
    except (OSError, ValueError, KeyError, TypeError):
        raise RunError(f"{path}: cannot be read; leave out --resume to start again") from None


def read_ranks(path: Path) -> pd.DataFrame:
    """``ranks.csv`` of a study.

    Raises
    ------
    RunError
        If it is damaged.
    """
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        if tuple(table.columns) != COLUMNS:
            raise ValueError
        for name in COLUMNS:
            if name not in TEXT:
                # By Python's own parser, which returns what was written to the last bit.
                table[name] = [float(v) if v else math.nan for v in table[name]]
        return table.astype({"replication": int, "rejected_draws": int})
    except (OSError, ValueError):
        raise RunError(
            f"{path}: is not a whole table of ranks; leave out --resume to start again"
        ) from None


def _frame(rows: dict[int, list[dict[str, Any]]]) -> pd.DataFrame:
    flat = [row for index in sorted(rows) for row in rows[index]]
    return pd.DataFrame(flat, columns=list(COLUMNS))


def _write_ranks(path: Path, rows: dict[int, list[dict[str, Any]]]) -> None:
    atomic_write_text(path, _frame(rows).to_csv(index=False))
