"""Work in a process beside this one, which goes on with something else meanwhile.

:class:`Beside` does one piece of work that is known now, :class:`Standby` gets ready now for pieces
that are known later, :class:`Partner` takes a share of one piece after the other.

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
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeAlias, TypeVar

from biaxbayes.executors.threads import one_blas_thread
from biaxbayes.progress_bar import STOPS

__all__ = ["Begin", "Beside", "Partner", "Standby", "alone", "each", "when_asked"]

Task = TypeVar("Task")
Result = TypeVar("Result")
Begin: TypeAlias = Callable[..., Callable[[], Any]]
"""Of a function and its arguments, all of which can be pickled: begins work that may be done
elsewhere, and returns what gives its result."""


class Beside(Generic[Result]):
    """Work that is begun now and whose result is taken later, within a ``with`` statement.

    Parameters
    ----------
    work : callable
        Without arguments; it writes nothing but caches, and its result can be pickled.
    workers : int
        Processors that may be used; with one the work waits for :meth:`result`.
    gives_way : bool
        Whether other processes have precedence: there is time until its result is asked for.
    """

    def __init__(
        self, work: Callable[[], Result], workers: int, *, gives_way: bool = False
    ) -> None:
        self._work = work
        self._process: Any = None
        if _may_fork(workers):
            self._answer, answer = multiprocessing.Pipe(duplex=False)
            self._process = _process(_giving_way(work) if gives_way else work, answer)

    @property
    def begun(self) -> bool:
        """Whether a process is at it; else the work waits for :meth:`result`."""
        return self._process is not None

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
            self._process.kill()  # it ignores gentler signals
            self._process.join()


class Standby(Generic[Task, Result]):
    """A process that gets ready now and works on tasks as they come, within a ``with`` statement.

    What it takes to get ready, such as imports, this process need not hold, nor is it kept waiting:
    the other one gives way.

    Parameters
    ----------
    ready : callable
        Without arguments; what is done before the first task.
    work : callable
        Of a task that can be pickled; it writes nothing but caches, and its result can be pickled.
    workers : int
        Processors that may be used; with one the tasks wait for :meth:`results`. With more, the
        first task is worked on beside the others.
    """

    def __init__(
        self, ready: Callable[[], object], work: Callable[[Task], Result], workers: int
    ) -> None:
        self._work = work
        self._tasks: list[Task] = []
        self._process: Any = None
        if not _may_fork(workers):
            return
        try:
            self._queue: Any = multiprocessing.get_context("fork").Queue()
        except OSError:  # no semaphores on this machine
            return
        self._answer, answer = multiprocessing.Pipe(duplex=False)
        working = partial(_all_worked, ready, work, self._queue)
        self._process = _process(_giving_way(working), answer, has_own=True)

    @property
    def begun(self) -> bool:
        """Whether there is a process; else the tasks wait for :meth:`results`."""
        return self._process is not None

    def begin(self, task: Task) -> None:
        """Hand a task over."""
        self._tasks.append(task)
        if self.begun:
            self._queue.put(pickle.dumps(task))  # as it is now, and refused here if it cannot be

    def results(self) -> list[Result]:
        """Results of all tasks in their order; exceptions are raised here."""
        if self.begun:
            self._queue.put(None)
            with contextlib.suppress(EOFError, OSError), self._answer:
                found: list[Result] = self._answer.recv()
                self._process.join()
                return found
        return [self._work(task) for task in self._tasks]  # why it failed there is best seen here

    def __enter__(self) -> Standby[Task, Result]:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process: nobody will hand tasks to it."""
        if self.begun:
            self._process.kill()
            self._process.join()
            self._queue.cancel_join_thread()
            self._queue.close()


def _all_worked(
    ready: Callable[[], object], work: Callable[[Task], Result], queue: Any
) -> list[Result]:
    """Results of the tasks of a queue, which ends with None."""
    ready()
    first = queue.get()
    if first is None:
        return []
    with Beside(lambda: work(pickle.loads(first)), 2) as longest:
        others = [work(pickle.loads(task)) for task in iter(queue.get, None)]
        return [longest.result(), *others]


class Partner:
    """A process that is handed one piece of work after the other, within a ``with`` statement.

    Linear algebra there takes one processor, as it must in what is done here meanwhile if the
    results are to be the same.

    Parameters
    ----------
    workers : int
        Processors that may be used; with one the work waits until its result is asked for.
    of : object, optional
        Its methods can be begun by their names: the process has it as it is now.
    modules : sequence of str
        What the process imports before its first piece of work.
    gives_way : bool
        As in :class:`Beside`.
    """

    def __init__(
        self,
        workers: int,
        *,
        of: object = None,
        modules: Sequence[str] = (),
        gives_way: bool = False,
    ) -> None:
        self._of = of
        self._busy = False
        self._process: Any = None
        if _may_fork(workers):
            self._pipe, there = multiprocessing.Pipe()
            work = partial(_answer_all, of, modules, there)
            self._process = _process(_giving_way(work) if gives_way else work, there)

    @property
    def begun(self) -> bool:
        """Whether there is a process."""
        return self._process is not None

    @property
    def is_free(self) -> bool:
        """Whether there is a process that has nothing to do."""
        return self.begun and not self._busy

    def begin(self, function: Callable[..., Any] | str, *arguments: Any) -> Callable[[], Any]:
        """Begin work; what returns its result, and raises its exceptions here.

        Where the process has died, or is not free, it is done when its result is asked for.

        Parameters
        ----------
        function : callable or str
            One that can be pickled, or the name of a method. It writes nothing but caches.
        *arguments
            They and the result can be pickled.
        """
        here = partial(_called, self._of, function, *arguments)
        if not self.is_free:
            return here
        try:
            self._pipe.send((function, arguments))
        except OSError:
            self._dismiss()
            return here
        self._busy = True
        return partial(self._result, here)

    def _result(self, here: Callable[[], Any]) -> Any:
        """What came back; else the work is done here: why it failed there is best seen here."""
        self._busy = False
        try:
            return self._pipe.recv()
        except (EOFError, OSError):
            self._dismiss()
            return here()

    def _dismiss(self) -> None:
        if self.begun:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None

    def __enter__(self) -> Partner:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process: nobody will hand work to it."""
        self._dismiss()


def _called(of: object, function: Callable[..., Any] | str, *arguments: Any) -> Any:
    """The result of a function, or of the method of that name."""
    return (getattr(of, function) if isinstance(function, str) else function)(*arguments)


def _answer_all(of: object, modules: Sequence[str], pipe: Connection) -> None:
    """Do the work that comes through a pipe, until it ends."""
    for name in modules:
        import_module(name)
    with one_blas_thread():
        while True:
            function, arguments = pipe.recv()
            pipe.send(_called(of, function, *arguments))


def each(function: Callable[[Task], Result], tasks: Sequence[Task]) -> list[Result]:
    """The results of a function of each of several tasks."""
    return [function(task) for task in tasks]


def when_asked(function: Callable[..., Result], *arguments: Any) -> Callable[[], Result]:
    """Begin nothing: the work is done here, when its result is asked for."""
    return partial(function, *arguments)


def _may_fork(workers: int) -> bool:
    """Whether there are processors for it, and forking is safe."""
    return workers > 1 and sys.platform == "linux" and alone()


def _process(work: Callable[[], Any], end: Connection, *, has_own: bool = False) -> Any:
    """A process at work that has an end of a pipe, and perhaps processes of its own; None: none."""
    context = multiprocessing.get_context("fork")
    arguments = (work, end, os.getpid())
    process = context.Process(target=_send, args=arguments, daemon=not has_own)
    with end, contextlib.suppress(OSError):  # no memory, no more processes
        process.start()
        return process
    return None


def alone() -> bool:
    """Whether no other thread runs that may hold a lock, which a forked process waits for forever.

    That of a progress bar holds none but its own.
    """
    others = set(threading.enumerate()) - {threading.current_thread()}
    return all(type(thread).__module__.startswith("rich.") for thread in others)


GIVES_WAY = 7
"""How much nicer, of at most 20: beside another on one processor it gets a sixth of it. With 5, who
began the work is slowed down; with 10, what draws waits long on a machine that others use."""


def _giving_way(work: Callable[[], Result]) -> Callable[[], Result]:
    def nicely() -> Result:
        os.nice(GIVES_WAY)
        return work()

    return nicely


PR_SET_PDEATHSIG = 1  # of prctl(2)


def _send(work: Callable[[], Any], answer: Connection, parent: int) -> None:
    with contextlib.suppress(OSError, AttributeError):  # where it is not to be had
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return
    for number in STOPS:  # the terminal sends them to all; who began this work answers them
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(BaseException):
        answer.send(work())
