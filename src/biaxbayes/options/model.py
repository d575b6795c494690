"""Tables of options that check themselves: those of the statistical model and of the fits."""

from __future__ import annotations

import inspect
import math
import numbers
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeVar

from biaxbayes.errors import InputError
from biaxbayes.laws import DEFAULT_LAW, LAWS, law_named

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law
    from biaxbayes.model.priors import Prior, Tie

# --- what is said of an option, and what it may be -----------------------------------------------

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


INFERRING = ("noisy", "exact", "free")
"""Ways in which the mounting force enters where the mounting stretch is an unknown."""
MOUNTING = (*INFERRING, "ignored", "zeroed")
NOISE = ("effective", "independent")
MOUNTING_STRETCH = ("shared", "per-protocol")
FIT_WORDS = {
    "standard": "takes the mounted state as unloaded, forces as read",
    "zeroed": "the same with the mounting force subtracted, as after a tare",
    "fip": "finds the mounting stretch by the force balance, refits, and repeats (method paper)",
    "linden": "takes the mounting stretches as two more parameters of the stress fit",
    "constrained": "fits the forces in one go, the mounting stretch from the force balance, the "
    "mounting force one reading with the load cell's noise",
}
"""Deterministic fits, and what each does."""
FIT_METHODS = tuple(FIT_WORDS)
WHICH_FIT = (
    "Report constrained: it fits what was measured, as 'sample' does. Give fip to compare with the "
    "method paper, linden with work that used it; standard or zeroed only where the mounting force "
    "is lost, and say so. No fit has an interval: 'biaxbayes sample' gives it."
)
"""Which fit to report when."""
ALL_FITS = "all"
ALL_ROWS, AUTOMATIC = "none", "auto"


# --- the statistical model -----------------------------------------------------------------------


@dataclass(frozen=True)
class Settings(Options):
    """Options of the statistical model.

    Attributes
    ----------
    mounting : {"noisy", "exact", "free", "ignored", "zeroed"}
        How the mounting force enters.
    noise : {"effective", "independent"}
        Tempered by n_eff / n, or not.
    mounting_stretch : {"shared", "per-protocol"}
    noise_growth : bool
        Whether the sd grows with the load.
    law : str
        Name of the material law.
    fibre_switch : bool
        Fibres carry no compression, for laws that leave it open.
    mounting_sd : float
        Sd of the prior of the mounting stretches, about 1, where nothing else states one.
    thin : int
        Rows of a protocol that longer records are averaged to; 0 keeps all.
    priors : mapping
        Overrides of the default priors: a Prior, a number (fixed) or a Tie.
    """

    mounting: str = option("noisy", "How the mounting force enters.", choices=MOUNTING)
    noise: str = option(
        "effective",
        "Weigh the rows by the independent readings they are worth, or not.",
        choices=NOISE,
    )
    mounting_stretch: str = option(
        "shared", "One mounted state for all protocols, or one each.", choices=MOUNTING_STRETCH
    )
    noise_growth: bool = option(False, "Let the noise sd grow with the load.")
    law: str = option(DEFAULT_LAW, "The material law.", choices=tuple(LAWS))
    fibre_switch: bool = option(
        False, "Fibres carry no compression (Abaqus, FEBio); for laws that leave it open."
    )
    mounting_sd: float = option(
        0.1,
        "Sd of the prior of the mounting stretches, about 1.",
        least=0.0,
        most=10.0,
        inside=True,
    )
    thin: int = 0
    priors: Mapping[str, Prior | float | Tie] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.priors is None:
            object.__setattr__(self, "priors", {})
        if not isinstance(self.priors, Mapping):
            raise InputError("priors must be a table", remedy="one key a parameter")

    @property
    def material_law(self) -> Law:
        """The material law."""
        return law_named(self.law, fibre_switch=self.fibre_switch)

    @property
    def infers_mounting(self) -> bool:
        """Whether the mounting stretch is an unknown."""
        return self.mounting in INFERRING

    @property
    def fixed(self) -> dict[str, float]:
        """Fixed parameters, natural units."""
        return {k: float(v) for k, v in self.priors.items() if isinstance(v, int | float)}

    def keywords(self) -> dict[str, Any]:
        """As keyword arguments of :class:`~biaxbayes.model.posterior.Posterior`."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(frozen=True)
class ModelOptions(Settings):
    """The same as it is asked for, before a specimen has settled the thinning.

    Attributes
    ----------
    thin : int, "none" or "auto"
        As in :func:`~biaxbayes.specimens.path.rows_to_keep`.
    """

    thin: int | str = option(  # type: ignore[assignment]
        AUTOMATIC,
        "Average longer protocols to N rows; auto: above 200 rows to 100, for effective "
        "noise alone.",
        metavar=f"N|{ALL_ROWS}|{AUTOMATIC}",
    )

    @classmethod
    def check(cls, name: str, value: Any, where: str = "", file: object = None) -> None:
        """As :meth:`Options.check`; a number of rows may be text, as the command line has it."""
        super().check(name, value, where, file)
        if name == "thin" and value not in (ALL_ROWS, AUTOMATIC):
            text = str(value) if isinstance(value, str | numbers.Integral) else ""
            digits = text.lstrip("0")  # none of zero
            if isinstance(value, bool) or not digits.isdecimal() or len(digits) > 15:
                raise InputError(
                    f"{where}thin must be a number of rows, {ALL_ROWS} or {AUTOMATIC}",
                    file=file,
                    remedy=f"{ALL_ROWS} keeps all rows",
                )


@dataclass(frozen=True)
class InferringOptions(ModelOptions):
    """The same where the mounting stretches must be unknowns."""

    mounting: str = option(Settings.mounting, stated(Settings)["mounting"].words, choices=INFERRING)


@dataclass(frozen=True)
class ProfileOptions(ModelOptions):
    """The same for a profile likelihood, which the mounting stretches cannot be free in."""

    mounting: str = option(
        Settings.mounting,
        stated(Settings)["mounting"].words,
        choices=tuple(m for m in MOUNTING if m != "free"),
    )


# --- deterministic fits --------------------------------------------------------------------------


@dataclass(frozen=True)
class FitOptions(Options):
    """Deterministic fits.

    Attributes
    ----------
    starts, seed : int
        Starting points, and the seed of the random ones.
    fixed : mapping, optional
        Values held, by the law's parameters in their own units.
    mounting_stretch : {"shared", "per-protocol"}
    law : str
    fibre_switch : bool
    initial : Material, optional
        A further starting point; with it ``starts`` may be 0.
    """

    starts: int = option(8, least=1, most=512, shown=True)
    seed: int = option(0, least=0, shown=True)
    fixed: Mapping[str, float] | None = None
    mounting_stretch: str = option(
        Settings.mounting_stretch,
        stated(Settings)["mounting_stretch"].words,
        choices=MOUNTING_STRETCH,
    )
    law: str = option(Settings.law, stated(Settings)["law"].words, choices=tuple(LAWS))
    fibre_switch: bool = option(False, stated(Settings)["fibre_switch"].words)
    initial: Any = None

    def __post_init__(self) -> None:
        for name in stated(type(self)):
            if not (name == "starts" and self.initial is not None and self.starts == 0):
                self.check(name, getattr(self, name))
