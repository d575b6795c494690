"""Every option that a user can set, defined once: name, default, range or choices, help text.

An option is a field of a frozen dataclass, which checks it; command line, keyword arguments, the
``[options]`` of study files and provenance come from it. Those of one command are in its file.
"""

from __future__ import annotations

import functools
import inspect
import math
import numbers
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import dropwhile
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np

from biaxbayes.errors import BiaxbayesError, InputError, RunError
from biaxbayes.laws import DEFAULT_LAW, LAWS, law_key, law_named
from biaxbayes.laws.law import Law
from biaxbayes.tasks import DEFAULT_WORKERS, usual_numpy_errors
from biaxbayes.text_files import cache_problem

# --- an option, its help text and its check ------------------------------------------------------

MAX_INT64 = 2**63 - 1
MAX_COUNT = 9e18
"""Largest values of options: an integer of 64 bits, and a count that is given as a number."""


class Option(NamedTuple):
    """Help text and allowed values of an option; numbers lie from ``minimum`` to ``maximum``."""

    help: str = ""
    choices: tuple[str, ...] = ()
    kind: type | None = None
    minimum: float = -math.inf
    maximum: float = math.inf
    open_ends: bool = False  # the range excludes minimum and maximum
    metavar: str | None = None
    flag: str = ""
    read: Callable[[Any], Any] | None = None  # the value as it is kept; InputError for a bad one

    @property
    def allowed(self) -> str:
        """The allowed numbers as text."""
        if self.minimum == -math.inf:
            return "a number"
        if self.maximum == math.inf:
            return f"at least {self.minimum:g}"
        if self.open_ends:
            return f"a number between {self.minimum:g} and {self.maximum:g}"
        if isinstance(self.maximum, int):
            return f"a whole number from {self.minimum} to {self.maximum}"
        return f"a number from {self.minimum:g} to {self.maximum:g}".replace("e+", "e")

    def allows(self, value: Any) -> bool:
        """Whether a number is of the kind and in the range."""
        kind = numbers.Integral if self.kind is int else numbers.Real
        if isinstance(value, bool) or not isinstance(value, kind):
            return False
        number: Any = value
        if self.minimum == -math.inf:
            return True  # checked where it is used
        if self.open_ends:
            return bool(self.minimum < number < self.maximum)
        return bool(self.minimum <= number <= self.maximum) and abs(number) != math.inf


def option(default: Any, help: str = "", between: Any = (), inside: Any = (), **more: Any) -> Any:
    """Field of a table with its default and what :class:`Option` holds.

    The range of a number is ``between`` two ends, or ``inside`` them where it excludes them.
    """
    if isinstance(default, bool | int | float):
        more.setdefault("kind", type(default))
    if ends := between or inside:
        more |= {"minimum": ends[0], "maximum": ends[1], "open_ends": bool(inside)}
    return field(default=default, metadata={"option": Option(help, **more)})


def options_of(table: type) -> dict[str, Option]:
    """Options of a table by name, in their order."""
    described = {f.name: f.metadata["option"] for f in fields(table) if "option" in f.metadata}
    return {
        name: option if option.flag else option._replace(flag=name.replace("_", "-"))
        for name, option in described.items()
    }


class Options:
    """A table of options that checks itself; its subclasses are frozen dataclasses."""

    def __post_init__(self) -> None:
        for name, option in options_of(type(self)).items():
            self.check(name, getattr(self, name))
            if option.read is not None:
                object.__setattr__(self, name, option.read(getattr(self, name)))

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Self:
        """The table with the given values; refuses a name that is not an option."""
        table, others = cls.split(values)
        for name in others:
            known = ", ".join(f.name for f in fields(cls))  # type: ignore[arg-type]
            raise InputError(f"no option {str(name)[:60]!r}", remedy=f"options are {known}")
        return table

    @classmethod
    def split(cls, values: Mapping[str, Any]) -> tuple[Self, dict[str, Any]]:
        """A table with the values that belong to it, and the other values."""
        known = {f.name for f in fields(cls)}  # type: ignore[arg-type]
        others = {name: value for name, value in values.items() if name not in known}
        return cls(**{k: v for k, v in values.items() if k in known}), others

    @classmethod
    def check(cls, name: str, value: Any, where: str = "", file: object = None) -> None:
        """Refuse a value that an option does not allow; ``where`` is its table in a ``file``."""
        option = options_of(cls)[name]
        if value is None and getattr(cls, name) is None:
            return
        problem = ""
        if option.read is not None:
            try:
                option.read(value)
            except InputError as error:
                file, problem = file or error.file, where + error.problem
                raise InputError(problem, file=file, remedy=error.remedy) from None
        elif option.choices:
            if not (isinstance(value, str) and value in option.choices):
                allowed = ", ".join(option.choices)
                problem = f"{name} must be one of {allowed}, not {str(value)[:40]!r}"
        elif option.kind is bool:
            if not isinstance(value, bool):
                problem = f"{name} must be true or false"
        elif option.kind is not None and not option.allows(value):
            shown = f"`{name}`" if file is None else name  # an argument, or a key of the file
            problem = f"{shown} must be {option.allowed}"
        if problem:
            raise InputError(where + problem, file=file)


Verb = TypeVar("Verb", bound=Callable[..., Any])


def takes_options(*tables: type, without: tuple[str, ...] = ()) -> Callable[[Verb], Verb]:
    """Add the options of tables to signature and docstring of a function with ``**options``."""

    def with_signature(verb: Verb) -> Verb:
        own = inspect.signature(verb)
        parameters = [p for p in own.parameters.values() if p.kind is not p.VAR_KEYWORD]
        names = {p.name for p in parameters} | set(without)
        kind = inspect.Parameter.KEYWORD_ONLY
        entries = ""
        for table in tables:
            described = options_of(table)
            for f in fields(table):
                if f.name in names:
                    continue
                names.add(f.name)
                default = getattr(table, f.name, None)
                parameters.append(
                    inspect.Parameter(f.name, kind, default=default, annotation=f.type)
                )
                option = described.get(f.name) or Option(f.metadata.get("help", ""))
                choices = ", ".join(map(repr, option.choices))
                entries += f"{f.name} : {f'{{{choices}}}' if choices else f.type}, "
                entries += f"default {default!r}\n"
                entries += f"    {option.help}\n" if option.help else ""
        verb.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
        # In place of the entry ``**options`` of the docstring and its indented lines.
        before, _, after = (inspect.getdoc(verb) or "").partition("**options\n")
        rest = dropwhile(lambda line: line.startswith(" "), after.splitlines())
        verb.__doc__ = (before + entries + "\n".join(rest)).rstrip("\n")
        return for_users(verb)

    return with_signature


KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "bool": ((bool, np.bool_), "True or False"),
    "str": ((str,), "a text"),
    "PathLike": ((str, os.PathLike), "a path"),
    "Path": ((str, os.PathLike), "a path"),
    "Sequence": ((list, tuple, np.ndarray), "a list"),
    "tuple": ((list, tuple, str), "a list"),
    "Mapping": ((Mapping,), "a mapping"),
}
"""What arguments may be, by the names in annotations."""


def for_users(verb: Verb) -> Verb:
    """A function that users call: it refuses arguments that are not of the annotated kind."""
    parameters = inspect.signature(verb).parameters
    known: dict[str, list[tuple[tuple[type, ...], str]]] = {}
    for name, p in parameters.items():
        # a kind is what stands outside of brackets, where "|" may stand as well
        parts = set(re.sub(r"\[.*\]", "", str(p.annotation)).split(" | ")) - {"None"}
        if parts <= KINDS.keys():
            known[name] = [KINDS[part] for part in sorted(parts)]

    @functools.wraps(verb)
    def checked(*arguments: Any, **options: Any) -> Any:
        given = dict(zip(parameters, arguments, strict=False)) | options
        for name in known.keys() & given.keys():
            kinds, value, p = known[name], given[name], parameters[name]
            if value is None and (p.default is None or "None" in str(p.annotation)):
                continue
            if not any(isinstance(value, types) for types, _ in kinds):
                allowed = " or ".join(words for _, words in kinds)
                raise InputError(f"`{name}` must be {allowed}, not {type(value).__name__}")
        try:
            return verb(*arguments, **options)
        except BiaxbayesError:
            raise
        except Exception as error:
            if problem := cache_problem(error):
                raise RunError(problem) from None
            raise

    return usual_numpy_errors(checked)  # type: ignore[return-value]


# --- choices of options -----------------------------------------------------------------

INFERRING_MODES = ("noisy", "exact", "free")
"""Modes of the mounting force in which the mounting stretch is unknown."""
MOUNTING_MODES = (*INFERRING_MODES, "ignored", "zeroed")
CORRELATED, INDEPENDENT = "correlated", "independent"
ERRORS = (CORRELATED, INDEPENDENT)
"""Errors of readings: a smooth misfit of the law and the noise of the load cell, or independent
errors alone, for what follows the law exactly."""
MOUNTING_STRETCH = ("shared", "per-protocol")
FIT_DESCRIPTIONS = {
    "standard": "takes the mounted state as unloaded, forces as read",
    "zeroed": "the same with the mounting force subtracted, as after a tare",
    "fip": "computes the mounting stretch by the force balance, refits, and repeats (method paper)",
    "linden": "takes the mounting stretches as two more parameters of the stress fit",
    "constrained": "fits the forces in one go, the mounting stretch from the force balance, the "
    "mounting force one reading with the load cell's noise",
}
"""Least-squares fits, with descriptions."""
FIT_METHODS = tuple(FIT_DESCRIPTIONS)
WHICH_FIT = (
    "Report constrained: it fits what was measured, as 'sample' does. Give fip to compare with the "
    "method paper, linden with work that used it; standard or zeroed only where the mounting force "
    "is lost, and say so. "
)
"""Advice on which fit to report."""
NO_INTERVAL = "No fit has an interval: 'biaxbayes sample' gives it."
ALL_FITS = "all"
ALL_ROWS, AUTOMATIC = "none", "auto"
CONTENT = 0.9
"""Default probability of every interval and band."""
CARD_PROGRAMS = ("abaqus", "febio")
CARD_UNITS = ("kPa-mm", "MPa-mm", "Pa-m")
PLOTS = {
    "corner": "corner",
    "bands": "stress-bands",
    "identifiability": "identifiability",
    "mounting": "mounting",
    "trace": "trace",
    "profile": "profile",
}
"""Figures of a run and the stems of their files."""
FIGURE_FORMATS = ("pdf", "svg", "png")
REPORTS = {"html": "report.html", "latex": "report.tex"}
"""Kinds of report and their files in a run."""


# --- the statistical model -----------------------------------------------------------------------


@dataclass(frozen=True)
class Settings(Options):
    """Options of the statistical model."""

    law: str = option(
        DEFAULT_LAW,
        f"The material law: {', '.join(LAWS)}, or a file with your own.",
        metavar="NAME|FILE.py",
        read=law_key,
    )
    mounting: str = option("noisy", "How the mounting force enters.", choices=MOUNTING_MODES)
    noise: str = option(
        CORRELATED,
        "Errors of the readings: a smooth misfit of the law and the load cell's noise, or "
        "independent errors alone.",
        choices=ERRORS,
    )
    toe: float = option(
        0.2,
        "Sd of the prior of the law's relative error near the mounted state, where tissue is soft.",
        between=(0.0, 2.0),
    )
    mounting_stretch: str = option(
        "shared",
        "One mounted state for all protocols, or one per protocol.",
        choices=MOUNTING_STRETCH,
    )
    mounting_sd: float = option(
        0.1,
        "Scale of the prior of the mounting stretches, a Student t about 1.",
        inside=(0.0, 10.0),
    )
    piece_sd: float = option(
        0.1,
        "Scale (of its log) of a further piece's stiffness over that of the first, a Student t.",
        inside=(0.0, 3.0),
    )
    max_rows: int = 0
    """Largest number of rows per protocol; longer ones are averaged down to it. 0 keeps all."""
    fibre_switch: bool = option(
        False,
        "Fibres carry no load in compression, as in Abaqus and FEBio; for laws with a choice.",
    )
    priors: Mapping[str, Any] = field(
        default_factory=dict,
        metadata={"help": "In place of default priors: a Prior, a number (fixed) or a Tie."},
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.priors is None:
            object.__setattr__(self, "priors", {})
        if not isinstance(self.priors, Mapping):
            raise InputError("priors must be a table", remedy="one key per parameter")

    @property
    def material_law(self) -> Law:
        """The material law."""
        return law_named(self.law, fibre_switch=self.fibre_switch)

    @property
    def has_misfit(self) -> bool:
        """Whether the likelihood holds a smooth misfit of the law."""
        return self.noise == CORRELATED

    @property
    def infers_mounting(self) -> bool:
        """Whether the mounting stretch is an unknown."""
        return self.mounting in INFERRING_MODES

    @property
    def shared(self) -> bool:
        """Whether all protocols start from one mounted state."""
        return self.mounting_stretch == "shared"

    @property
    def reads_force(self) -> bool:
        """Whether the mounting force is a reading with an error."""
        return self.mounting in ("noisy", "free")

    @property
    def fit_mounting(self) -> str:
        """The mounting mode of a least-squares fit with the same data."""
        return "noisy" if self.mounting == "free" else self.mounting

    @property
    def fixed_material(self) -> dict[str, float]:
        """Fixed parameters of the law, in natural units."""
        return {k: v for k, v in self.fixed.items() if k in self.material_law.names}

    @property
    def fixed(self) -> dict[str, float]:
        """Fixed parameters, in natural units."""
        return {k: float(v) for k, v in self.priors.items() if isinstance(v, int | float)}

    def keywords(self) -> dict[str, Any]:
        """As keyword arguments of :class:`~biaxbayes.model.posterior.Posterior`."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(frozen=True)
class ModelOptions(Settings):
    """The same as the user sets it: `max_rows` may also be ``none`` or ``auto``."""

    max_rows: int | str = option(  # type: ignore[assignment]
        AUTOMATIC,
        "Average longer protocols to N rows; auto: above 200 rows to 100, not with independent "
        "errors.",
        metavar=f"N|{ALL_ROWS}|{AUTOMATIC}",
    )

    @classmethod
    def check(cls, name: str, value: Any, where: str = "", file: object = None) -> None:
        """As :meth:`Options.check`; the number of rows may be text from the command line."""
        super().check(name, value, where, file)
        if name == "max_rows" and value not in (ALL_ROWS, AUTOMATIC):
            text = str(value) if isinstance(value, str | numbers.Integral) else ""
            digits = text.lstrip("0")  # empty for zero
            if isinstance(value, bool) or not digits.isdecimal() or len(digits) > 15:
                problem = f"{where}max_rows must be a number of rows, {ALL_ROWS} or {AUTOMATIC}"
                raise InputError(problem, file=file, remedy=f"{ALL_ROWS} keeps all rows")


@dataclass(frozen=True)
class InferringOptions(ModelOptions):
    """The same where the mounting stretches must be unknowns."""

    mounting: str = option("noisy", "How the mounting force enters.", choices=INFERRING_MODES)


# --- fits and sampling ---------------------------------------------------------------------------


MODEL_OPTIONS = options_of(Settings)


@dataclass(frozen=True)
class FitOptions(Options):
    """Least-squares fits."""

    starts: int = option(8, between=(1, 512))
    seed: int = option(0, minimum=0)
    fixed: Mapping[str, float] | None = field(
        default=None, metadata={"help": "Values of fixed parameters, in their own units."}
    )
    mounting_stretch: str = option("shared", **MODEL_OPTIONS["mounting_stretch"]._asdict())
    law: str = option(DEFAULT_LAW, **MODEL_OPTIONS["law"]._asdict())
    fibre_switch: bool = option(False, **MODEL_OPTIONS["fibre_switch"]._asdict())
    piece_sd: float = option(0.1, **MODEL_OPTIONS["piece_sd"]._asdict())
    initial: Any = field(
        default=None,
        metadata={"help": "A Material as a further start; with it ``starts`` may be 0."},
    )

    def __post_init__(self) -> None:
        if self.starts == 0 and self.initial is not None:
            object.__setattr__(self, "law", law_key(self.law))
        else:
            super().__post_init__()
        if self.initial is not None and not hasattr(self.initial, "theta"):
            raise InputError("`initial` must be a material, as biaxbayes.law(...) makes it")


SEED_HELP = "Random seed; the same seed gives the same files."
ESS_HELP = "Effective sample size to reach."
WORKERS_HELP = "Processors to use [all, at most 4]."


@dataclass(frozen=True)
class SamplingPlan(Options):
    """Amount of sampling, and number of processors; draws do not depend on ``workers``."""

    seed: int = option(1, SEED_HELP, between=(0, MAX_INT64))
    ess: float = option(2000.0, ESS_HELP, between=(50, MAX_COUNT))
    max_steps: int = option(
        20_000, "Largest number of steps per ensemble.", between=(128, MAX_COUNT)
    )
    workers: int | None = option(None, WORKERS_HELP, kind=int, minimum=1)

    def keywords(self) -> dict[str, Any]:
        """As keyword arguments of a sampler's plan."""
        amount = {name: getattr(self, name) for name in ("seed", "ess", "max_steps")}
        return amount | {"workers": int(self.workers or DEFAULT_WORKERS)}


@dataclass(frozen=True)
class PopulationOptions(SamplingPlan):
    """A hierarchical posterior over specimens."""

    ess: float = option(1000.0, ESS_HELP, between=(50, MAX_COUNT))
    max_steps: int = option(6000, "Largest number of steps.", between=(128, MAX_COUNT))

    pool_mounting: bool = option(False, "Pool the mounting stretches, too.")
    spread: str = option(
        "common",
        "One sd between the specimens of a donor for all groups, or one per group.",
        choices=("common", "by-group"),
    )
    correlations: str = option(
        "auto",
        "Correlations of donors and of specimens; auto: where there are four for each parameter.",
        choices=("auto", "always", "never"),
    )


@dataclass(frozen=True)
class CalibrationPlan(Options):
    """A calibration on the protocols of a specimen."""

    replications: int = option(200, minimum=1)
    source: str = option(
        "prior",
        "True values from a prior scaled to the protocol, or around the specimen's posterior.",
        choices=("prior", "posterior"),
        flag="from",
    )
    seed: int = option(1, between=(0, MAX_INT64))
    ess: float = option(
        600.0,
        "Effective draws of each replication, at least 200: true values are ranked among 127.",
        minimum=200,
    )


@dataclass(frozen=True)
class LawsPlan(Options):
    """Laws to compare, and how much is sampled for each."""

    laws: Sequence[str] | str | None = option(
        None, "Laws, separated by commas  [all]", metavar="NAME,NAME"
    )
    seed: int = option(1, SEED_HELP, between=(0, MAX_INT64))
    ess: float = option(500.0, "Effective draws of each posterior.", between=(50, MAX_COUNT))
    max_steps: int = option(20_000, "When to give up.", between=(128, MAX_COUNT))


# --- what is computed from a posterior -----------------------------------------------------------


@dataclass(frozen=True)
class DesignOptions(Options):
    """Candidates for further measurements, and their ranking."""

    ratios: Sequence[tuple[float, float]] = option(
        (), "A further stretch ratio to try, as 1:0.75. Repeatable.", metavar="X:Y", flag="ratio"
    )
    further: float = option(
        1.25, "Range of the extended protocol, relative to the tested range.", between=(1.0, 3.0)
    )
    alpha_sd_deg: float = option(
        5.0, "Sd of the fibre angle from histology (degrees).", inside=(0.0, 1e3), flag="alpha-sd"
    )
    kappa_sd: float = option(0.03, "Sd of kappa from histology.", inside=(0.0, 1e3))
    image_sd: float = option(
        0.005, "Sd of a mounting stretch measured by imaging.", inside=(0.0, 1e3)
    )
    rank_by: str = option(
        "parameters",
        "Rank by the mean over the parameters, 'information', or one quantity, such as kappa.",
    )


@dataclass(frozen=True)
class PredictionOptions(Options):
    """Bands of stress on a path, or of the inflation of a tube."""

    points: int = option(61, between=(2, 100_000))
    """Number of states on a straight path."""
    probability: float = option(CONTENT, "Content of the bands.", inside=(0.0, 1.0))
    seed: int = option(0, minimum=0)
