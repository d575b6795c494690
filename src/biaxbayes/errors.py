"""The exceptions that a user can meet.

BiaxbayesError
|-- InputError        a file, an option or a prior that cannot be used (exit 2)
|   `-- TaredSpecimen the mounting force was zeroed; no mounting stretch can be inferred (exit 2)
|-- RunError          a run folder that is damaged, locked or of another problem (exit 2)
|   `-- CannotResume  a checkpoint that is damaged or of another problem (exit 2)
|-- NotConverged      ran, but the result cannot be trusted (exit 3)
`-- Interrupted       stopped by a signal (exit 128 + its number)

Messages name arguments of Python functions, as ```name``` or ```name=value```; the command line
writes them as its options.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence


class BiaxbayesError(Exception):
    """Base of all errors meant for the user: one line, and the exit code to end with."""

    exit_code = 2


class InputError(BiaxbayesError):
    """Unusable input: the problem, its place (rows from 1, as an editor counts), the remedy."""

    def __init__(
        self,
        problem: str,
        *,
        file: object = None,
        row: int | None = None,
        column: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = file
        self.row = row
        self.column = column
        self.remedy = remedy
        where = [] if file is None else [str(file)]
        if row is not None:
            where.append(f"row {row}")
        if column is not None:
            where.append(f"column {column}")
        text = ", ".join(where) + ": " + problem if where else problem
        if remedy:
            text += f"; {remedy}"
        super().__init__(printable(text))


class TaredSpecimen(InputError):
    """The force at the mounted state is zero: the load cell was tared after mounting."""


class RunError(BiaxbayesError):
    """A run folder cannot be read, written or continued."""

    def __init__(self, problem: str) -> None:
        super().__init__(printable(problem))


class CannotResume(RunError):
    """A checkpoint that cannot be continued; the run can be started again."""


class NotConverged(BiaxbayesError):
    """The computation ended without a result that can be trusted."""

    exit_code = 3


class Interrupted(BiaxbayesError):
    """The user stopped the computation; what was done is saved, in ``folder`` if that is given."""

    exit_code = 130

    def __init__(
        self, problem: str, signal: int = 0, *, folder: object = None, resume: bool = True
    ) -> None:
        if folder is not None:
            option = " with `resume=True`" if resume else ""
            problem += f", all saved in {folder}; the same command{option} continues"
        super().__init__(problem)
        if signal and not isinstance(signal, bool):
            self.exit_code = 128 + signal


def two_digits(value: float) -> str:
    """A number with two significant digits, and not in powers of ten (120, not 1.2e+02)."""
    return f"{float(f'{value:.2g}'):g}"


def printable(text: str) -> str:
    """Text of a file without line breaks and control characters."""
    return "".join(ch if ch.isprintable() else " " for ch in text)


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: ``k2, alpha and kappa``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def as_options(text: str, flags: Mapping[str, str] | None = None) -> str:
    """Write arguments, `name` or `name=value`, as command-line options; `flags` for exceptions."""

    def option(match: re.Match[str]) -> str:
        name, value = match["name"], match["value"]
        flag = (flags or {}).get(name, f"--{name.replace('_', '-')}")
        pair = (value or "").strip("()").replace(",", "")  # (X, Y) is X Y on the command line
        return flag if value in (None, "True") else f"{flag} {pair}"

    return re.sub(r"`(?P<name>[a-zA-Z_]+)(=(?P<value>[^`]*))?`", option, text)
