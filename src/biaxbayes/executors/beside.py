"""One piece of work in a process beside this one, which goes on with something else meanwhile.

The process is forked, so that nothing has to be sent to it or imported again. Where that is not
safe (other threads may hold locks, and not all systems fork well) the work is done here, when its
result is asked for. The result is the same either way.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

__all__ = ["Beside"]

Result = TypeVar("Result")


class Beside(Generic[Result]):
    """Work that is begun now and whose result is taken later.

    Parameters
    ----------
    work : callable
        Without arguments; it writes nothing, and its result can be pickled.
    workers : int
        Processors that may be used; with one the work waits for :meth:`result`.
    """

    def __init__(self, work: Callable[[], Result], workers: int) -> None:
        self._work = work
        self._process: Any = None
        if workers < 2 or sys.platform != "linux" or not _alone():
            return
        context = multiprocessing.get_context("fork")
        self._answer, answer = context.Pipe(duplex=False)
        self._process = context.Process(target=_send, args=(work, answer), daemon=True)
        with answer, contextlib.suppress(OSError):  # no memory, no more processes
            self._process.start()

    def result(self) -> Result:
        """What the work returned; its exceptions are raised here."""
        if self._process is not None and self._process.pid is not None:
            with contextlib.suppress(EOFError, OSError), self._answer:
                found: Result = self._answer.recv()
                self._process.join()
                return found
            self._process.join()
        return self._work()  # it failed there: why is best seen here


def _alone() -> bool:
    """Whether no other thread runs that may hold a lock, which a forked process waits for forever.

    That of a progress bar holds none but its own.
    """
    others = set(threading.enumerate()) - {threading.current_thread()}
    return all(type(thread).__module__.startswith("rich.") for thread in others)


def _send(work: Callable[[], Any], answer: Connection) -> None:
    with contextlib.suppress(BaseException):
        answer.send(work())
