"""Dask clusters: processes of this machine, or one that is there already, and what they run."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import pickle
import signal
import tempfile
import threading
import traceback
import warnings
from collections.abc import Iterator, Sequence
from multiprocessing import forkserver
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

import biaxbayes
from biaxbayes.errors import InputError, RunError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

__all__ = [
    "MOST_ATTEMPTS",
    "answer",
    "begin_copied",
    "cannot_start",
    "check_workers",
    "connected",
    "local_cluster",
    "without_log",
]

MOST_ATTEMPTS = 3
"""A task whose worker dies this often is given up: it needs more memory than there is, say."""
CONNECT_SECONDS = 10.0
WORKER_SECONDS = 30.0
"""How long a cluster may take to have its first worker."""
ONE_AT_A_TIME = threading.Lock()
"""In a worker: a worker with several threads still works off one task at a time."""


def begin_copied(modules: Sequence[str]) -> None:
    """Begin the process that workers of this machine are copies of, where there is one.

    It imports Dask and the modules while this process goes on; where it runs already, nothing is
    done.
    """
    if "forkserver" in multiprocessing.get_all_start_methods():
        with _signals_kept():
            context = multiprocessing.get_context("forkserver")
            context.set_forkserver_preload(["distributed", *modules])
            forkserver.ensure_running()


@contextlib.contextmanager
def local_cluster(count: int, modules: Sequence[str] = ()) -> Iterator[LocalCluster]:
    """Processes of this machine, reachable from nowhere else.

    Parameters
    ----------
    count : int
    modules : sequence of str
        What the workers import in the end: imported once where they are copies of one process.
    """
    begin_copied(modules)
    import dask
    from distributed import LocalCluster

    options: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": MOST_ATTEMPTS - 1,
        "distributed.scheduler.worker-ttl": None,
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
        "distributed.worker.profile.enabled": False,
    }
    if "forkserver" in multiprocessing.get_all_start_methods():
        # a process without threads, in which all is imported
        options["distributed.worker.multiprocessing-method"] = "forkserver"
    with tempfile.TemporaryDirectory(prefix="biaxbayes-") as scratch, dask.config.set(options):
        others = set(multiprocessing.active_children())
        with _signals_kept():
            try:
                cluster = LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                    memory_limit=0,
                    local_directory=scratch,
                    silence_logs=logging.CRITICAL,
                )
            except RuntimeError:
                raise cannot_start() from None
        try:
            yield cluster
        finally:
            _close(cluster, others)


def _close(cluster: LocalCluster, others: set[multiprocessing.process.BaseProcess]) -> None:
    """Close a cluster, and end its processes where Dask loses them: not ``others``.

    Where a worker dies as it starts, Dask takes that for the failure of the next one, and stumbles
    over it as it closes.
    """
    from distributed.core import Status

    try:
        cluster.close()
    except AssertionError:
        cluster.status = Status.failed  # else it waits for itself
        cluster.close()
        for process in set(multiprocessing.active_children()) - others:
            if process.name.startswith("Dask Worker"):
                process.kill()


def cannot_start() -> RunError:
    """What to say where no worker process of this machine lives."""
    return RunError(
        "worker processes die as they start; in a script of your own the call must stand "
        'below if __name__ == "__main__":, and on the command line use --workers 1'
    )


@contextlib.contextmanager
def _signals_kept() -> Iterator[None]:
    """Threads and processes started in here leave the signals of the terminal to this thread."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # which would unblock them
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def connected(address: Any) -> Iterator[Client]:
    """A connection to a cluster, by its address or itself."""
    from distributed import Client

    try:
        with warnings.catch_warnings(), _signals_kept():
            warnings.simplefilter("ignore")  # that versions of Dask differ a little
            # Never the default: what else writes files here must not ask the cluster.
            client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {str(address)[:80]}: no Dask scheduler answers there "
            f"({type(error).__name__})",
            remedy="start one with 'dask scheduler' and give the address that it prints",
        ) from None
    with contextlib.closing(client):
        yield client


def check_workers(client: Client, scheduler: str) -> None:
    """The workers must run what is run here, or the results would depend on who had a task."""
    try:
        client.wait_for_workers(1, timeout=WORKER_SECONDS)
    except TimeoutError:
        raise InputError(
            f"--scheduler {scheduler}: the cluster has no workers",
            remedy=f"start some with 'dask worker {scheduler} --nthreads 1'",
        ) from None
    for address, found in client.run(_version, on_error="return").items():
        if found != biaxbayes.__version__:
            has = found if isinstance(found, str) else "no biaxbayes"
            raise InputError(
                f"the worker {address} has {has}, here is {biaxbayes.__version__}",
                remedy="install the same version for all workers",
            )


@contextlib.contextmanager
def without_log() -> Iterator[None]:
    """A worker that dies is not worth a page of log messages in the user's terminal."""
    import distributed  # noqa: F401

    names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] == "distributed"]
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


# --- in the worker -------------------------------------------------------------------------------


def answer(work: bytes) -> bytes:
    """Do a task: its result, or its error and where it happened, as bytes."""
    import dask

    reply: tuple[Any, BaseException | None]
    # A task that writes files must not take its locks from the cluster, as xarray would.
    plain = dask.config.set(scheduler="synchronous")
    try:
        # Pickled here, as between any processes: Dask would hand over arrays to read only.
        with ONE_AT_A_TIME, threadpool_limits(1), plain:
            function, task = pickle.loads(work)
            reply = function(task), None
    except Exception as error:
        error.add_note(traceback.format_exc())
        reply = None, error
    try:
        return pickle.dumps(reply)
    except Exception:
        return pickle.dumps((None, RuntimeError(f"could not be sent back: {reply!r:.200}")))


def _version() -> str:
    return biaxbayes.__version__
