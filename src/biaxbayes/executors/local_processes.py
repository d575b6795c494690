"""Worker processes on this machine: started once, one task at a time each.

A worker that dies takes its own task with it and no other; the task is given to a fresh worker.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, Self

from threadpoolctl import threadpool_limits

from biaxbayes.errors import RunError
from biaxbayes.executors.executor import MOST_ATTEMPTS, Outcome, Result, Task

__all__ = ["LocalProcesses"]

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
READY = "ready"
POLL_SECONDS = 0.5


class LocalProcesses:
    """Worker processes on this machine.

    Parameters
    ----------
    workers : int
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._crew: list[_Worker] = []
        self._stay = False

    def __enter__(self) -> Self:
        self._stay = True
        return self

    def __exit__(self, *error: object) -> None:
        self._stay = False
        self._dismiss()

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = lambda: False,
    ) -> Iterator[Outcome[Result]]:
        """As :meth:`~biaxbayes.executors.executor.Executor.run`."""
        waiting = deque(range(len(tasks)))
        attempts = [0] * len(tasks)
        crew = self._crew
        crew += [_Worker() for _ in range(min(self.workers, len(tasks)) - len(crew))]
        try:
            while True:
                stopped = bool(stop())
                for worker in crew:
                    if worker.idle and waiting and not stopped:
                        index = waiting.popleft()
                        attempts[index] += 1
                        worker.give(index, function, tasks[index])
                under_way = any(w.task is not None for w in crew)
                if not under_way and (stopped or not waiting):
                    return
                for place, worker in _heard_from(crew):
                    outcome = worker.hear()
                    if outcome is not None:
                        yield outcome
                    if worker.alive:
                        continue
                    crew[place] = _Worker(worker.early_deaths)
                    if worker.task is None:
                        continue
                    if attempts[worker.task] < MOST_ATTEMPTS:
                        waiting.appendleft(worker.task)
                    else:
                        yield _lost(worker.task)
        finally:
            if not self._stay or any(w.task is not None for w in crew):
                self._dismiss()

    def _dismiss(self) -> None:
        for worker in self._crew:
            worker.dismiss()
        self._crew.clear()


def _lost(index: int) -> Outcome[Any]:
    return Outcome(
        index, None, f"its worker process died {MOST_ATTEMPTS} times (out of memory, or killed)"
    )


class _Worker:
    """One worker process, seen from the process that gives it work."""

    def __init__(self, early_deaths: int = 0) -> None:
        # spawn: a forked copy of a process with threads (numba, BLAS) can hang
        context = multiprocessing.get_context("spawn")
        self.line, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs,), daemon=True)
        with _one_thread():
            self.process.start()
        theirs.close()
        self.task: int | None = None
        self.ready, self.alive = False, True
        self.early_deaths = early_deaths

    @property
    def idle(self) -> bool:
        return self.ready and self.alive and self.task is None

    def give(self, index: int, function: Callable[[Any], Any], task: Any) -> None:
        self.task = index
        # A worker that has died since is noticed when it is heard from.
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.line.send((function, task))

    def hear(self) -> Outcome[Any] | None:
        """Take what the worker sent: an outcome, the word that it is ready, or nothing any more."""
        try:
            message = self.line.recv()
        except (EOFError, OSError, pickle.UnpicklingError):
            self._died()
            return None
        if message == READY:
            self.ready, self.early_deaths = True, 0
            return None
        value, error = message
        if error is not None:
            raise error
        assert self.task is not None
        index, self.task = self.task, None
        return Outcome(index, value)

    def _died(self) -> None:
        self.alive = False
        self.line.close()
        self.process.join()
        if self.ready:
            return
        self.early_deaths += 1
        if self.early_deaths >= MOST_ATTEMPTS:
            raise RunError(
                "worker processes die as they start; in a script of your own the call must stand "
                'below if __name__ == "__main__":, and on the command line use --workers 1'
            )

    def dismiss(self) -> None:
        """End the process: it ends by itself where it is idle, and is ended where it is not."""
        with contextlib.suppress(OSError):
            self.line.close()
        if not self.idle:
            self.process.terminate()
        self.process.join()


def _heard_from(crew: list[_Worker]) -> list[tuple[int, _Worker]]:
    """Workers that sent something or died, with their places; none after a while."""
    lines: dict[Any, int] = {worker.line: place for place, worker in enumerate(crew)}
    return [(lines[line], crew[lines[line]]) for line in wait(list(lines), POLL_SECONDS)]


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started in here have one thread of BLAS."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


# --- in the worker -------------------------------------------------------------------------


def _work(line: Connection) -> None:
    """Work off tasks until the line is closed."""
    for name in ("SIGINT", "SIGHUP"):  # of the terminal: the parent's to handle
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    threading.Thread(target=_follow_parent, daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        line.send(READY)
        while True:
            function, task = line.recv()
            _answer(line, function, task)


def _answer(line: Connection, function: Callable[[Any], Any], task: Any) -> None:
    reply: tuple[Any, BaseException | None]
    try:
        with threadpool_limits(1):
            reply = function(task), None
    except Exception as error:
        error.add_note(traceback.format_exc())
        reply = None, error
    try:
        data = pickle.dumps(reply)
    except Exception:
        data = pickle.dumps((None, RuntimeError(f"could not be sent back: {reply!r:.200}")))
    line.send_bytes(data)


def _follow_parent() -> None:
    """End this worker when its parent has gone, however it went."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
