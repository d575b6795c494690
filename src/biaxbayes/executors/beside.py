"""One piece of work in a process beside this one, which goes on with something else meanwhile.

The process is forked, so that nothing has to be sent to it or imported again. Where that is not
safe (other threads may hold locks, and not all systems fork well) the work is done here, when its
result is asked for. The result is the same either way. It never outlives whoever began it: it holds
what it was forked with, the lock of a run folder too.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

__all__ = ["Beside"]

Result = TypeVar("Result")


class Beside(Generic[Result]):
    """Work that is begun now and whose result is taken later, within a ``with`` statement.

    Parameters
    ----------
    work : callable
        Without arguments; it writes nothing but caches, and its result can be pickled.
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
        arguments = (work, answer, os.getpid())
        self._process = context.Process(target=_send, args=arguments, daemon=True)
        with answer, contextlib.suppress(OSError):  # no memory, no more processes
            self._process.start()

    @property
    def begun(self) -> bool:
        """Whether a process is at it; else the work waits for :meth:`result`."""
        return self._process is not None and self._process.pid is not None

    def result(self) -> Result:
        """What the work returned; its exceptions are raised here."""
        if self.begun:
            with contextlib.suppress(EOFError, OSError), self._answer:
                found: Result = self._answer.recv()
                self._process.join()
                return found
            self._process.join()
        return self._work()  # it failed there: why is best seen here

    def __enter__(self) -> Beside[Result]:
        return self

    def __exit__(self, *_: object) -> None:
        """End the work, if it is still going on: nobody will ask for its result."""
        if self.begun:
            self._process.kill()  # its handlers of gentler signals are those of a run
            self._process.join()


def _alone() -> bool:
    """Whether no other thread runs that may hold a lock, which a forked process waits for forever.

    That of a progress bar holds none but its own.
    """
    others = set(threading.enumerate()) - {threading.current_thread()}
    return all(type(thread).__module__.startswith("rich.") for thread in others)


PR_SET_PDEATHSIG = 1  # of prctl(2)


def _send(work: Callable[[], Any], answer: Connection, parent: int) -> None:
    with contextlib.suppress(OSError, AttributeError):  # where it is not to be had
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return
    with contextlib.suppress(BaseException):
        answer.send(work())
