"""The exceptions that a user can meet.

BiaxbayesError
|-- InputError        a file, an option or a prior that cannot be used (exit 2)
|   |-- ReadingError  a value in the arrays or arguments of a specimen (exit 2)
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
from typing import Any


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


class ReadingError(InputError):
    """A value of an argument of a protocol or a specimen that cannot be used.

    ``index`` is that of the value in its array, from 0.
    """

    def __init__(
        self,
        fault: str,
        *,
        argument: str,
        index: int | None = None,
        protocol: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.fault, self.argument, self.index, self.protocol = fault, argument, index, protocol
        location = argument if index is None else f"{argument}[{index}] (row {index + 1})"
        where = None if protocol is None else f"protocol {protocol[:40]!r}"
        # a fault such as "rest_rows must be ..." already names its argument
        text = fault if fault.startswith(argument) else f"{location}: {fault}"
        super().__init__(text, file=where, remedy=remedy)

    def at(self, file: object, lines: Any, columns: Mapping[str, str]) -> InputError:
        """The same error in a file, by the lines of the array and the columns of the arguments."""
        return InputError(
            self.fault,
            file=file,
            row=None if self.index is None else int(lines[self.index]),
            column=columns.get(self.argument),
            remedy=self.remedy,
        )


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
        self.done = problem  # without how to go on
        if folder is not None:
            option = " with `resume=True`" if resume else ""
            problem += f", all saved in {folder}; the same command{option} continues"
        super().__init__(problem)
        if signal and not isinstance(signal, bool):
            self.exit_code = 128 + signal


def two_digits(value: float) -> str:
    """A number with two significant digits, and not in powers of ten (120, not 1.2e+02)."""
    return f"{float(f'{value:.2g}'):g}"


def load_text(load: float, unit: str) -> str:
    """A load with two digits and its unit, below 0.1 N in mN."""
    small = unit == "N" and abs(load) < 0.1
    return f"{two_digits(1e3 * load)} mN" if small else f"{two_digits(load)} {unit}"


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
