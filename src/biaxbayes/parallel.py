"""Many independent tasks: in this process, in processes of this machine, on a Dask cluster.

The result of a task must depend on nothing but the task, so that the executor affects only the run
time. Functions must be defined at the top of a module, tasks and results must be picklable. Linear
algebra takes one thread per task.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from typing import Any, Self

from biaxbayes.cluster import Cluster
from biaxbayes.errors import InputError, RunError
from biaxbayes.tasks import (
    DEFAULT_WORKERS,
    Executor,
    Outcome,
    Stop,
    Work,
    no_stop,
    with_one_blas_thread,
)

MAX_ATTEMPTS = 3
"""Number of worker deaths after which a task is given up (probably out of memory)."""
STOP_POLL_SECONDS = 0.5


def executor_for(
    workers: int | None = None, scheduler: str | None = None, *, isolated: bool = False
) -> Executor:
    """Executor for processes or Dask; `isolated`: also a single worker is a process of its own."""
    if scheduler is not None:
        if workers is not None:
            remedy = "the workers of a cluster are started with it"
            raise InputError("give either `workers` or `scheduler`", remedy=remedy)
        return Cluster(scheduler)
    may_start = not multiprocessing.current_process().daemon
    count = (DEFAULT_WORKERS if may_start else 1) if workers is None else workers
    if count < 1:
        raise InputError("`workers` must be at least 1")
    if count > 1 and not may_start:
        problem = "a worker of multiprocessing.Pool (a daemonic process) cannot start processes"
        remedy = "give workers=1, or use concurrent.futures.ProcessPoolExecutor around it"
        raise InputError(problem, remedy=remedy)
    return Processes(count) if may_start and (count > 1 or isolated) else Executor()


class Processes(Executor):
    """Spawned processes, each a pool of its own: if one breaks, its task is known."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._keep_workers = False
        self._idle: list[_Worker] = []

    def __enter__(self) -> Self:
        self._keep_workers = True
        return self

    def __exit__(self, *error: object) -> None:
        self._keep_workers = False
        while self._idle:
            self._idle.pop().end()

    def run(
        self, function: Work, tasks: Sequence[Any], *, stop: Stop = no_stop
    ) -> Iterator[Outcome]:
        """Run the tasks in processes; see :meth:`Executor.run`."""
        waiting, deaths = deque(range(len(tasks))), Counter[int]()
        running: dict[Future[Any], tuple[int, _Worker]] = {}
        stopped = False
        try:
            while running or (waiting and not stopped):
                stopped = stopped or bool(stop())
                while waiting and not stopped and len(running) < self.count:
                    if self._idle and deaths[waiting[0]]:
                        # The next attempt gets a new process, as an earlier task may be the cause.
                        self._idle.pop().end()
                    worker = self._idle.pop() if self._idle else _Worker()
                    task = tasks[waiting[0]]
                    try:
                        future = worker.pool.submit(with_one_blas_thread, function, task)
                    except BrokenProcessPool:  # it died while idle
                        worker.remove()
                        continue
                    running[future] = waiting.popleft(), worker
                for future in wait(running, STOP_POLL_SECONDS, FIRST_COMPLETED).done:
                    index, worker = running.pop(future)
                    if not isinstance(future.exception(), BrokenProcessPool):
                        self._idle.append(worker)
                        yield Outcome(index, future.result())
                        continue
                    worker.remove()
                    deaths[index] += 1
                    if deaths[index] < MAX_ATTEMPTS:
                        waiting.append(index)
                    else:
                        failure = f"its worker process died {MAX_ATTEMPTS} times (out of memory?)"
                        yield Outcome(index, None, failure)
        finally:
            for _, worker in running.values():
                worker.end()
            if not self._keep_workers:
                self.__exit__()


class _Worker:
    """A pool of one process."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pool = ProcessPoolExecutor(1, context, initializer=_end_with_parent)
        chosen = multiprocessing.get_start_method(allow_none=True)
        with _signals_blocked():
            self._pid = self.pool.submit(os.getpid)
        # Spawning fixes Python's default method; a caller that chooses one would get an error.
        multiprocessing.set_start_method(chosen, force=True)

    def end(self) -> bool:
        """Kill the process; False if it never started."""
        started = self._pid.done() and self._pid.exception() is None
        if started:
            with contextlib.suppress(OSError):
                os.kill(self._pid.result(), getattr(signal, "SIGKILL", signal.SIGTERM))
        self.pool.shutdown(cancel_futures=True)
        return started

    def remove(self) -> None:
        """Clean up after a process that died; RunError if it never started."""
        if not self.end():
            raise RunError(
                "worker processes fail to start; in a script put the call below "
                'if __name__ == "__main__":, or use `workers=1`'
            )


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    """Start processes that leave the signals of the terminal, as of Ctrl-C, to this one."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # which unblocks them as it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """In a worker: end when the process that started it is killed, and do not compute on."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
