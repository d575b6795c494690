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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from typing import Any, Protocol, Self

from biaxbayes.cluster import Cluster
from biaxbayes.errors import InputError, RunError
from biaxbayes.tasks import Outcome, Result, Task, no_stop, with_one_blas_thread

MOST_LOCAL = 4
MOST_ATTEMPTS = 3
"""Number of worker deaths after which a task is given up (probably out of memory)."""
STOP_SECONDS = 0.5


class Executor(Protocol):
    """Applies a function to tasks and yields the outcomes as they come, in any order.

    In a ``with`` block its workers stay between runs. Once ``stop()`` is true, nothing further
    starts, and running tasks are still yielded.
    """

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = no_stop,
    ) -> Iterator[Outcome[Result]]:
        """Yield the outcome of each task."""
        ...


def executor_for(
    workers: int | None = None, scheduler: str | None = None, *, isolated: bool = False
) -> Executor:
    """Executor for `workers` processes (default as many as processors, at most four) or Dask.

    `isolated`: a single worker is a process too, so that its death is not ours.
    """
    if scheduler is not None:
        if workers is not None:
            raise InputError(
                "give either `workers` or `scheduler`",
                remedy="the workers of a cluster are started with it",
            )
        return Cluster(scheduler)
    may_start = not multiprocessing.current_process().daemon
    available = min(os.cpu_count() or 1, MOST_LOCAL) if may_start else 1
    count = available if workers is None else workers
    if count < 1:
        raise InputError("`workers` must be at least 1")
    if count > 1 and not may_start:
        raise InputError(
            "a worker of multiprocessing.Pool (a daemonic process) cannot start processes",
            remedy="give workers=1, or use concurrent.futures.ProcessPoolExecutor around it",
        )
    return Processes(count) if may_start and (count > 1 or isolated) else InThisProcess()


class InThisProcess:
    """One task after the other, here."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = no_stop,
    ) -> Iterator[Outcome[Result]]:
        """Run the tasks one after the other; see :meth:`Executor.run`."""
        for index, task in enumerate(tasks):
            if stop():
                return
            yield Outcome(index, with_one_blas_thread(function, task))


class Processes:
    """Spawned processes, each a pool of its own: if one breaks, its task is known."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._stay = False
        self._workers: list[_Worker] = []

    def __enter__(self) -> Self:
        self._stay = True
        return self

    def __exit__(self, *error: object) -> None:
        self._stay = False
        self._end()

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = no_stop,
    ) -> Iterator[Outcome[Result]]:
        """Run the tasks in processes; see :meth:`Executor.run`."""
        waiting, deaths = deque(range(len(tasks))), Counter[int]()
        running: dict[Future[Result], tuple[int, _Worker]] = {}
        finished = stopped = False
        try:
            while running or (waiting and not stopped):
                stopped = stopped or bool(stop())
                while waiting and not stopped and len(running) < self.count:
                    # The second attempt gets a new process, as an earlier task may be the cause.
                    worker = self._idle(running, new=deaths[waiting[0]] > 0)
                    try:
                        future = worker.submit(function, tasks[waiting[0]])
                    except BrokenProcessPool:  # it died while idle
                        self._remove(worker)
                        continue
                    running[future] = waiting.popleft(), worker
                for future in wait(running, STOP_SECONDS, FIRST_COMPLETED).done:
                    index, worker = running.pop(future)
                    try:
                        outcome = Outcome(index, future.result())
                    except BrokenProcessPool:
                        self._remove(worker)
                        deaths[index] += 1
                        if deaths[index] < MOST_ATTEMPTS:
                            waiting.append(index)
                            continue
                        lost = f"its worker process died {MOST_ATTEMPTS} times (out of memory?)"
                        outcome = Outcome[Any](index, None, lost)
                    yield outcome
            finished = True
        finally:
            if not (finished and self._stay):
                self._end()

    def _idle(self, running: dict[Future[Any], tuple[int, _Worker]], *, new: bool) -> _Worker:
        """An idle worker, or a new one in its place."""
        busy = [worker for _, worker in running.values()]
        idle = [worker for worker in self._workers if worker not in busy]
        if idle and not new:
            return idle[-1]
        if idle:
            self._remove(idle[-1])
        self._workers.append(_Worker())
        return self._workers[-1]

    def _remove(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        worker.end()
        if not worker.has_started:
            raise RunError(
                "worker processes fail to start; in a script put the call below "
                'if __name__ == "__main__":, or use `workers=1`'
            )

    def _end(self) -> None:
        workers, self._workers = self._workers, []
        for worker in workers:
            worker.end()


class _Worker:
    """A pool of one process."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, initializer=_end_with_parent)
        chosen = multiprocessing.get_start_method(allow_none=True)
        with _signals_blocked():
            self._pid = self._pool.submit(os.getpid)
        # Spawning fixes Python's default method; leave the choice to the calling program.
        multiprocessing.set_start_method(chosen, force=True)

    @property
    def has_started(self) -> bool:
        return self._pid.done() and self._pid.exception() is None

    def submit(self, function: Callable[[Task], Result], task: Task) -> Future[Result]:
        return self._pool.submit(with_one_blas_thread, function, task)

    def end(self) -> None:
        """Kill the process."""
        if self.has_started:
            with contextlib.suppress(OSError):
                os.kill(self._pid.result(), getattr(signal, "SIGKILL", signal.SIGTERM))
        self._pool.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    """Start processes that leave the signals of the terminal to this one."""
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
    """In a worker: end when the process that started it ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
