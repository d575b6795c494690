"""Verbs that sample many specimens."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.executors.executor import executor_for

if TYPE_CHECKING:
    from biaxbayes.output.calibration import Outcome
    from biaxbayes.output.study_result import StudyResult
    from biaxbayes.specimens.specimen import Specimen

__all__ = ["batch", "calibrate"]


def batch(
    study: str | Path | Sequence[str | Path],
    *,
    out: str | Path,
    workers: int | None = None,
    scheduler: str | None = None,
    **options: Any,
) -> StudyResult:
    """Sample every specimen of a study, or what is missing of it.

    In a script of your own the call stands below ``if __name__ == "__main__":``, as for everything
    that starts processes.

    Parameters
    ----------
    study : path-like, or sequence of path-like
        A study file, or specimen files that share their options.
    out : path-like
        The study folder.
    workers : int, optional
        Local processes; default the number of processors, at most four.
    scheduler : str, optional
        Address of a Dask scheduler to use instead.
    **options
        For specimen files: seed, ess, max_steps, and those of
        :class:`~biaxbayes.inference.posterior.Posterior`.
    """
    from biaxbayes.inference.study_file import DEFAULT_OPTIONS, read_study, study_of_files
    from biaxbayes.output.batch import Batch

    if isinstance(study, str | Path):
        if options:
            raise InputError("options of a study stand in its file", file=study)
        chosen = read_study(Path(study))
    else:
        numbers = {k: options.pop(k) for k in ("seed", "ess", "max_steps") if k in options}
        unknown = set(options) - set(DEFAULT_OPTIONS) - {"priors"}
        if unknown:
            raise InputError(f"no option {min(unknown)!r}")
        model = {**DEFAULT_OPTIONS, "priors": {}, **options}
        chosen = study_of_files([Path(p) for p in study], model, **numbers)
    return Batch(chosen, Path(out), executor_for(workers, scheduler, isolated=True)).execute()


def calibrate(
    specimen: Specimen,
    *,
    out: str | Path,
    replications: int = 200,
    seed: int = 1,
    ess: float = 600.0,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = True,
    **options: Any,
) -> Outcome:
    """Simulation-based calibration on the protocols of a specimen.

    Parameters
    ----------
    specimen : Specimen
    out : path-like
        Folder of the study.
    replications : int
    seed : int
    ess : float
        Effective draws of each.
    workers, scheduler
        As in :func:`batch`.
    resume : bool
        Continue the study that the folder holds.
    **options
        As in :class:`~biaxbayes.inference.posterior.Posterior`.
    """
    from biaxbayes.findings.calibration import Study
    from biaxbayes.findings.study_prior import protocol_prior
    from biaxbayes.output.calibration import CalibrationStudy

    priors = {**protocol_prior(specimen), **options.pop("priors", {})}
    study = Study(specimen, options, priors, seed=seed, ess=ess)
    kept = CalibrationStudy(study, Path(out), replications, executor_for(workers, scheduler))
    return kept.execute(resume=resume)
