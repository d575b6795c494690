"""Tasks on the workers of a Dask scheduler, whose draws must be those of this machine."""

from __future__ import annotations

import importlib.util
import pickle
import threading
import time
import traceback
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Self

import biaxbayes
from biaxbayes.errors import InputError, RunError
from biaxbayes.tasks import Executor, Outcome, Stop, Work, no_stop, with_one_blas_thread

if TYPE_CHECKING:
    from distributed import Client

CONNECT_SECONDS, WORKER_SECONDS = 10.0, 30.0
"""Time limits for the answer of a cluster, and for its first worker."""
POLL_SECONDS = 0.05
SAME_VERSIONS = ("numpy", "scipy", "numba", "pandas")
"""Packages that change draws in the last digit, so that their versions must be equal."""


class Cluster(Executor):
    """Workers of a Dask scheduler. TLS settings are those of Dask's own configuration."""

    def __init__(self, address: str) -> None:
        if importlib.util.find_spec("distributed") is None:
            problem = "`scheduler` needs the package distributed, which is not installed"
            raise InputError(problem, remedy="pip install 'biaxbayes[cluster]'")
        self.address = address
        self._client: Client | None = None

    def __enter__(self) -> Self:
        from distributed import Client, Security
        from distributed.comm import get_address_host_port, normalize_address

        try:
            # Refused before there is a client: one that fails half-way is closed by the garbage
            # collector, which waits for ever where it does so while the next client starts.
            address = normalize_address(self.address)
            get_address_host_port(address)
            certificates = Security().get_connection_args("client").get("ssl_context")
            if address.startswith("tls://") and certificates is None:
                raise ValueError("Dask's configuration names no TLS certificates")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # slightly different versions of Dask
                # not the default client, so that writing files here does not use the cluster
                client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            reason = type(error).__name__ if isinstance(error, OSError) else str(error)
            there = f"`scheduler` {self.address[:80]}: no Dask scheduler answers there"
            remedy = "start one with 'dask scheduler' and give the address that it prints"
            raise InputError(f"{there} ({reason})", remedy=remedy) from None
        try:
            client.wait_for_workers(1, timeout=WORKER_SECONDS)
        except TimeoutError:
            client.close()
            problem = f"`scheduler` {self.address}: the cluster has no workers"
            remedy = f"start some with 'dask worker {self.address} --nthreads 1'"
            raise InputError(problem, remedy=remedy) from None
        self._client = client
        return self

    def __exit__(self, *error: object) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def run(
        self, function: Work, tasks: Sequence[Any], *, stop: Stop = no_stop
    ) -> Iterator[Outcome]:
        """Run the tasks on the cluster; see :meth:`Executor.run`."""
        if self._client is None:
            with self:
                yield from self.run(function, tasks, stop=stop)
            return
        client = self._client
        waiting, running = deque(range(len(tasks))), dict[Any, int]()
        stopped = False
        while running or (waiting and not stopped):
            stopped = stopped or bool(stop())
            try:
                workers = len(client.nthreads())
            except (OSError, ValueError, RuntimeError):
                raise RunError(f"{self.address}: lost the connection to the scheduler") from None
            # One task per worker, since its death counts against all of its tasks.
            while waiting and not stopped and len(running) < workers:
                index = waiting.popleft()
                # pickled here, because Dask would make arrays read-only
                work = pickle.dumps((function, tasks[index]))
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # large specimens
                    running[client.submit(_answer, work, package_versions(), pure=False)] = index
            done = [future for future in running if future.done()]
            for future in done:
                yield self._outcome(running.pop(future), future)
            if not done:
                time.sleep(POLL_SECONDS)

    def _outcome(self, index: int, future: Any) -> Outcome:
        from distributed import CancelledError, KilledWorker

        try:
            value, error = pickle.loads(future.result())
        except (ModuleNotFoundError, AttributeError):
            problem = "a worker of the cluster has no biaxbayes of this version"
            remedy = f"install biaxbayes {biaxbayes.__version__} for all workers"
            raise InputError(problem, remedy=remedy) from None
        except KilledWorker:
            return Outcome(index, None, "the workers that had it died (out of memory, or killed)")
        except (CancelledError, OSError):
            problem = f"{self.address}: lost the connection to the scheduler, or the task"
            raise RunError(problem) from None
        if error is not None:
            raise error
        return Outcome(index, value)


def package_versions() -> dict[str, str]:
    """Versions on which the draws depend."""
    return {"biaxbayes": biaxbayes.__version__, **{name: version(name) for name in SAME_VERSIONS}}


_one_at_a_time = threading.Lock()
"""In a worker of a cluster: one task at a time, also with several threads."""


def _answer(work: bytes, versions: dict[str, str]) -> bytes:
    """In a worker: do a task and return its result, or its error with its place."""
    import dask

    reply: tuple[Any, BaseException | None]
    # xarray would otherwise take its file locks from the cluster
    plain = dask.config.set(scheduler="synchronous")
    try:
        own = package_versions()
        if others := [name for name in versions if own[name] != versions[name]]:
            there, here = (
                ", ".join(f"{name} {each[name]}" for name in others) for each in (own, versions)
            )
            problem = f"a worker of the cluster has {there}, here is {here}: the draws would differ"
            raise InputError(problem, remedy="install the same versions for all workers")
        with _one_at_a_time, plain:
            function, task = pickle.loads(work)
            reply = with_one_blas_thread(function, task), None
    except Exception as error:
        error.add_note(traceback.format_exc())
        reply = None, error
    try:
        return pickle.dumps(reply)
    except Exception:
        return pickle.dumps((None, RuntimeError(f"could not be sent back: {reply!r:.200}")))
