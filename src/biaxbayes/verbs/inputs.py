"""Open and check the inputs of the verbs; make their output folders."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from biaxbayes.errors import InputError, NotConverged, RunError
from biaxbayes.parameters import NOISE_SD, STRETCH
from biaxbayes.specimens.plausibility import check_readings
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import parse_specimen, read_specimen, specimen_text
from biaxbayes.tasks import no_stop as no_stop
from biaxbayes.text_files import atomic_write_text

if TYPE_CHECKING:
    import pandas as pd

    from biaxbayes.runs.run import Run
    from biaxbayes.sampling.sampler import Progress

PathLike = str | Path
RunLike: TypeAlias = "Run | str | Path"
SpecimenLike = Specimen | str | Path

OnProgress = Callable[["Progress"], None]
Stop = Callable[[], int]


def no_progress(progress: Progress) -> None:
    """No progress is shown."""


def open_specimen(
    specimen: SpecimenLike, mounting_force: Sequence[float] | None = None
) -> Specimen:
    """A specimen, or the CSV to read it from; adds a mounting force to a tared one."""
    file: object = None
    if not isinstance(specimen, Specimen):
        file = Path(specimen)
        specimen = read_specimen(specimen)
    else:
        check_readings(specimen)
    if mounting_force is None:
        return specimen
    if not specimen.is_tared:
        raise InputError(
            "already has a mounting force",
            file=file or specimen.name,
            remedy="`mounting_force` is for files whose force was zeroed after mounting",
        )
    try:
        x, y = (float(v) for v in mounting_force)
    except (TypeError, ValueError):
        x = y = math.nan
    if not math.isfinite(x + y) or (x, y) == (0.0, 0.0):
        raise InputError(
            "`mounting_force` must be two finite numbers, not both zero",
            remedy=f"give the force before taring, in {specimen.unit}",
        )
    largest = specimen.peak_load
    if max(abs(x), abs(y)) > FORCE_LIMIT * largest:
        raise InputError(
            f"`mounting_force` {x:g} {y:g} is more than {FORCE_LIMIT:g} times the largest load "
            f"recorded, {largest:.3g} {specimen.unit}",
            file=file or specimen.name,
            remedy=f"give it in {specimen.unit}",
        )
    with_force = specimen.with_mounting_force(x, y)
    if with_force.is_tared:
        raise InputError(
            f"`mounting_force` {x:g} {y:g} is negligible beside the largest recorded load, "
            f"{largest:.3g} {specimen.unit}",
            file=file or specimen.name,
            remedy=f"give it in {specimen.unit}",
        )
    return readable_specimen(with_force, file or specimen.name)


FORCE_LIMIT = 3.0
"""Largest ratio of a mounting force to the peak load; beyond it the unit is probably wrong."""


def readable_specimen(specimen: Specimen, file: object) -> Specimen:
    """The same specimen; refused if it cannot be read again from the copy in a run folder."""
    check_readings(specimen)
    try:
        parse_specimen(specimen_text(specimen).split("\n"), Path("specimen.csv"))
    except InputError as error:
        where = f" in {error.column}" if error.column else ""
        raise InputError(f"{error.problem}{where}", file=file, remedy=error.remedy) from None
    return specimen


def opened_run(run: RunLike) -> Run:
    """A run, or the folder to open it from."""
    from biaxbayes.runs.run import open_run

    return open_run(run) if isinstance(run, str | Path) else run


def usable_run(run: RunLike, *, anyway: bool = False) -> Run:
    """A run whose draws can be computed with."""
    opened = opened_run(run)
    _check_draws(opened)
    if opened.state == "unusable" and not anyway:
        raise NotConverged(
            f"{opened.path}: the chains of this run have not converged, so its draws must not be "
            "used; sample longer, or add `anyway=True` to use them nevertheless"
        )
    return opened


def _check_draws(run: Run) -> None:
    """Refuse draws that are missing or out of range: a run folder is untrusted input."""
    needed = {p.name: p for p in (*run.law.parameters, NOISE_SD)}
    stretches = run.quantities.of_kind(STRETCH)
    known = needed | {q.name: q.parameter for q in stretches if q.name in run.draws}
    for name, p in known.items():
        values = run.draws[name].to_numpy(dtype=float) if name in run.draws else np.empty(0)
        if not (values.size and np.isfinite(values).all() and p.holds(values)):
            problem = "missing or out of range" if name in needed else "out of range"
            raise RunError(f"{run.path}: its draws of {name} are {problem}")


def is_run(source: RunLike | SpecimenLike) -> bool:
    """Whether this is a run or its folder, not a specimen."""
    if isinstance(source, str | Path):
        return Path(source).is_dir()
    from biaxbayes.runs.run import Run

    return isinstance(source, Run)


def make_folder(path: PathLike) -> Path:
    """Make a folder to write into, where it does not exist."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=folder) from None
    return folder


def claim_folder(
    folder: Path, records: Collection[str], kind: str, own: Collection[str] = ()
) -> set[str]:
    """Make an output folder that is new, or holds one of `records` or nothing but `own` names."""
    from biaxbayes.runs.folder import names_in

    names = names_in(folder)
    if names.difference(own) and not names.intersection(records):
        raise RunError(f"{folder}: is a folder that is not {kind}; choose another `out`")
    return names


def write_table(folder: Path, stem: str, table: pd.DataFrame, digits: str | None) -> None:
    """Write ``<stem>.csv``; ``digits`` as in ``%.6g``, None for all."""
    text = table.to_csv(index=False, float_format=digits, lineterminator="\n")
    atomic_write_text(folder / f"{stem}.csv", text)


def refuse_model(given: Mapping[str, Any], mounting_force: object) -> None:
    """Refuse model options together with a run, which has its own model."""
    names = [*(["mounting_force"] if mounting_force is not None else []), *given]
    if names:
        raise InputError(
            f"`{names[0][:60]}` does not go with a run, which has its own",
            remedy="give the specimen's CSV instead",
        )


def opened_style(style: Any) -> dict[str, Any] | None:
    """A matplotlib style, or the file to read it from."""
    from biaxbayes.figures.style import read_style

    return read_style(style) if isinstance(style, str | Path) else style


def refuse_finished(folder: Path, record: str, *, resume: bool, overwrite: bool) -> None:
    """Refuse to overwrite a finished run, unless asked to or to continue it."""
    from biaxbayes.runs.checkpoint import NAMES
    from biaxbayes.runs.folder import KINDS, is_finished

    continued = resume and any((folder / name).exists() for name in NAMES)
    if is_finished(folder, record) and not (continued or overwrite):
        raise RunError(
            f"{folder}: holds a finished {KINDS[record]}; choose another `out`, or replace it with "
            "`overwrite=True`"
        )


def removal_note(progress: OnProgress, record: str) -> Callable[[list[str]], None]:
    """Callback that reports the derived files removed with the previous run or population."""
    from biaxbayes.runs.folder import KINDS
    from biaxbayes.sampling.sampler import Progress

    def on_removed(names: list[str]) -> None:
        if names:
            note = f"removed with the {KINDS[record]} before: {', '.join(names)}"
            progress(Progress("writing", note=note))

    return on_removed


def check_new(path: Path, overwrite: bool) -> None:
    """Refuse to replace an existing file without `overwrite`."""
    if path.is_dir():
        raise InputError("is a folder, not a file", file=path, remedy="name a CSV in it")
    if path.exists() and not overwrite:
        raise InputError(
            "exists already", file=path, remedy="choose another name, or add `overwrite=True`"
        )
