"""Open and check the inputs of the verbs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from biaxbayes.errors import InputError, NotConverged, RunError
from biaxbayes.parameters import NOISE_SD, STRETCH
from biaxbayes.progress_bar import OnProgress as OnProgress
from biaxbayes.progress_bar import no_progress as no_progress
from biaxbayes.specimens.check import with_force
from biaxbayes.specimens.plausibility import check_readings
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.tasks import Stop as Stop
from biaxbayes.tasks import no_stop as no_stop
from biaxbayes.text_files import as_path
from biaxbayes.text_files import make_folder as make_folder

if TYPE_CHECKING:
    from biaxbayes.runs.run import Run

PathLike = str | Path
RunLike: TypeAlias = "Run | str | Path"
SpecimenLike = Specimen | str | Path
PiecesLike = SpecimenLike | Sequence[SpecimenLike]


def open_specimen(specimen: PiecesLike, mounting_force: Sequence[float] | None = None) -> Specimen:
    """A specimen, or the CSV to read it from, or several, which are pieces of one tissue.

    Adds a mounting force to a tared one.
    """
    if isinstance(specimen, list | tuple):
        if not specimen:
            raise InputError("give at least one specimen")
        first, *others = (open_specimen(piece) for piece in specimen)
        if mounting_force is not None and others:
            problem = "`mounting_force` cannot be given for several pieces"
            raise InputError(problem, remedy="state it in each file")
        first = first if mounting_force is None else open_specimen(specimen[0], mounting_force)
        return first.with_pieces(others)
    file: object
    if isinstance(specimen, Specimen):
        file = specimen.name
        check_readings(specimen)
    else:
        file = as_path(specimen, "specimen")
        specimen = read_specimen(file)
    return specimen if mounting_force is None else with_force(specimen, mounting_force, file)


def refuse_other_tests(specimen: Specimen, verb: str) -> None:
    """Refuse another test where a verb is for planar biaxial tests alone."""
    if not specimen.experiment.is_biaxial:
        problem = f"`{verb}` is for planar biaxial tests, and this is a {specimen.test}"
        remedy = "give a square, alone or as the first of several pieces"
        raise InputError(problem, file=specimen.name, remedy=remedy)


def as_run(run: RunLike) -> Run:
    """A run, or the folder to open it from."""
    from biaxbayes.runs.run import open_run

    if isinstance(run, str | Path):
        return open_run(run)
    if not hasattr(run, "provenance"):
        raise InputError(f"`run` must be a run or its folder, not {type(run).__name__}")
    return run


def usable_run(run: RunLike, *, anyway: bool = False) -> Run:
    """A run whose draws can be computed with: converged, and none missing or out of range."""
    opened = as_run(run)
    # A run folder is untrusted input.
    needed = {p.name: p for p in opened.law.parameters}
    if not opened.settings.has_misfit:
        needed[NOISE_SD.name] = NOISE_SD
    stretches = opened.quantities.of_kind(STRETCH)
    known = needed | {q.name: q.parameter for q in stretches if q.name in opened.draws}
    for name, p in known.items():
        values = opened.draws[name].to_numpy(dtype=float) if name in opened.draws else np.empty(0)
        if not (values.size and np.isfinite(values).all() and p.in_range(values)):
            problem = "missing or out of range" if name in needed else "out of range"
            raise RunError(f"{opened.path}: its draws of {name} are {problem}")
    if opened.state == "unusable" and not anyway:
        raise NotConverged(
            f"{opened.path}: the chains of this run have not converged, so its draws must not be "
            "used; sample longer, or add `anyway=True` to use them nevertheless"
        )
    return opened


def as_numbers(values: Any, name: str, count: int | None = None) -> np.ndarray:
    """Numbers of an argument, ``count`` of them if that is given; refuses anything else."""
    try:
        numbers = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"`{name}` must be numbers") from None
    if count is not None and numbers.shape != (count,):
        raise InputError(f"`{name}` must be {count} numbers")
    return numbers


def is_run(source: RunLike | SpecimenLike) -> bool:
    """True for a run or its folder, False for a specimen."""
    if isinstance(source, str | Path):
        return Path(source).is_dir()
    from biaxbayes.runs.run import Run

    return isinstance(source, Run)


def as_style(style: Any) -> dict[str, Any] | None:
    """Settings of matplotlib, read from a file if it is a path."""
    import matplotlib as mpl

    from biaxbayes.figures.style import read_style

    if style is None or isinstance(style, Mapping):
        for key in style or ():
            if key not in mpl.rcParams:
                raise InputError(f"`style`: {str(key)[:60]!r} is not a setting of matplotlib")
        return None if style is None else dict(style)
    return read_style(as_path(style, "style"))


def check_new(path: Path, overwrite: bool) -> None:
    """Refuse to replace an existing file without `overwrite`."""
    if path.is_dir():
        raise InputError("is a folder, not a file", file=path, remedy="name a CSV in it")
    if path.exists() and not overwrite:
        remedy = "choose another name, or add `overwrite=True`"
        raise InputError("exists already", file=path, remedy=remedy)
