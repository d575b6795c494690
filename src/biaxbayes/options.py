"""What the user chooses: name, default, allowed values and words of every option, once.

The command line makes its options of these tables, the Python verbs their keyword arguments, study
files their ``[options]``, and a run folder its record. Each table is a frozen dataclass that checks
itself; an option's words and range stand in the metadata of its field.
"""

from __future__ import annotations

import inspect
import math
import numbers
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeVar

from biaxbayes.errors import InputError
from biaxbayes.laws import DEFAULT_LAW, LAWS, law_named

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law
    from biaxbayes.model.priors import Prior, Tie

__all__ = [
    "CONTENT",
    "INFERRING",
    "MOUNTING",
    "MOUNTING_STRETCH",
    "NOISE",
    "CalibrationPlan",
    "CardOptions",
    "DesignOptions",
    "FigureOptions",
    "FitOptions",
    "LawsPlan",
    "LedgerPlan",
    "ModelOptions",
    "Option",
    "PopulationOptions",
    "PredictionOptions",
    "ProfileOptions",
    "SamplingPlan",
    "Settings",
    "VirtualTest",
    "documented",
    "stated",
]

CONTENT = 0.9
"""Content of every interval and band, where no other is asked for."""
INFERRING = ("noisy", "exact", "free")
"""Ways in which the mounting force enters where the mounting stretch is an unknown."""
MOUNTING = (*INFERRING, "ignored", "zeroed")
NOISE = ("effective", "systematic", "independent")
MOUNTING_STRETCH = ("shared", "per-protocol")
FIT_WORDS = {
    "standard": "takes the mounted state as unloaded, forces as read",
    "zeroed": "the same with the mounting force subtracted, as after a tare",
    "fip": "finds the mounting stretch by the force balance, refits, and repeats (method paper)",
    "linden": "takes the mounting stretches as two more parameters of the stress fit",
    "constrained": "fits the forces in one go, the mounting stretch from the force balance",
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
CARD_PROGRAMS = ("abaqus", "febio")
CARD_UNITS = ("kPa-mm", "MPa-mm", "Pa-m")
DRAW_AT = ("median", "map")
STRESS_PAIRS = ("force", "piola", "cauchy")
GEOMETRIES = ("unloaded", "mounted")
REFERENCES = ("total", "measured")
STRESSES = ("cauchy", "piola")
AXES = ("x", "y")
PICTURES = ("pdf", "svg", "png")
PLOTS = {
    "corner": "corner",
    "bands": "stress-bands",
    "identifiability": "identifiability",
    "mounting": "mounting",
    "trace": "trace",
    "profile": "profile",
}
"""Figures of a run and the stems of their files."""
PLOT_TAKES = {
    "truth": ("corner", "bands", "mounting"),
    "compare": ("corner",),
    "parameters": ("corner", "profile", "trace"),
}
"""Options that go with some figures only."""
REPORTS = {
    "html": "report.html",
    "md": "report.md",
    "latex": "report.tex",
    "explore": "explore.html",
}
"""Kinds of report and their files in a run."""
ALL_ROWS, AUTOMATIC = "none", "auto"
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


def _option(
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
    option = Option(words, choices, kind, least, most, inside, shown, reason, metavar, flag)
    return field(default=default, metadata={"option": option})


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


# --- the statistical model -----------------------------------------------------------------------


@dataclass(frozen=True)
class Settings(Options):
    """Options of the statistical model.

    Attributes
    ----------
    mounting : {"noisy", "exact", "free", "ignored", "zeroed"}
        How the mounting force enters.
    noise : {"effective", "systematic", "independent"}
        Tempered by n_eff / n, by that with a smooth misfit as one error a curve, or not.
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

    mounting: str = _option("noisy", "How the mounting force enters.", choices=MOUNTING)
    noise: str = _option(
        "effective",
        "Weigh the rows by the independent readings they are worth, or not.",
        choices=NOISE,
    )
    mounting_stretch: str = _option(
        "shared", "One mounted state for all protocols, or one each.", choices=MOUNTING_STRETCH
    )
    noise_growth: bool = _option(False, "Let the noise sd grow with the load.")
    law: str = _option(DEFAULT_LAW, "The material law.", choices=tuple(LAWS))
    fibre_switch: bool = _option(
        False, "Fibres carry no compression (Abaqus, FEBio); for laws that leave it open."
    )
    mounting_sd: float = _option(
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
        As in :func:`~biaxbayes.specimens.thinning.rows_to_keep`.
    """

    thin: int | str = _option(  # type: ignore[assignment]
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
            if isinstance(value, bool) or not text.isdecimal() or len(text) > 15:
                raise InputError(
                    f"{where}thin must be a number of rows, {ALL_ROWS} or {AUTOMATIC}", file=file
                )


@dataclass(frozen=True)
class ProfileOptions(ModelOptions):
    """The same for a profile likelihood, which the mounting stretches cannot be free in."""

    mounting: str = _option(
        Settings.mounting,
        stated(Settings)["mounting"].words,
        choices=tuple(m for m in MOUNTING if m != "free"),
    )


# --- how a posterior is sampled ------------------------------------------------------------------


SAME_SEED = "Same seed, same bytes."
WANTED = "Effective draws wanted."


@dataclass(frozen=True)
class SamplingPlan(Options):
    """How much is sampled, and by how many threads.

    Attributes
    ----------
    seed : int
        The same seed gives the same draws, whatever ``workers`` is.
    ess : float
        Effective sample size asked for, for the worst quantity.
    max_steps : int
        Kept steps of each ensemble at which the sampler gives up.
    workers : int, optional
        Threads; default the number of processors, at most four.
    """

    seed: int = _option(1, SAME_SEED, least=0, most=MOST_WHOLE)
    ess: float = _option(2000.0, WANTED, least=50, most=MOST)
    max_steps: int = _option(20_000, "When to give up.", least=128, most=MOST)
    workers: int | None = _option(None, "Threads [processors, at most 4].", kind=int, least=1)

    @property
    def threads(self) -> int:
        """Threads to use."""
        return min(os.cpu_count() or 1, 4) if self.workers is None else int(self.workers)


@dataclass(frozen=True)
class LedgerPlan(SamplingPlan):
    """A :class:`SamplingPlan` for the ledger, whose medians need fewer draws."""

    ess: float = _option(1000.0, WANTED, least=50, most=MOST)


CORRELATIONS = ("auto", "always", "never")
SPREADS = ("common", "by-group")


@dataclass(frozen=True)
class PopulationOptions(Options):
    """A hierarchical posterior over specimens.

    Attributes
    ----------
    pool_mounting : bool
        Whether mounting stretches are pooled like parameters.
    spread : {"common", "by-group"}
        One sd between the specimens of a donor for all groups, or one each.
    correlations : {"auto", "always", "never"}
        Of donors and of specimens.
    seed : int
    ess : float
        Effective draws of the worst quantity.
    max_steps : int
        Kept sweeps of each ensemble at which the sampler gives up.
    workers : int, optional
        As in :class:`SamplingPlan`.
    """

    pool_mounting: bool = _option(False, "Pool the mounting stretches, too.")
    spread: str = _option(
        "common",
        "One sd between the specimens of a donor for all groups, or one each.",
        choices=SPREADS,
    )
    correlations: str = _option(
        "auto",
        "Correlations of donors and of specimens; auto: where there are four for each parameter.",
        choices=CORRELATIONS,
    )
    seed: int = _option(1, SAME_SEED, least=0, most=MOST_WHOLE)
    ess: float = _option(1000.0, WANTED, least=50, most=MOST)
    max_steps: int = _option(6000, "When to give up.", least=128, most=MOST)
    workers: int | None = _option(None, stated(SamplingPlan)["workers"].words, kind=int, least=1)

    @property
    def threads(self) -> int:
        """Threads to use."""
        return SamplingPlan(workers=self.workers).threads


@dataclass(frozen=True)
class LawsPlan(Options):
    """How much is sampled to weigh laws.

    Attributes
    ----------
    laws : sequence of str, or str
        Their names, in a text separated by commas; all where none is given.
    seed : int
    ess : float
        Effective draws of each law on each part of the record.
    max_steps : int
    """

    laws: Sequence[str] | str | None = _option(
        None, "Laws, separated by commas  [all]", metavar="NAME,NAME"
    )
    seed: int = _option(1, SAME_SEED, least=0, most=MOST_WHOLE)
    ess: float = _option(500.0, "Effective draws of each posterior.", least=50, most=MOST)
    max_steps: int = _option(20_000, "When to give up.", least=128, most=MOST)


@dataclass(frozen=True)
class CalibrationPlan(Options):
    """A calibration study.

    Attributes
    ----------
    replications : int
    source : {"prior", "posterior"}
        Where the true values come from.
    seed : int
    ess : float
        Effective draws of each replication.
    broken : str
        What is broken on purpose, to show that the study notices.
    """

    replications: int = _option(200, least=1)
    source: str = _option(
        "prior",
        "True values from a prior scaled to the protocol, or around the specimen's posterior.",
        choices=("prior", "posterior"),
        flag="from",
    )
    seed: int = _option(1, least=0, most=MOST_WHOLE)
    ess: float = _option(
        600.0, "Effective draws of each.", least=200, reason="127 draws are ranked against"
    )
    broken: str = _option("", "determinant, or noise.", flag="break")


# --- what the other verbs are asked --------------------------------------------------------------


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

    starts: int = _option(8, least=1, most=512, shown=True)
    seed: int = _option(0, least=0, shown=True)
    fixed: Mapping[str, float] | None = None
    mounting_stretch: str = _option(
        Settings.mounting_stretch,
        stated(Settings)["mounting_stretch"].words,
        choices=MOUNTING_STRETCH,
    )
    law: str = _option(Settings.law, stated(Settings)["law"].words, choices=tuple(LAWS))
    fibre_switch: bool = _option(False, stated(Settings)["fibre_switch"].words)
    initial: Any = None

    def __post_init__(self) -> None:
        for name in stated(type(self)):
            if not (name == "starts" and self.initial is not None and self.starts == 0):
                self.check(name, getattr(self, name))


@dataclass(frozen=True)
class DesignOptions(Options):
    """Which further measurements are tried, and how they are ranked.

    Attributes
    ----------
    ratios : sequence of (float, float)
        Further stretch ratios to try.
    further : float
        How far the protocol goes that goes further, relative to the tested range.
    alpha_sd_deg, kappa_sd, image_sd : float
        Sds of histology and of the mounting stretch by image.
    rank_by : str
        ``parameters``, ``information``, or one quantity.
    seed : int
    """

    ratios: Sequence[tuple[float, float]] = _option(
        (), "A further stretch ratio to try, as 1:0.75. Repeatable.", metavar="X:Y", flag="ratio"
    )
    further: float = _option(
        1.25,
        "How far the protocol goes that goes further, relative to the tested range.",
        least=1.0,
        most=3.0,
        shown=True,
    )
    alpha_sd_deg: float = _option(
        5.0, "Histology, degrees.", least=0.0, most=1e3, inside=True, flag="alpha-sd"
    )
    kappa_sd: float = _option(0.03, "Histology.", least=0.0, most=1e3, inside=True)
    image_sd: float = _option(0.005, "Mounting stretch by image.", least=0.0, most=1e3, inside=True)
    rank_by: str = _option(
        "parameters",
        "The mean over the parameters, 'information', or one quantity, such as kappa.",
    )
    seed: int = _option(1, SAME_SEED, least=0)


@dataclass(frozen=True)
class PredictionOptions(Options):
    """Bands of stress on a path, or of the inflation of a tube.

    Attributes
    ----------
    points : int
        States of a path that is not given one by one.
    probability : float
        Content of the bands.
    seed : int
    """

    points: int = _option(61, least=2, most=100_000, shown=True)
    probability: float = _option(
        CONTENT, "Content of the bands.", least=0.0, most=1.0, inside=True, shown=True
    )
    seed: int = _option(0, least=0, shown=True)


@dataclass(frozen=True)
class FigureOptions(Options):
    """How a figure is printed.

    Attributes
    ----------
    suffix : {"pdf", "svg", "png"}
    width_mm : float
    style : path-like, optional
        A matplotlib style file.
    """

    suffix: str = _option("pdf", choices=PICTURES, flag="format")
    width_mm: float = _option(85.0, least=50.0, most=400.0, shown=True)
    style: object = _option(None, "A matplotlib style file.", metavar="FILE")


@dataclass(frozen=True)
class CardOptions(Options):
    """Material cards of posterior draws.

    Attributes
    ----------
    draws : int, optional
        So many random draws; else the one that ``at`` names.
    at : {"median", "map"}
        Default ``median``.
    units : {"kPa-mm", "MPa-mm", "Pa-m"}
    bulk_ratio : float, optional
        Bulk modulus over stiffness; default incompressible for Abaqus, 1000 for FEBio.
    seed : int
    overwrite : bool
        Replace the cards of an earlier export.
    """

    draws: int | None = _option(
        None, "N random posterior draws.", kind=int, least=1, shown=True, metavar="N"
    )
    at: str | None = _option(
        None,
        "One draw: that with the curves nearest the median curves, or the most probable one  "
        "[default: median]",
        choices=DRAW_AT,
    )
    units: str = _option("kPa-mm", "Unit system of the numbers.", choices=CARD_UNITS)
    bulk_ratio: float | None = _option(
        None,
        "Bulk modulus over stiffness, for nearly incompressible cards  "
        "[default: incompressible for Abaqus, 1000 for FEBio]",
        kind=float,
        metavar="R",
    )
    seed: int = _option(0, least=0, shown=True)
    overwrite: bool = _option(False, "Replace the cards of an earlier export.")


@dataclass(frozen=True)
class VirtualTest(Options):
    """A virtual biaxial test.

    Attributes
    ----------
    material : str, GOH or StatedMaterial
        Name of a published material, or one of your own: ``biaxbayes.law("fung", ...)``.
    fibre_switch : bool
    prestretch : (float, float), optional
        Mounting stretches; the published ones by default.
    total_stretch, measured_stretch : float, optional
        Largest stretch from unloaded, or from mounted.
    ratios : sequence of (float, float)
        Stretch ratios, one protocol each; 1:1 where none is given.
    increments : int
    edge : (float, float)
        Unloaded edges, mm.
    thickness : float, optional
        Unloaded, mm; the published one by default, else 1.
    noise_N, misfit : float
        Sd of a force reading; sd of a smooth error as a share of the force.
    stress_pair : {"force", "piola", "cauchy"}
    geometry : {"unloaded", "mounted"}
    hooks : int, optional
        Finite elements with so many hooks an edge, of a GOH material.
    seed : int
    name : str, optional
        Of the specimen; default that of the file.
    """

    material: object = _option(None, "A published material; 'list' prints them.", metavar="NAME")
    fibre_switch: bool = _option(False, stated(Settings)["fibre_switch"].words)
    prestretch: Sequence[float] | None = _option(
        None, "Mounting stretches; the published ones by default.", metavar="X Y"
    )
    total_stretch: float | None = _option(
        None, "Largest stretch from unloaded.", kind=float, metavar="L"
    )
    measured_stretch: float | None = _option(
        None, "Largest stretch from mounted.", kind=float, metavar="L"
    )
    ratios: Sequence[tuple[float, float]] = _option(
        (),
        "Stretch ratio, one protocol each time it is given  [default: 1:1]",
        metavar="X:Y",
        flag="ratio",
    )
    increments: int = _option(100, least=1, most=100_000, shown=True)
    edge: tuple[float, float] = _option(
        (20.0, 20.0), "Unloaded edge, 20 or 20x15 (x, y)  [default: 20]", metavar="MM"
    )
    thickness: float | None = _option(
        None, "Unloaded thickness  [default: 1]", kind=float, metavar="MM"
    )
    noise_N: float = _option(0.0, "Sd of a force reading.", metavar="N")
    misfit: float = _option(0.0, "Sd of a smooth error, share of force.", metavar="R")
    stress_pair: str = _option(
        "force", "What the file holds: N, or kPa as a lab computes it.", choices=STRESS_PAIRS
    )
    geometry: str = _option(
        "unloaded", "State whose dimensions the file states.", choices=GEOMETRIES
    )
    hooks: int | None = _option(
        None,
        "Finite elements with N hooks an edge (5 if not said).",
        kind=int,
        least=1,
        most=50,
        shown=True,
        metavar="[N]",
    )
    seed: int = _option(0, least=0, shown=True)
    name: str | None = _option(None, "Name of the specimen  [default: that of the file]")


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
