"""Progress on a terminal, stops that finish the block first, and words for the state of a run."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.progress_bar import shown_progress

if TYPE_CHECKING:
    from biaxbayes.runs.run import Run

__all__ = [
    "StoppedAtOnce",
    "graceful_stop",
    "open_usable_run",
    "progress_line",
]


# --- progress on a terminal, silence elsewhere; and a stop that finishes the block first ---------


STOPS = [getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]


class StoppedAtOnce(KeyboardInterrupt):
    """A second signal came; its number is the argument."""


@contextlib.contextmanager
def progress_line(*, quiet: bool) -> Iterator[Callable[[Any], None]]:
    """A live line with phase, share and times; yields what to call with each Progress.

    Notes are printed whether the line is shown or not.
    """
    if quiet or not sys.stderr.isatty():
        yield _tell_note
        return
    from rich.console import Console

    with shown_progress(Console(stderr=True)) as tell:
        yield tell


def _tell_note(progress: Any) -> None:
    if progress.note:
        print(f"biaxbayes: {progress.note}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def graceful_stop() -> Iterator[Callable[[], int]]:
    """Turn the first Ctrl-C, SIGTERM or hang-up into a request; the second acts at once.

    Signals that whoever started the program had ignored (nohup, a shell's background job) stay
    ignored.

    Yields
    ------
    callable
        The number of the signal once a stop was asked for, else 0.
    """
    asked = 0
    if threading.current_thread() is not threading.main_thread():
        yield lambda: asked
        return

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise StoppedAtOnce(number)
        asked = number
        with contextlib.suppress(OSError, ValueError):  # the terminal may be gone
            os.write(2, b"stopping after this block; once more to stop at once\n")

    previous = {n: signal.getsignal(n) for n in STOPS}
    for number, handler in previous.items():
        if handler not in (signal.SIG_IGN, None):
            signal.signal(number, handle)
    try:
        yield lambda: asked
    finally:
        for number, handler in previous.items():
            if handler is not None:
                signal.signal(number, handler)


# --- opening a run for what builds on it: draws that have not converged are refused, or used ------


def open_usable_run(path: Path, *, anyway: bool) -> Run:
    """Open a run folder.

    Parameters
    ----------
    path : Path
    anyway : bool
        Take draws that the run itself calls unusable.

    Raises
    ------
    RunError
        If the folder is no run, or its draws are not those of a GOH posterior.
    NotConverged
        If its draws are unusable and ``anyway`` is not given.
    """
    from biaxbayes import api

    run = api.usable_run(path, anyway=anyway)
    if run.state == "unusable":
        click.echo("warning: the chains of this run have not converged", err=True)
    elif run.state == "tentative":
        click.echo("note: this run is tentative: few effective draws", err=True)
    return run
