"""Workers of a Dask cluster that is there already, on this machine or on many.

A worker that dies is no matter: the scheduler gives its tasks to another one.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self

from threadpoolctl import threadpool_limits

import biaxbayes
from biaxbayes.errors import InputError, RunError
from biaxbayes.executors.executor import Outcome, Result, Task

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["DaskCluster"]

CONNECT_SECONDS = 10.0
WORKER_SECONDS = 30.0
"""How long a cluster may take to have its first worker."""
POLL_SECONDS = 1.0
ONE_AT_A_TIME = threading.Lock()
"""In a worker: a worker with several threads still works off one task at a time."""


class DaskCluster:
    """Workers of a Dask cluster.

    Parameters
    ----------
    scheduler : str
        Address of the scheduler, as ``tcp://host:8786``.

    Raises
    ------
    InputError
        If Dask is not installed here.
    """

    def __init__(self, scheduler: str) -> None:
        try:
            import distributed  # noqa: F401
        except ImportError:
            raise InputError(
                "--scheduler needs dask.distributed", remedy="pip install 'biaxbayes[cluster]'"
            ) from None
        self.scheduler = scheduler
        self._kept: Client | None = None

    def __enter__(self) -> Self:
        self._kept = self._connected()
        return self

    def __exit__(self, *error: object) -> None:
        if self._kept is not None:
            _close(self._kept)
        self._kept = None

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        stop: Callable[[], object] = lambda: False,
    ) -> Iterator[Outcome[Result]]:
        """As :meth:`~biaxbayes.executors.executor.Executor.run`."""
        if not tasks:
            return
        client = self._kept or self._connected()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that a specimen is large
                futures = [client.submit(_alone, function, t, pure=False) for t in tasks]
            index_of = {future: index for index, future in enumerate(futures)}
            del futures  # a future that nobody holds is forgotten by the scheduler
            with _without_log():
                yield from self._outcomes(client, index_of, stop)
        finally:
            if client is not self._kept:
                _close(client)

    def _outcomes(
        self, client: Client, index_of: dict[Any, int], stop: Callable[[], object]
    ) -> Iterator[Outcome[Any]]:
        ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        for future in index_of:
            future.add_done_callback(ended.put)
        cancelled = False
        while index_of:
            if not cancelled and stop():
                cancelled = True
                for future in _not_begun(client, index_of):
                    del index_of[future]
                    future.cancel()
                continue
            try:
                future = ended.get(timeout=POLL_SECONDS)
            except queue.Empty:
                continue
            if future in index_of:  # one that was cancelled ends as well
                yield self._outcome(index_of.pop(future), future)
                future.release()

    def _outcome(self, index: int, future: Any) -> Outcome[Any]:
        if future.status == "finished":
            return Outcome(index, future.result())
        if future.status == "error":
            error = future.exception()
            if type(error).__name__ == "KilledWorker":
                return Outcome(
                    index, None, "the workers that had it died (out of memory, or killed)"
                )
            raise error
        raise RunError(f"{self.scheduler}: the scheduler has gone, or has dropped the work")

    def _connected(self) -> Client:
        """A connection to a cluster that has workers, and workers that have what is here."""
        with _without_log():
            client = self._client()
            try:
                self._check_workers(client)
            except BaseException:
                client.close()
                raise
        return client

    def _client(self) -> Any:
        from distributed import Client

        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that versions of Dask differ a little
                # Never the default: what else writes files here must not ask the cluster.
                return Client(self.scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--scheduler {self.scheduler[:80]}: no Dask scheduler answers there "
                f"({type(error).__name__})",
                remedy="start one with 'dask scheduler' and give the address that it prints",
            ) from None

    def _check_workers(self, client: Client) -> None:
        """The workers must run what is run here, or the results would depend on who had a task."""
        try:
            client.wait_for_workers(1, timeout=WORKER_SECONDS)
        except TimeoutError:
            raise InputError(
                f"--scheduler {self.scheduler}: the cluster has no workers",
                remedy=f"start some with 'dask worker {self.scheduler} --nthreads 1'",
            ) from None
        for address, found in client.run(_version, on_error="return").items():
            if found != biaxbayes.__version__:
                has = found if isinstance(found, str) else "no biaxbayes"
                raise InputError(
                    f"the worker {address} has {has}, here is {biaxbayes.__version__}",
                    remedy="install the same version for all workers",
                )


def _not_begun(client: Client, futures: Any) -> list[Any]:
    """Futures that no worker has begun with."""
    begun = {key for keys in client.processing().values() for key in keys}
    return [f for f in futures if not f.done() and f.key not in begun]


def _close(client: Client) -> None:
    with _without_log():
        client.close()


@contextlib.contextmanager
def _without_log() -> Iterator[None]:
    """A worker that dies is not worth a page of log messages in the user's terminal."""
    names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] == "distributed"]
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


# --- in the worker -------------------------------------------------------------------------


def _alone(function: Callable[[Task], Result], task: Task) -> Result:
    import dask

    # A task that writes files must not take its locks from the cluster, as xarray would.
    plain = dask.config.set(scheduler="synchronous")
    with ONE_AT_A_TIME, threadpool_limits(1), plain:
        return function(task)


def _version() -> str:
    return biaxbayes.__version__
