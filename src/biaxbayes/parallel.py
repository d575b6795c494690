"""Many independent tasks: in this process, in processes of this machine, on a Dask cluster.

The result of a task must depend on nothing but the task; then the executor changes the time and
nothing else. Functions are defined at the top of a module, tasks and results can be pickled, and
linear algebra takes one thread per task.
"""

from __future__ import annotations

import contextlib
import importlib.util
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

import biaxbayes
from biaxbayes.errors import InputError, RunError

if TYPE_CHECKING:
    from distributed import Client

MOST_LOCAL = 4
MOST_ATTEMPTS = 3
"""A task whose worker dies this often is given up: it needs more memory than there is, say."""
STOP_SECONDS = 0.5
CONNECT_SECONDS, WORKER_SECONDS = 10.0, 30.0
"""How long a cluster may take to answer, and to have its first worker."""
SAME_VERSIONS = ("numpy", "scipy", "numba", "pandas")
"""Packages on which draws depend to the last digit: the same here and on a cluster."""

Task = TypeVar("Task")
Result = TypeVar("Result")


def never() -> bool:
    """Nobody stops the work."""
    return False


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """The result of a task, by the index of the task; ``lost`` says why there is none."""

    index: int
    value: Result
    lost: str = ""


class Executor(Protocol):
    """Applies a function to tasks. In a ``with`` block its workers stay from one run to the next.

    ``run`` yields outcomes as they come, in any order. An exception of the function is raised by
    it. Once ``stop()`` is true, which is asked twice a second, nothing further is handed out, and
    what is under way is still yielded.
    """

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = never,
    ) -> Iterator[Outcome[Result]]:
        """Yield the outcome of each task."""
        ...


def executor_for(
    workers: int | None = None, scheduler: str | None = None, *, isolated: bool = False
) -> Executor:
    """The executor that the options of a command ask for.

    Parameters
    ----------
    workers : int, optional
        Processes of this machine; default the number of processors, at most four.
    scheduler : str, optional
        Address of a Dask scheduler to use instead, as ``tcp://host:8786``.
    isolated : bool
        A single worker is a process of its own as well, so that its death is not ours.

    Raises
    ------
    InputError
        If both or an impossible number are given, or this process may not start others.
    """
    if scheduler is not None:
        if workers is not None:
            raise InputError(
                "`workers` and `scheduler` are given both",
                remedy="a cluster has the workers that were started for it",
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


one_call = threading.RLock()
"""Held by ``sample`` and ``plot``: other threads that call them wait.

Pandas, ArviZ and matplotlib change warning filters and settings of the process and put them back.
"""


# --- linear algebra ------------------------------------------------------------------------------

_blas_lock = threading.Lock()
_blas_users = 0
_blas_limit: Any = None


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let linear algebra take one thread: matrices are small.

    The setting is that of the process: threads that ask for it at the same time share it, and the
    last of them takes it back.
    """
    global _blas_users
    with _blas_lock:
        if _blas_users == 0:
            _in_short_thread(_limit_blas)
        _blas_users += 1
    try:
        yield
    finally:
        with _blas_lock:
            _blas_users -= 1
            if _blas_users == 0:
                _in_short_thread(_blas_limit.restore_original_limits)


def _limit_blas() -> None:
    global _blas_limit
    import scipy.linalg  # noqa: F401  # has a BLAS of its own, found only once it is loaded
    from threadpoolctl import threadpool_limits

    _blas_limit = threadpool_limits(1, user_api="blas")


def _in_short_thread(function: Callable[[], None]) -> None:
    """Threadpoolctl ignores other threads for as long as the first that set a limit lives."""
    thread = threading.Thread(target=function)
    thread.start()
    thread.join()


# --- this process --------------------------------------------------------------------------------


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
        stop: Callable[[], object] = never,
    ) -> Iterator[Outcome[Result]]:
        """As :meth:`Executor.run`."""
        for index, task in enumerate(tasks):
            if stop():
                return
            with one_blas_thread():
                value = function(task)
            yield Outcome(index, value)


# --- processes of this machine -------------------------------------------------------------------


class Processes:
    """Processes of this machine, spawned: they share nothing with this one."""

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
        stop: Callable[[], object] = never,
    ) -> Iterator[Outcome[Result]]:
        """As :meth:`Executor.run`."""
        waiting, deaths = deque(range(len(tasks))), Counter[int]()
        running: dict[Future[Result], tuple[int, _Worker]] = {}
        finished = stopped = False
        try:
            while running or (waiting and not stopped):
                stopped = stopped or bool(stop())
                busy = [worker for _, worker in running.values()]
                idle = [worker for worker in self._workers if worker not in busy]
                while waiting and not stopped and len(running) < self.count:
                    # A second attempt gets a process of its own: the worker before may have died of
                    # the task before.
                    again = deaths[waiting[0]] > 0
                    if idle and again:
                        self._remove(idle.pop())
                    worker = idle.pop() if idle and not again else self._new_worker()
                    try:
                        future = worker.submit(function, tasks[waiting[0]])
                    except BrokenProcessPool:  # it died while it had nothing to do
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

    def _new_worker(self) -> _Worker:
        self._workers.append(_Worker())
        return self._workers[-1]

    def _remove(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        worker.end()
        if not worker.has_started:
            raise RunError(
                "worker processes die as they start; in a script of your own the call must stand "
                'below if __name__ == "__main__":, or use `workers=1`'
            )

    def _end(self) -> None:
        workers, self._workers = self._workers, []
        for worker in workers:
            worker.end()


class _Worker:
    """A pool of one process: where it breaks, it is known which task was under way."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, initializer=_end_with_parent)
        chosen = multiprocessing.get_start_method(allow_none=True)
        with _signals_blocked():
            self._pid = self._pool.submit(os.getpid)
        # To spawn fixes Python's default: a host that has chosen no method may still do so.
        multiprocessing.set_start_method(chosen, force=True)

    @property
    def has_started(self) -> bool:
        return self._pid.done() and self._pid.exception() is None

    def submit(self, function: Callable[[Task], Result], task: Task) -> Future[Result]:
        return self._pool.submit(_with_one_blas_thread, function, task)

    def end(self) -> None:
        """End the process, whatever it does."""
        if self.has_started:
            with contextlib.suppress(OSError):
                os.kill(self._pid.result(), getattr(signal, "SIGKILL", signal.SIGTERM))
        self._pool.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    """What is started in here leaves the signals of the terminal to this process."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # which unblocks them as it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """In a worker: end when the process that started it ends, however it does."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _with_one_blas_thread(function: Callable[[Task], Result], task: Task) -> Result:
    with one_blas_thread():
        return function(task)


# --- a cluster -----------------------------------------------------------------------------------


class Cluster:
    """Workers of a Dask scheduler. TLS settings are those of Dask's own configuration."""

    def __init__(self, address: str) -> None:
        if importlib.util.find_spec("distributed") is None:
            raise InputError(
                "`scheduler` needs the package distributed, which is not installed",
                remedy="pip install 'biaxbayes[cluster]'",
            )
        self.address = address
        self._stack = contextlib.ExitStack()
        self._client: Client | None = None

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            self._client = stack.enter_context(_connected(self.address))
            _check_workers(self._client, self.address)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._client = None
        self._stack.close()

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = never,
    ) -> Iterator[Outcome[Result]]:
        """As :meth:`Executor.run`."""
        if self._client is None:
            with self:
                yield from self.run(function, tasks, stop=stop)
            return
        waiting, running = deque(range(len(tasks))), dict[Any, int]()
        stopped = False
        while running or (waiting and not stopped):
            stopped = stopped or bool(stop())
            # One task per worker: were more with it, its death would count against them all.
            while waiting and not stopped and len(running) < self._count_workers():
                index = waiting.popleft()
                running[self._submit(function, tasks[index])] = index
            done = [future for future in running if future.done()]
            for future in done:
                yield self._outcome(running.pop(future), future)
            if not done:
                time.sleep(STOP_SECONDS / 10)

    def _count_workers(self) -> int:
        assert self._client is not None
        try:
            return len(self._client.nthreads())
        except (OSError, ValueError, RuntimeError):
            raise RunError(f"{self.address}: the scheduler has gone") from None

    def _submit(self, function: Callable[[Any], Any], task: Any) -> Any:
        assert self._client is not None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that a specimen is large
            # Pickled here, as between any processes: Dask would hand over arrays to read only.
            work = pickle.dumps((function, task))
            return self._client.submit(_answer, work, _versions(), pure=False)

    def _outcome(self, index: int, future: Any) -> Outcome[Any]:
        from distributed import CancelledError, KilledWorker

        try:
            value, error = pickle.loads(future.result())
        except KilledWorker:
            return Outcome(index, None, "the workers that had it died (out of memory, or killed)")
        except (CancelledError, OSError):
            raise RunError(
                f"{self.address}: the scheduler has gone, or has dropped the work"
            ) from None
        if error is not None:
            raise error
        return Outcome(index, value)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    from distributed import Client

    try:
        with warnings.catch_warnings(), _signals_blocked():
            warnings.simplefilter("ignore")  # that versions of Dask differ a little
            # Never the default: what else writes files here must not ask the cluster.
            client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"`scheduler` {address[:80]}: no Dask scheduler answers there ({type(error).__name__})",
            remedy="start one with 'dask scheduler' and give the address that it prints",
        ) from None
    with contextlib.closing(client):
        yield client


def _check_workers(client: Client, address: str) -> None:
    """Refuse workers that would draw differently."""
    try:
        client.wait_for_workers(1, timeout=WORKER_SECONDS)
    except TimeoutError:
        raise InputError(
            f"`scheduler` {address}: the cluster has no workers",
            remedy=f"start some with 'dask worker {address} --nthreads 1'",
        ) from None
    here = _versions()
    for worker, there in client.run(_versions, on_error="return").items():
        if not isinstance(there, dict):
            raise InputError(
                f"the worker {worker} has no biaxbayes of this version",
                remedy=f"install biaxbayes {here['biaxbayes']} for all workers",
            )
        if there != here:
            raise _other_versions(f"the worker {worker}", there, here)


def _versions() -> dict[str, str]:
    return {"biaxbayes": biaxbayes.__version__, **{name: version(name) for name in SAME_VERSIONS}}


def _other_versions(who: str, there: dict[str, str], here: dict[str, str]) -> InputError:
    others = [name for name in here if there[name] != here[name]]
    return InputError(
        f"{who} has {', '.join(f'{name} {there[name]}' for name in others)}, here is "
        f"{', '.join(f'{name} {here[name]}' for name in others)}: the draws would differ",
        remedy="install the same versions for all workers",
    )


_one_at_a_time = threading.Lock()
"""In a worker of a cluster: one with several threads still works off one task at a time."""


def _answer(work: bytes, versions: dict[str, str]) -> bytes:
    """In a worker of a cluster: do a task; its result, or its error and where it happened."""
    import dask

    reply: tuple[Any, BaseException | None]
    # A task that writes files must not take its locks from the cluster, as xarray would.
    plain = dask.config.set(scheduler="synchronous")
    try:
        if _versions() != versions:  # a worker that came later
            raise _other_versions("a worker of the cluster", _versions(), versions)
        with _one_at_a_time, plain:
            function, task = pickle.loads(work)
            reply = _with_one_blas_thread(function, task), None
    except Exception as error:
        error.add_note(traceback.format_exc())
        reply = None, error
    try:
        return pickle.dumps(reply)
    except Exception:
        return pickle.dumps((None, RuntimeError(f"could not be sent back: {reply!r:.200}")))
