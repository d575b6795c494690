"""The command line: a group of verbs, their errors as one line and an exit code.

A verb's module is imported when the verb is called, so that ``biaxbayes --help`` answers at once.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from importlib import import_module
from types import FrameType
from typing import Any

import click

from biaxbayes.errors import BiaxbayesError, InputError, as_options, printable
from biaxbayes.text_files import os_error_text
from biaxbayes.verbs import VERBS


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Verbs in the order of the help page."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the command of a verb."""
        if cmd_name not in VERBS:
            return None
        command: click.Command = import_module(f"biaxbayes.verbs.{cmd_name}").command
        # in raw docstrings click's mark of a preformatted paragraph is two characters
        command.help = (command.help or "").replace("\\b\n", "\b\n")
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Call a verb; its errors name Python arguments, which become options here."""
        try:
            return super().invoke(ctx)
        except BiaxbayesError as error:
            command = self.get_command(ctx, ctx.invoked_subcommand or "")
            flags = {p.name: p.opts[0] for p in command.params if p.name} if command else {}
            error.args = (as_options(str(error), flags),)
            raise

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[Any, Any, list[str]]:
        """Refuse an unknown verb, naming the nearest one."""
        if args and args[0] not in VERBS and not args[0].startswith("-"):
            from difflib import get_close_matches

            close = get_close_matches(args[0].lower(), VERBS, n=1, cutoff=0.6)
            hint = f"did you mean {close[0]}?" if close else f"commands are {', '.join(VERBS)}"
            raise InputError(f"unknown command {args[0][:40]!r}", remedy=hint)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs with their descriptions without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="biaxbayes")
def group() -> None:
    """Material parameters and mounting stretches of soft tissue from planar biaxial tests.

    Start with: biaxbayes sample specimen.csv
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; errors become one line and an exit code.

    Exit codes: 0 done, 2 an input, option or file that cannot be used, 3 ran but the result
    cannot be trusted, 70 a defect of this program (``BIAXBAYES_DEBUG=1`` shows where), and 128
    plus the signal when stopped by one.
    """
    # Streams that the caller closed (2>&-): output to them is discarded.
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115, PTH123
    with contextlib.suppress(AttributeError, ValueError):
        # Names from files may hold characters that the terminal's encoding lacks.
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    # Matrices are small: with two threads `sample` takes an eighth more processor time, and longer.
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy is imported
    os.environ["MPLBACKEND"] = "agg"  # an inherited backend of a notebook may not exist here
    # ArviZ 0.23 announces ArviZ 1 once a day.
    warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
    try:
        with _ended_by_signals():
            sys.exit(_outcome(arguments))
    except BrokenPipeError:
        # The reader of the output has closed it; nothing may be flushed into it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does, with the processes that it started."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt(number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    usual = [n for n in numbers if signal.getsignal(n) is signal.SIG_DFL]
    if threading.current_thread() is not threading.main_thread():
        usual = []
    for number in usual:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in usual:
            signal.signal(number, signal.SIG_DFL)


def _outcome(arguments: list[str] | None) -> int:
    """Exit code of a command line, its error printed."""
    try:
        outcome: Any = group.main(arguments, prog_name="biaxbayes", standalone_mode=False)
        sys.stdout.flush()
    except BiaxbayesError as error:
        return _ended(str(error), error.exit_code)
    except (click.exceptions.Abort, KeyboardInterrupt) as error:
        # the exception of a second signal has its number
        cause = error.__cause__ if isinstance(error, click.exceptions.Abort) else error
        if isinstance(cause, EOFError):  # click treats it as the end of the input
            return _internal(cause)
        number = next((a for a in getattr(cause, "args", ()) if isinstance(a, int)), 2)
        return _ended("stopped at once; saved results are intact", 128 + number)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except SystemExit:  # what click makes of a closed pipe, with code 1
        raise BrokenPipeError from None
    except BrokenPipeError:
        raise
    except OSError as error:
        if os.environ.get("BIAXBAYES_DEBUG"):
            raise
        return _ended(f"{os_error_text(error)}; check space and permissions", 2)
    except MemoryError:
        return _ended("not enough memory; give a smaller --max-rows, or ask for fewer draws", 2)
    except Exception as error:
        return _internal(error)
    return outcome if isinstance(outcome, int) else 0


def _internal(error: BaseException) -> int:
    """Exit code of a defect of this program."""
    if os.environ.get("BIAXBAYES_DEBUG"):
        raise error
    return _ended(
        f"internal error: {type(error).__name__}: {error}; please report it with the command "
        "and the file (BIAXBAYES_DEBUG=1 shows where it happened)",
        70,
    )


def _ended(problem: str, code: int) -> int:
    with contextlib.suppress(OSError):
        click.echo(f"biaxbayes: {printable(problem)}", err=True)
    return code


if __name__ == "__main__":
    main()
