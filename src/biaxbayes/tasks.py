"""The interface of executors, and settings of the whole process: BLAS threads and a lock."""

from __future__ import annotations

import contextlib
import os
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np


@dataclass(frozen=True)
class Outcome:
    """The result of a task by its index; ``failure`` is the reason if there is none."""

    index: int
    value: Any
    failure: str = ""


DEFAULT_WORKERS = min(os.cpu_count() or 1, 4)
"""Processors that are used unless another number is asked for."""
Work = Callable[[Any], Any]
"""A function of one task, which other processes can import."""
Stop = Callable[[], int]
"""Whether to stop, as after a signal, whose number it is."""


def no_stop() -> bool:
    """Never stop."""
    return False


class Executor:
    """Applies a function to tasks: here, one after the other.

    Others have workers, which in a ``with`` block stay between runs.
    """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass  # without workers nothing ends

    def run(
        self, function: Work, tasks: Sequence[Any], *, stop: Stop = no_stop
    ) -> Iterator[Outcome]:
        """Yield the outcome of each task as it comes, in any order.

        Once ``stop()`` is true, nothing further starts, and running tasks are still yielded.
        """
        for index, task in enumerate(tasks):
            if stop():
                return
            yield Outcome(index, with_one_blas_thread(function, task))


process_lock = threading.RLock()
"""Lock of ``sample`` and ``plot``, since pandas, ArviZ and matplotlib temporarily change warning
filters and settings of the process."""

usual_numpy_errors = np.errstate(all="warn", under="ignore")
"""Decorator of what users call: NumPy's own settings, whatever the caller made of them by
``np.seterr``. Densities underflow as a rule."""


@contextlib.contextmanager
def kept_warning_filters() -> Iterator[None]:
    """Keep the warning filters of the process, to which xarray adds one as it reads."""
    with process_lock, warnings.catch_warnings():
        yield


_blas_lock = threading.Lock()
_blas_users = 0
_blas_limit: Any = None


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra of the process to one thread, until the last caller leaves."""
    global _blas_users
    with _blas_lock:
        if _blas_users == 0:
            _run_in_thread(_limit_blas)
        _blas_users += 1
    try:
        yield
    finally:
        with _blas_lock:
            _blas_users -= 1
            if _blas_users == 0:
                _run_in_thread(_blas_limit.restore_original_limits)


def _limit_blas() -> None:
    global _blas_limit
    import scipy.linalg  # noqa: F401  # has a BLAS of its own, seen only once it is loaded

    duplicate = os.environ.get("KMP_DUPLICATE_LIB_OK")
    from threadpoolctl import threadpool_limits  # sets the variable

    if duplicate is None:
        os.environ.pop("KMP_DUPLICATE_LIB_OK", None)

    _blas_limit = threadpool_limits(1, user_api="blas")


def _run_in_thread(function: Callable[[], None]) -> None:
    """Run in a short thread: threadpoolctl ignores other threads while the first caller lives."""
    thread = threading.Thread(target=function)
    thread.start()
    thread.join()


def with_one_blas_thread(function: Work, task: Any) -> Any:
    """Call a function with one thread for linear algebra."""
    with one_blas_thread():
        return function(task)
