"""The verb ``batch``: who does the work of a study, and what is sampled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.executors.executor import executor_for
from biaxbayes.figures.run import DRAWING_MODULES
from biaxbayes.jobs.opening import PathLike, Stop, never, silent
from biaxbayes.options import ModelOptions, SamplingPlan, documented
from biaxbayes.progress_bar import with_progress
from biaxbayes.studies.study_file import read_study, study_of_files

if TYPE_CHECKING:
    from biaxbayes.studies.result import StudyResult

__all__ = ["WORKER_MODULES", "batch"]

WORKER_MODULES = (
    "biaxbayes.sampling.ensembles",
    "biaxbayes.comparison.compare",
    "arviz",
    "corner",
    "biaxbayes.jobs.batch.tasks",
    "biaxbayes.jobs.sample",
    "biaxbayes.studies.rows",
    "biaxbayes.jobs.identified",
    "biaxbayes.jobs.products",
    "biaxbayes.reports.study_page",
    "biaxbayes.figures.compare",
    "scipy.optimize",
    "jinja2",
    *DRAWING_MODULES,
)
"""What a worker imports in the end, wherever that is put off until it is needed."""


@with_progress
@documented(SamplingPlan, ModelOptions)
def batch(
    study: PathLike | Sequence[PathLike],
    *,
    out: PathLike,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[Any], None] = silent,
    stop: Stop = never,
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
    progress, stop : callable, optional
        As in :func:`biaxbayes.sample`.
    **options
        For specimen files: seed, ess, max_steps, anyway (as in :func:`biaxbayes.sample`), and
        those of
        :class:`~biaxbayes.options.ModelOptions`.
    """
    from biaxbayes.jobs.batch.study import Batch

    if isinstance(study, str | Path):
        if options:
            raise InputError("options of a study stand in its file", file=study)
        chosen = read_study(Path(study))
    else:
        own = ("seed", "ess", "max_steps", "anyway")
        numbers = {k: options.pop(k) for k in own if k in options}
        model = ModelOptions.of(options).keywords()
        chosen = study_of_files([Path(p) for p in study], model, **numbers)
    executor = executor_for(workers, scheduler, isolated=True, modules=WORKER_MODULES)
    return Batch(chosen, Path(out), executor).execute(progress=progress, stop=stop)
