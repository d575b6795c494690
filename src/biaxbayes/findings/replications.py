"""Many replications of a calibration study, in worker processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool

from threadpoolctl import threadpool_limits

from biaxbayes.errors import RunError
from biaxbayes.findings.calibration import Replication, Study, replicate

__all__ = ["run_replications"]

MAX_RESTARTS = 3
"""A worker killed more often than this (out of memory, say) ends the study."""
QUEUED = 3  # replications handed out a worker: keeps them busy, and a stop soon obeyed


def run_replications(
    study: Study,
    indices: Sequence[int],
    *,
    workers: int = 1,
    stop: Callable[[], object] = lambda: False,
) -> Iterator[Replication]:
    """Yield replications as they finish; their order depends on the workers, they do not.

    Parameters
    ----------
    study : Study
    indices : sequence of int
    workers : int
        Processes; with 1 everything happens in this one.
    stop : callable
        Asked between replications; what is under way is still yielded.

    Raises
    ------
    RunError
        If worker processes keep dying.
    """
    left, restarts = list(indices), 0
    # The first is made here: what it compiles, the workers find in the cache.
    here = len(left) if workers == 1 else 1
    for index in left[:here]:
        if stop():
            return
        with threadpool_limits(1):
            replication = replicate(study, index)
        left.remove(index)
        yield replication
    while left:
        try:
            for replication in _pooled(study, left, workers, stop):
                left.remove(replication.index)
                yield replication
            return
        except BrokenProcessPool:
            restarts += 1
            if restarts > MAX_RESTARTS:
                raise RunError(
                    "worker processes keep dying (out of memory?); --resume continues, with fewer "
                    "--workers"
                ) from None


def _pooled(
    study: Study, indices: Sequence[int], workers: int, stop: Callable[[], object]
) -> Iterator[Replication]:
    # spawn: a forked copy of a process with threads (numba, BLAS) can hang
    context = multiprocessing.get_context("spawn")
    waiting = iter(list(indices))
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare_worker) as pool:
        running: set[Future[Replication]] = set()
        stopped = False
        while True:
            stopped = stopped or bool(stop())
            while not stopped and len(running) < QUEUED * workers:
                index = next(waiting, None)
                if index is None:
                    break
                running.add(pool.submit(replicate, study, index))
            if not running:
                return
            done, running = wait(running, timeout=1.0, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()


def _prepare_worker() -> None:
    """One BLAS thread a worker; Ctrl-C is the parent's to handle, and its death ends the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(1)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    """End this worker when its parent has gone, however it went."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
