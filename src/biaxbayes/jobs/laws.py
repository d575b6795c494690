"""Laws weighed on a specimen, in a folder: resumable, with its tables and figures."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.comparison.law_comparison import WHOLE, Part, Prediction, Task, parts_of, sample_part
from biaxbayes.comparison.law_weights import LawComparison, judged_laws
from biaxbayes.errors import InputError, Interrupted, RunError
from biaxbayes.laws import LAWS
from biaxbayes.options import LawsPlan
from biaxbayes.parallel import Executor
from biaxbayes.runs.folder import clear_leftovers
from biaxbayes.runs.lock import folder_lock
from biaxbayes.runs.provenance import specimen_digest
from biaxbayes.sampling.sampler import Progress
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import atomic_write_text, write_csv

__all__ = ["chosen_laws", "compared_laws", "write_laws"]

RECORD, PARTS, PAGE = "laws.json", "parts", "laws.html"


def chosen_laws(named: Sequence[str] | str | None) -> tuple[str, ...]:
    """The laws that are named, also in a text with commas; all of them where none is.

    Raises
    ------
    InputError
        For an unknown name, or none in what was given.
    """
    from biaxbayes.laws import law_named

    parts = named.split(",") if isinstance(named, str) else list(named or ())
    names = [name.strip() for name in parts if name.strip()]
    if named is not None and not names:
        raise InputError(
            "--laws names no law", remedy=f"laws are {', '.join(LAWS)}; leave it out for all"
        )
    for name in names:
        law_named(name)
    return tuple(name for name in LAWS if not names or name in names)


@dataclass(frozen=True)
class _Stored:
    """Predictions in a folder, one file each; in memory alone where there is no folder."""

    folder: Path | None

    def path(self, index: int) -> Path | None:
        return None if self.folder is None else self.folder / PARTS / f"{index:03d}.npz"

    def read(self, index: int) -> Prediction | None:
        path = self.path(index)
        if path is None or not path.exists():
            return None
        try:
            with np.load(path, allow_pickle=False) as data:
                about = json.loads(str(data["about"]))
                residuals = tuple(data[f"residual_{i}"] for i in range(about["protocols"]))
                draws = pd.DataFrame(data["draws"], columns=about["columns"])
        except (OSError, ValueError, KeyError, TypeError):
            return None  # damaged: made again
        return Prediction(about["state"], about["reason"], about["rmse_kPa"], residuals, draws)

    def write(self, index: int, found: Prediction) -> None:
        path = self.path(index)
        if path is None:
            return
        about = {
            "state": found.state,
            "reason": found.reason,
            "rmse_kPa": found.rmse_kPa,
            "protocols": len(found.residuals),
            "columns": [str(c) for c in found.draws.columns],
        }
        residuals = {f"residual_{i}": r for i, r in enumerate(found.residuals)}
        path.parent.mkdir(exist_ok=True)
        partial = path.with_suffix(".partial")
        with partial.open("wb") as stream:
            arrays: dict[str, Any] = {"draws": found.draws.to_numpy(), **residuals}
            np.savez(stream, about=json.dumps(about), **arrays)
        partial.replace(path)


def compared_laws(
    specimen: Specimen,
    options: Mapping[str, Any],
    laws: Sequence[str],
    plan: LawsPlan,
    executor: Executor,
    *,
    folder: Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] = lambda p: None,
    stop: Callable[[], int] = lambda: 0,
) -> LawComparison:
    """Fit and sample every law on every part of a record, and weigh them.

    Parameters
    ----------
    specimen : Specimen
    options : mapping
        Keyword arguments of :class:`~biaxbayes.model.posterior.Posterior` that do not depend on
        the law.
    laws : sequence of str
    plan : LawsPlan
    executor : Executor
    folder : path, optional
        Where to keep what is done, and the tables and figures.
    resume : bool
        Go on with what the folder holds.
    progress, stop : callable

    Raises
    ------
    InputError
        If each protocol has a mounted state of its own, which nothing foretells of a protocol that
        is left out; or for fewer than two laws.
    RunError
        If the folder is in use or holds something else.
    Interrupted
        If stopped; what was done is saved.
    """
    if options.get("mounting_stretch") == "per-protocol":
        raise InputError(
            "a protocol with a mounted state of its own cannot be foretold from the others",
            remedy="leave out --mounting-stretch per-protocol",
        )
    if len(laws) < 2:
        raise InputError(
            f"{', '.join(laws)} alone is no comparison",
            remedy="name two laws or more, or sample one with 'biaxbayes sample --law'",
        )
    tasks = [
        Task(law, specimen, part, options, _seed(plan.seed, law, part), plan.ess, plan.max_steps)
        for law in laws
        for part in (None, *parts_of(specimen))
    ]
    if folder is None:
        found = _sampled(tasks, _Stored(None), executor, progress, stop)
        return judged_laws(specimen, options, found, laws)
    with folder_lock(folder):
        clear_leftovers(folder)
        _start(folder, specimen, options, laws, plan, resume)
        found = _sampled(tasks, _Stored(folder), executor, progress, stop)
        progress(Progress("weighing"))
        compared = judged_laws(specimen, options, found, laws)
        write_laws(compared, specimen, folder)
    return compared


def _seed(seed: int, law: str, part: Part | None) -> int:
    """A seed of its own for each law and part, whichever others are asked for."""
    text = f"{law}/{part.name if part else WHOLE}"
    own = int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")
    return int(np.random.default_rng([seed, own]).integers(2**62))


def _start(
    folder: Path,
    specimen: Specimen,
    options: Mapping[str, Any],
    laws: Sequence[str],
    plan: LawsPlan,
    resume: bool,
) -> None:
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
    names = {p.name for p in folder.iterdir() if not p.name.startswith(".")}
    if names and RECORD not in names:
        raise RunError(
            f"{folder}: is a folder that is not a comparison of laws; choose another --out"
        )
    if RECORD in names:
        try:
            same = json.loads(record.read_text(encoding="utf-8"))["identity"] == identity
        except (OSError, ValueError, KeyError, TypeError):
            same = False
        if resume and not same:
            raise RunError(
                f"{folder}: holds another comparison (specimen, options, laws, seed or version "
                "differ); choose another --out"
            )
        if not resume:
            raise InputError(
                "holds a comparison of laws already",
                file=folder,
                remedy="choose another --out, or go on with it by --resume",
            )
    text = json.dumps({"specimen": specimen.name, "identity": identity}, indent=2)
    atomic_write_text(record, text + "\n")


def _sampled(
    tasks: Sequence[Task],
    stored: _Stored,
    executor: Executor,
    progress: Callable[[Progress], None],
    stop: Callable[[], int],
) -> dict[tuple[str, str], Prediction]:
    found: dict[int, Prediction] = {}
    for index in range(len(tasks)):
        known = stored.read(index)
        if known is not None:
            found[index] = known
    missing = [i for i in range(len(tasks)) if i not in found]
    if missing:
        progress(Progress("compiling (once; cached for later runs)"))
    for outcome in executor.run(sample_part, [tasks[i] for i in missing], stop=stop):
        if outcome.lost:
            raise RunError(f"{tasks[missing[outcome.index]].name}: {outcome.lost}")
        index = missing[outcome.index]
        found[index] = outcome.value
        stored.write(index, outcome.value)
        done = len(found)
        progress(Progress(f"{done} of {len(tasks)}: {tasks[index].name}", done / len(tasks)))
    if len(found) < len(tasks):
        kept = f", all saved in {stored.folder}; the same command with --resume continues"
        raise Interrupted(
            f"interrupted after {len(found)} of {len(tasks)} posteriors"
            + (kept if stored.folder else ""),
            stop(),
        )
    return {
        (task.law, task.part.name if task.part else WHOLE): found[i] for i, task in enumerate(tasks)
    }


def write_laws(compared: LawComparison, specimen: Specimen, folder: Path) -> None:
    """Write the tables of a comparison, draws and bands of the mixture, figures and the page.

    Parameters
    ----------
    compared : LawComparison
    specimen : Specimen
    folder : path
    """
    from biaxbayes.figures.laws import law_bands_figure, law_misfit_figure, law_mounting_figure
    from biaxbayes.figures.style import save_pictures
    from biaxbayes.reports.comparison import laws_page

    write_csv(folder / "laws.csv", compared.table, digits=8)
    write_csv(folder / "stated.csv", compared.stated, digits=8)
    write_csv(folder / "left-out.csv", compared.parts, digits=8)
    write_csv(folder / "stacked-draws.csv", compared.draws, digits=8)
    write_csv(folder / "stacked-bands.csv", compared.bands, digits=8)
    drawn = {
        "law-misfit": law_misfit_figure(compared),
        "law-mounting": law_mounting_figure(compared),
        "stacked-bands": law_bands_figure(compared, specimen),
    }
    figures = {stem: figure for stem, figure in drawn.items() if figure is not None}
    for stem, figure in figures.items():
        save_pictures(figure, folder, stem)
    atomic_write_text(folder / PAGE, laws_page(compared, figures))
