"""A table of options that checks itself: what is said of an option, and what it may be."""

from __future__ import annotations

import inspect
import math
import numbers
from collections.abc import Callable, Mapping
from dataclasses import field, fields
from typing import Any, NamedTuple, Self, TypeVar

from biaxbayes.errors import InputError

__all__ = ["MOST", "MOST_WHOLE", "Option", "Options", "documented", "option", "stated"]

MOST_WHOLE = 2**63 - 1
MOST = 9e18


class Option(NamedTuple):
    """What is to be said of one option.

    Attributes
    ----------
    words : str
        As the help of the command line prints them.
    choices : tuple of str
        Allowed words; any where empty.
    kind : type, optional
        ``bool``, ``int`` or ``float`` where the value has to be one.
    least, most : float
        Range of a number.
    inside : bool
        The ends of the range themselves are not allowed.
    shown : bool
        The help shows the range.
    reason : str
        Why the range ends where it does.
    metavar : str, optional
        What the help prints for the value.
    flag : str
        Name on the command line.
    """

    words: str
    choices: tuple[str, ...]
    kind: type | None
    least: float
    most: float
    inside: bool
    shown: bool
    reason: str
    metavar: str | None
    flag: str

    @property
    def allowed(self) -> str:
        """The numbers that are allowed, in words."""
        if self.least == -math.inf:
            return "a number"
        if self.most == math.inf:
            return f"at least {self.least:g}" + (f": {self.reason}" if self.reason else "")
        whole = isinstance(self.most, int)
        if self.inside:
            return f"a number between {self.least:g} and {self.most:g}"
        low, high = (f"{v}" if whole else f"{v:g}" for v in (self.least, self.most))
        return f"a {'whole ' * whole}number from {low} to {high.replace('e+', 'e')}"


def option(
    default: Any,
    words: str = "",
    *,
    choices: tuple[str, ...] = (),
    kind: type | None = None,
    least: float = -math.inf,
    most: float = math.inf,
    inside: bool = False,
    shown: bool = False,
    reason: str = "",
    metavar: str | None = None,
    flag: str = "",
) -> Any:
    """A field with its default and what is to be said of it."""
    if kind is None and isinstance(default, bool | int | float):
        kind = type(default)
    said = Option(words, choices, kind, least, most, inside, shown, reason, metavar, flag)
    return field(default=default, metadata={"option": said})


def stated(table: type) -> dict[str, Option]:
    """The options of a table by their names, in their order."""
    return {
        f.name: f.metadata["option"]._replace(
            flag=f.metadata["option"].flag or f.name.replace("_", "-")
        )
        for f in fields(table)
        if "option" in f.metadata
    }


class Options:
    """A table of options that checks itself; its subclasses are frozen dataclasses."""

    def __post_init__(self) -> None:
        for name in stated(type(self)):
            self.check(name, getattr(self, name))

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """The table with the given values.

        Raises
        ------
        InputError
            For a name that is no option, or a value that is not allowed.
        """
        known = [f.name for f in fields(cls)]  # type: ignore[arg-type]
        for name in given:
            if name not in known:
                raise InputError(
                    f"no option {str(name)[:60]!r}", remedy=f"options are {', '.join(known)}"
                )
        return cls(**given)

    @classmethod
    def taken(cls, given: Mapping[str, Any]) -> tuple[Self, dict[str, Any]]:
        """The table made of what belongs to it, and what is left."""
        known = {f.name for f in fields(cls)}  # type: ignore[arg-type]
        left = {name: value for name, value in given.items() if name not in known}
        return cls(**{k: v for k, v in given.items() if k in known}), left

    @classmethod
    def check(cls, name: str, value: Any, where: str = "", file: object = None) -> None:
        """Refuse a value that an option does not allow.

        Parameters
        ----------
        name : str
        value : object
        where : str
            What the message begins with, such as ``options: ``.
        file : path-like, optional
            Where the value stands.

        Raises
        ------
        InputError
        """
        option = stated(cls)[name]
        if value is None and getattr(cls, name) is None:
            return
        if option.choices:
            if not (isinstance(value, str) and value in option.choices):
                allowed = ", ".join(option.choices)
                raise InputError(
                    f"{where}{name} must be one of {allowed}, not {str(value)[:40]!r}", file=file
                )
        elif option.kind is bool:
            if not isinstance(value, bool):
                raise InputError(f"{where}{name} must be true or false", file=file)
        elif option.kind is not None and not _is_allowed(value, option):
            raise InputError(f"{where}--{option.flag} must be {option.allowed}", file=file)


def _is_allowed(value: Any, option: Option) -> bool:
    kind = numbers.Integral if option.kind is int else numbers.Real
    if isinstance(value, bool) or not isinstance(value, kind):
        return False
    number: Any = value
    if option.least == -math.inf:
        return True  # whoever uses it says what is wrong with it
    if option.inside:
        return bool(option.least < number < option.most)
    return bool(option.least <= number <= option.most) and abs(number) != math.inf


# --- the tables in the signatures of the verbs ---------------------------------------------------


Verb = TypeVar("Verb", bound=Callable[..., Any])


def documented(*tables: type, without: tuple[str, ...] = ()) -> Callable[[Verb], Verb]:
    """Show the options of tables in the signature of a verb that takes ``**options``."""

    def shown(verb: Verb) -> Verb:
        own = inspect.signature(verb)
        kept = [p for p in own.parameters.values() if p.kind is not p.VAR_KEYWORD]
        names = {p.name for p in kept} | set(without)
        for table in tables:
            for f in fields(table):
                if f.name not in names:
                    default = getattr(table, f.name, None)
                    kept.append(
                        inspect.Parameter(
                            f.name,
                            inspect.Parameter.KEYWORD_ONLY,
                            default=default,
                            annotation=f.type,
                        )
                    )
                    names.add(f.name)
        verb.__signature__ = own.replace(parameters=kept)  # type: ignore[attr-defined]
        return verb

    return shown
