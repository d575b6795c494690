"""What all ways to work off tasks share: outcomes, and settings that belong to a whole process."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """The result of a task, by the index of the task; ``lost`` says why there is none."""

    index: int
    value: Result
    lost: str = ""


def no_stop() -> bool:
    """Nobody stops the work."""
    return False


one_call = threading.RLock()
"""Locked by ``sample`` and ``plot``: other threads that call them wait.

Pandas, ArviZ and matplotlib change warning filters and settings of the process and put them back.
"""

_blas_lock = threading.Lock()
_blas_users = 0
_blas_limit: Any = None


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra of the process to one thread, until the last caller leaves."""
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
    import scipy.linalg  # noqa: F401  # has a BLAS of its own, seen only once it is loaded
    from threadpoolctl import threadpool_limits

    _blas_limit = threadpool_limits(1, user_api="blas")


def _in_short_thread(function: Callable[[], None]) -> None:
    """Threadpoolctl ignores other threads for as long as the first that set a limit lives."""
    thread = threading.Thread(target=function)
    thread.start()
    thread.join()


def with_one_blas_thread(function: Callable[[Task], Result], task: Task) -> Result:
    """Do a task."""
    with one_blas_thread():
        return function(task)
