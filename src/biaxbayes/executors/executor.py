"""What every executor promises, and which one a user asked for."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar

from threadpoolctl import threadpool_limits

from biaxbayes.errors import InputError

__all__ = ["MOST_ATTEMPTS", "Executor", "InThisProcess", "Outcome", "executor_for"]

MOST_ATTEMPTS = 3
"""A task whose worker dies this often is given up: it needs more memory than there is, say."""
MOST_LOCAL = 4

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


def executor_for(
    workers: int | None = None, scheduler: str | None = None, *, isolated: bool = False
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

    Raises
    ------
    InputError
        If both or an impossible number are given, or the scheduler cannot be used.
    """
    if scheduler is not None:
        if workers is not None:
            raise InputError(
                "--workers and --scheduler are given both",
                remedy="a cluster has the workers that were started for it",
            )
        from biaxbayes.executors.dask_cluster import DaskCluster

        return DaskCluster(scheduler)
    count: Any = min(os.cpu_count() or 1, MOST_LOCAL) if workers is None else workers
    if count < 1:
        raise InputError("--workers must be at least 1")
    if count == 1 and not isolated:
        return InThisProcess()
    from biaxbayes.executors.local_processes import LocalProcesses

    return LocalProcesses(count)
