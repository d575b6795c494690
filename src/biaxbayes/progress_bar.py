"""Progress display, and a graceful stop on signals."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Any, TypeVar


@dataclass(frozen=True)
class Progress:
    """Progress of a long computation."""

    phase: str
    share: float | None = None  # completed fraction; None: unknown
    note: str = ""


OnProgress = Callable[[Progress], None]


def no_progress(progress: Progress) -> None:
    """No progress is shown."""


class Pace:
    """Progress as one line, with the time left at the pace since the work could be measured."""

    def __init__(self) -> None:
        self._since: tuple[float, float] | None = None  # clock and share

    def line(self, progress: Progress) -> str:
        """Phase, share and time left, as far as they are known."""
        share = progress.share
        if share is None:
            self._since = None
            return progress.phase
        now = time.monotonic()
        if self._since is None or share < self._since[1]:
            self._since = now, share
        begun, first = self._since
        left = (now - begun) * (1.0 - share) / (share - first) if share > first else 0.0
        text = f"{progress.phase}, {100 * share:.0f} %"
        if left < 1.0:
            return text
        return f"{text}, about {f'{left:.0f} s' if left < 90.0 else f'{left / 60:.0f} min'} left"


# --- how progress is shown: on a terminal, in a notebook, in a log file --------------------------


@contextlib.contextmanager
def terminal_line() -> Iterator[OnProgress]:
    """A line that is replaced, with a spinner."""
    from rich.console import Console
    from rich.markup import escape

    console, pace = Console(stderr=True), Pace()
    with console.status("starting") as status:

        def show(progress: Progress) -> None:
            if progress.note:
                console.print(f"biaxbayes: {progress.note}", markup=False, highlight=False)
            status.update(escape(pace.line(progress)))

        yield show


@contextlib.contextmanager
def notebook_line() -> Iterator[OnProgress]:
    """One line of text that a notebook replaces; rich would need ipywidgets."""
    from IPython.display import display

    shown, pace = "", Pace()
    line = display({"text/plain": "starting"}, raw=True, display_id=True)

    def show(progress: Progress) -> None:
        nonlocal shown
        if progress.note:
            print(f"biaxbayes: {progress.note}")
        if (text := pace.line(progress)) != shown:
            shown = text
            line.update({"text/plain": text}, raw=True)

    try:
        yield show
    finally:
        line.update({"text/plain": ""}, raw=True)


@contextlib.contextmanager
def minute_lines(every: float = 60.0) -> Iterator[OnProgress]:
    """Print notes at once and the progress each minute, by a thread: also during long steps."""
    latest, pace = "starting", Pace()
    begin, done = time.monotonic(), threading.Event()

    def show(progress: Progress) -> None:
        nonlocal latest
        latest = pace.line(progress)
        _print_note(progress)

    def repeat() -> None:
        while not done.wait(every):
            spent = f"{(time.monotonic() - begin) / 60.0:.0f} min spent"
            print(f"biaxbayes: {latest}; {spent}", file=sys.stderr, flush=True)

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield show
    finally:
        done.set()
        thread.join()


def _print_note(progress: Progress) -> None:
    if progress.note:
        print(f"biaxbayes: {progress.note}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def progress_line(*, quiet: bool) -> Iterator[OnProgress]:
    """Progress of a command; yields the callback."""
    if quiet:
        yield _print_note
        return
    live = sys.stderr.isatty() and os.environ.get("TERM", "") not in ("dumb", "unknown")
    with terminal_line() if live else minute_lines() as show:
        yield show


Verb = TypeVar("Verb", bound=Callable[..., Any])


def with_progress(verb: Verb) -> Verb:
    """Let `progress` be True or False; by default show it on a terminal and in a notebook."""

    @functools.wraps(verb)
    def watched(*arguments: Any, progress: Any = None, **options: Any) -> Any:
        with _plain_interruption():
            if callable(progress):
                return verb(*arguments, progress=progress, **options)
            shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
            in_notebook = getattr(shell, "kernel", None) is not None
            on_terminal = sys.stderr is not None and sys.stderr.isatty()
            if not (on_terminal or in_notebook if progress is None else progress):
                return verb(*arguments, **options)
            with notebook_line() if in_notebook else terminal_line() as show:
                return verb(*arguments, progress=show, **options)

    return watched  # type: ignore[return-value]


# --- a stop after the current block --------------------------------------------------------------

STOP_SIGNALS = [getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]


@contextlib.contextmanager
def _plain_interruption() -> Iterator[None]:
    """Raise a KeyboardInterrupt that compiled code wrapped in a SystemError."""
    try:
        yield
    except SystemError as error:
        cause = error.__cause__
        while isinstance(cause, SystemError):
            cause = cause.__cause__
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        raise


@contextlib.contextmanager
def graceful_stop() -> Iterator[Callable[[], int]]:
    """Yield a function for the signal received (or 0); a second signal acts at once.

    Ignored signals (nohup, a background job) stay ignored.
    """
    signal_number = 0
    if threading.current_thread() is not threading.main_thread():
        yield lambda: signal_number
        return

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal signal_number
        if signal_number:
            raise KeyboardInterrupt(number)
        signal_number = number
        with contextlib.suppress(OSError, ValueError):  # the terminal may be gone
            os.write(2, b"stopping after this block; press Ctrl-C again to stop at once\n")

    previous = {n: signal.getsignal(n) for n in STOP_SIGNALS}
    for number, handler in previous.items():
        if handler not in (signal.SIG_IGN, None):
            signal.signal(number, handle)
    try:
        with _plain_interruption():
            yield lambda: signal_number
    finally:
        for number, handler in previous.items():
            if handler is not None:
                signal.signal(number, handler)
