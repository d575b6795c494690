"""Where many independent tasks are worked off: this process, local ones, a Dask cluster.

Workers are Dask's, on this machine or on many. A worker that dies is no matter: its task, or the
result that it did not hand over, is given to another one.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

from threadpoolctl import threadpool_limits

from biaxbayes.errors import InputError, RunError
from biaxbayes.executors.cluster import (
    MOST_ATTEMPTS,
    answer,
    begin_copied,
    cannot_start,
    check_workers,
    connected,
    local_cluster,
    without_log,
)

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

__all__ = ["Executor", "InThisProcess", "Outcome", "Workers", "executor_for"]

MOST_LOCAL = 4
NO_WORKER_SECONDS = 60.0
"""How long all processes of this machine may be dead before the work is given up."""
POLL_SECONDS = 0.02
STOP_SECONDS = 0.5
"""How often it is asked whether to stop, and how many workers there are."""

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """What became of a task.

    Attributes
    ----------
    index : int
        Of the task in its sequence.
    value : Any
        What the function returned; None where the task was lost.
    lost : str
        Why nothing was returned, in words; empty where something was.
    """

    index: int
    value: Result
    lost: str = ""


class Executor(Protocol):
    """Applies a function to tasks, each with one BLAS thread.

    Functions are defined at the top of a module, tasks and results can be pickled. The result of
    a task must depend on nothing but the task; then the executor changes the time and nothing
    else. In a ``with`` block the workers stay from one run to the next.
    """

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def get_ready(self) -> None:
        """Begin what takes a while before the first task; there will be one."""
        ...

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = lambda: False,
    ) -> Iterator[Outcome[Result]]:
        """Yield outcomes as they come, in any order.

        An exception of the function is raised here. Once ``stop`` says so nothing further is
        handed out, and what is under way is still yielded.

        Parameters
        ----------
        function : callable
        tasks : sequence
            What is added to it while outcomes are taken is done as well.
        stop : callable
            Asked about every second.

        Raises
        ------
        RunError
            If the workers cannot be used at all.
        """
        ...


class InThisProcess:
    """One task after the other, here."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def get_ready(self) -> None:
        """As :meth:`Executor.get_ready`: nothing."""

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = lambda: False,
    ) -> Iterator[Outcome[Result]]:
        """As :meth:`Executor.run`."""
        for index, task in enumerate(tasks):
            if stop():
                return
            with threadpool_limits(1):
                value = function(task)
            yield Outcome(index, value)


class Workers:
    """Workers of Dask: processes of this machine, or those of a cluster that is there already.

    Parameters
    ----------
    count : int
        Processes of this machine.
    scheduler : str, optional
        Address of a scheduler whose workers are used instead, as ``tcp://host:8786``.
    modules : sequence of str
        What processes of this machine import in the end, beside the module of their function.
    """

    def __init__(
        self, count: int = 0, scheduler: str | None = None, modules: Sequence[str] = ()
    ) -> None:
        self.count, self.scheduler, self.modules = count, scheduler, modules
        self._stay, self._last_seen = False, 0.0
        self._stack = contextlib.ExitStack()
        self._client: Client | None = None
        self._local: LocalCluster | None = None

    def __enter__(self) -> Self:
        self._stay = True
        if self.scheduler is not None:
            self._connected(0, ())
        return self

    def __exit__(self, *error: object) -> None:
        self._stay = False
        self._dismiss(idle=error[0] is None)

    def get_ready(self) -> None:
        """As :meth:`Executor.get_ready`."""
        if self.scheduler is None and self._client is None:
            begin_copied(self.modules)

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = lambda: False,
    ) -> Iterator[Outcome[Result]]:
        """As :meth:`Executor.run`."""
        if not tasks:
            return
        modules = tuple(m for m in (function.__module__, *self.modules) if m != "__main__")
        client = self._connected(min(self.count, len(tasks)), modules)
        ended = False
        try:
            yield from self._outcomes(client, function, tasks, stop)
            ended = True
        finally:
            if not (ended and self._stay):
                self._dismiss(idle=ended)

    def _outcomes(
        self,
        client: Client,
        function: Callable[[Any], Any],
        tasks: Sequence[Any],
        stop: Callable[[], object],
    ) -> Iterator[Outcome[Any]]:
        from distributed import as_completed

        handed_out = 0
        index_of: dict[Any, int] = {}
        done = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        asked, stopped, workers = 0.0, False, 0
        while handed_out < len(tasks) or index_of:
            if time.monotonic() - asked > STOP_SECONDS:
                asked, stopped, workers = time.monotonic(), bool(stop()), self._workers(client)
            if stopped and not index_of:
                return
            # One task a worker: were more with it, its death would count against them all.
            while handed_out < len(tasks) and not stopped and len(index_of) < workers:
                index, handed_out = handed_out, handed_out + 1
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # that a specimen is large
                    work = pickle.dumps((function, tasks[index]))
                    future = client.submit(answer, work, pure=False)
                index_of[future] = index
                done.add(future)
            batch = done.next_batch(block=False)
            # One that is given up while its result is fetched is not heard of otherwise.
            batch += [(f, None) for f in index_of if f.status == "error"]
            for future, result in batch:
                if future in index_of:
                    yield self._outcome(index_of.pop(future), future, result)
                    future.release()
                    asked = 0.0
            if not batch:
                time.sleep(POLL_SECONDS)

    def _outcome(self, index: int, future: Any, result: Any) -> Outcome[Any]:
        # The result decides: its worker may have died since, and then the future waits again.
        if isinstance(result, bytes):
            value, error = pickle.loads(result)
            if error is not None:
                raise error
            return Outcome(index, value)
        if future.status == "error":
            error = future.exception()
            if type(error).__name__ != "KilledWorker":
                raise error
            local = f"its worker process died {MOST_ATTEMPTS} times (out of memory, or killed)"
            there = "the workers that had it died (out of memory, or killed)"
            return Outcome(index, None, there if self.scheduler else local)
        raise RunError(f"{self._place}: the scheduler has gone, or has dropped the work")

    @property
    def _place(self) -> str:
        return self.scheduler or "workers of this machine"

    def _workers(self, client: Client) -> int:
        """How many workers there are now."""
        try:
            there = len(client.nthreads())
        except (OSError, ValueError, RuntimeError):
            raise RunError(f"{self._place}: the scheduler has gone") from None
        now = time.monotonic()
        if there or self.scheduler is not None:
            self._last_seen = now
        elif now - self._last_seen > NO_WORKER_SECONDS:
            raise cannot_start()
        return there

    def _connected(self, count: int, modules: Sequence[str]) -> Client:
        """A connection to workers: as many as asked for, or more, if of this machine."""
        if self._client is not None:
            if self._local is not None and count > len(self._local.workers):
                self._local.scale(count)
            return self._client
        stack = contextlib.ExitStack()
        with stack:
            stack.enter_context(without_log())
            address: Any = self.scheduler
            if address is None:
                address = self._local = stack.enter_context(local_cluster(count, modules))
            self._client = stack.enter_context(connected(address))
            if self.scheduler is not None:
                check_workers(self._client, self.scheduler)
            self._stack = stack.pop_all()
        self._last_seen = time.monotonic()
        return self._client

    def _dismiss(self, *, idle: bool) -> None:
        """Let the workers go: at once where they are not idle."""
        if self._local is not None and not idle:
            for nanny in list(self._local.workers.values()):
                nanny.close_gracefully()  # which is to say that no other is started in its place
                with contextlib.suppress(OSError, TypeError):
                    os.kill(nanny.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
        self._client = self._local = None
        stack, self._stack = self._stack, contextlib.ExitStack()
        stack.close()


def executor_for(
    workers: int | None = None,
    scheduler: str | None = None,
    *,
    isolated: bool = False,
    modules: Sequence[str] = (),
) -> Executor:
    """The executor that the options of a command ask for.

    Parameters
    ----------
    workers : int, optional
        Local processes; default the number of processors, at most four.
    scheduler : str, optional
        Address of a Dask scheduler to use instead, as ``tcp://host:8786``.
    isolated : bool
        A single worker is a process of its own as well, so that its death is not ours.
    modules : sequence of str
        As of :class:`Workers`.

    Raises
    ------
    InputError
        If both or an impossible number are given.
    """
    if scheduler is not None:
        if workers is not None:
            raise InputError(
                "--workers and --scheduler are given both",
                remedy="a cluster has the workers that were started for it",
            )
        return Workers(scheduler=scheduler)
    count: Any = min(os.cpu_count() or 1, MOST_LOCAL) if workers is None else workers
    if count < 1:
        raise InputError("--workers must be at least 1")
    return InThisProcess() if count == 1 and not isolated else Workers(count, modules=modules)
