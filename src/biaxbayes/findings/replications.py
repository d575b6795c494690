"""Many replications of a calibration study, on any executor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from biaxbayes.errors import RunError
from biaxbayes.executors.executor import Executor, InThisProcess
from biaxbayes.findings.calibration import Replication, Study, replicate

__all__ = ["run_replications"]


def run_replications(
    study: Study,
    indices: Sequence[int],
    *,
    executor: Executor | None = None,
    stop: Callable[[], object] = lambda: False,
) -> Iterator[Replication]:
    """Yield replications as they finish; their order depends on the executor, they do not.

    Parameters
    ----------
    study : Study
    indices : sequence of int
    executor : Executor, optional
        Default: this process.
    stop : callable
        Asked between replications; what is under way is still yielded.

    Raises
    ------
    RunError
        If workers keep dying.
    """
    left = list(indices)
    if executor is not None and not isinstance(executor, InThisProcess) and left:
        # The first is made here: what it compiles, the workers find in the cache.
        for outcome in InThisProcess().run(partial(replicate, study), left[:1], stop=stop):
            yield outcome.value
            left = left[1:]
    chosen = executor or InThisProcess()
    for outcome in chosen.run(partial(replicate, study), left, stop=stop):
        if outcome.lost:
            raise RunError(
                f"replication {left[outcome.index]}: {outcome.lost}; --resume continues, with "
                "fewer --workers"
            )
        yield outcome.value
