"""Every inferred quantity: those of a material are in the file of its law, all others are here.

A :class:`Quantity` is a parameter of one run: mounting stretches exist once per mounted state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

LOAD = "load"
"""Unit of a quantity that is in the unit of the file's loads, N or kPa."""
DEGREE = "deg"

GREEK_NAMES = "alpha beta gamma delta eta theta kappa lambda mu nu rho sigma tau phi psi omega"
GREEK = dict(zip((f"\\{name}" for name in GREEK_NAMES.split()), "αβγδηθκλμνρστφψω", strict=True))

MATERIAL, STRETCH, FORCE, ERROR, DIMENSION = "material", "stretch", "force", "error", "dimension"
PIECE, FREE_SIDE = "piece", "free side"


def unit_words(unit: str) -> str:
    """Unit in a sentence, with a leading blank; empty for pure numbers."""
    return "" if unit in ("1", "") else f" {'degrees' if unit == DEGREE else unit}"


def unit_text(unit: object) -> str:
    """A unit as it is printed; nothing for pure numbers."""
    return {DEGREE: "°", "1": ""}.get(str(unit), str(unit))


@dataclass(frozen=True)
class Parameter:
    """Description of an inferred quantity."""

    name: str  # as in ``summary.csv``, priors files and ``--fix``
    symbol: str = ""  # in LaTeX, for figures; may be empty
    unit: str = "1"  # ``kPa``, ``deg``, ``1``, or LOAD
    words: str = ""  # description on a page
    # physical bounds; draws may lie on a finite one, except on zero for a positive parameter
    low: float = -math.inf
    high: float = math.inf
    logarithmic: bool = False  # a positive parameter: sampled and compared as its natural log
    positive: bool = False  # it cannot be fixed at zero
    at_low: str = ""  # kind of material at that bound; may be empty
    at_high: str = ""
    # the material is mirrored at the bounds (an angle at 0 and 90 degrees): they limit nothing
    mirror: bool = False
    # a 90 % interval narrower than this determines the parameter for practical purposes, whatever
    # it correlates with; the ratio of the limits for logarithmic parameters
    sharp: float = math.inf
    digits: str = ".3g"  # format of a single value
    width: float = 0.3  # of dispersed starting points, on the sampled scale
    kind: str = MATERIAL
    axis: int | None = None  # 0 for x, 1 for y, None without a direction
    largest: float = math.inf  # upper bound in a fit, where the range has none
    # default: its distribution and two numbers, as in a priors file
    prior: tuple[str, float, float] | None = None

    @property
    def label(self) -> str:
        """Name with its unit, as ``C1_kPa``; the name alone for pure numbers and loads."""
        return self.name if self.unit in ("1", LOAD) else f"{self.name}_{self.unit}"

    @property
    def html(self) -> str:
        """The symbol in HTML; empty where there is none."""
        base, _, below = self.symbol.partition("_")
        letter = GREEK.get(base, base)
        plain = below.removeprefix("{").removesuffix("}").replace(r"\mathrm{m}", "m")
        sub = f"<sub>{plain}</sub>" if plain else ""
        return f"<i>{letter}</i>{sub}" if letter else ""

    @property
    def range(self) -> tuple[float, float]:
        """Physical range (low, high)."""
        return self.low, self.high

    @property
    def bounded(self) -> bool:
        """Whether the range has two bounds that draws may lie on, whatever the prior."""
        return not self.logarithmic and self.kind == MATERIAL and math.isfinite(self.high)

    def number(self, value: float) -> str:
        """Value as text."""
        return format(value, self.digits)

    def is_sharp(self, low: float, high: float, times: float = 1.0) -> bool:
        """Whether an interval in natural units is at most ``times`` as wide as :attr:`sharp`."""
        if self.logarithmic:
            return high <= self.sharp**times * low
        return high - low <= self.sharp * times

    def in_range(self, values: np.ndarray) -> bool:
        """Whether all values lie in the physical range; a stretch is larger than zero."""
        low = values > self.low if self.kind == STRETCH else values >= self.low
        return bool((low & (values <= self.high + 1e-12)).all())

    def unit_in(self, load_unit: str) -> str:
        """Unit in a file whose loads are in ``load_unit``; ``1`` for pure numbers."""
        return load_unit if self.unit == LOAD else self.unit

    def unit_symbol(self, load_unit: str = "") -> str:
        """Unit after a number or on an axis; empty for pure numbers."""
        return unit_text(self.unit_in(load_unit))

    def unit_words(self, load_unit: str = "") -> str:
        """Unit in a sentence, with a leading blank; empty for pure numbers."""
        return unit_words(self.unit_in(load_unit))


def positive_parameter(
    name: str,
    symbol: str,
    words: str,
    unit: str,
    median: float,
    sd_log: float,
    largest: float,
    at_low: str,
    *,
    positive: bool = False,
) -> Parameter:
    """A stiffness or an exponent: positive, with a lognormal prior, sampled as its log."""
    scale: dict[str, Any] = {"low": 0.0, "logarithmic": True, "positive": positive}
    scale |= {"width": 0.4 if unit == "kPa" else 0.5, "prior": ("lognormal", median, sd_log)}
    return Parameter(name, symbol, unit, words, **scale, largest=largest, at_low=at_low, sharp=2.0)


def _uniform(low: float, high: float) -> dict[str, Any]:
    """A range with a uniform prior."""
    return {"low": low, "high": high, "prior": ("uniform", low, high)}


def fibre_angle(name: str, symbol: str, words: str) -> Parameter:
    """An angle from x, 0 to 90 degrees with a uniform prior, mirrored at both bounds."""
    range_and_prior = _uniform(0.0, 90.0)
    return Parameter(
        name, symbol, DEGREE, words, **range_and_prior, mirror=True, sharp=15.0, digits=".1f"
    )


def fraction_parameter(
    name: str, symbol: str, words: str, at_low: str, at_high: str, *, width: float = 0.3
) -> Parameter:
    """A fraction between 0 and 1 with a uniform prior."""
    ends = _uniform(0.0, 1.0) | {"at_low": at_low, "at_high": at_high}
    return Parameter(name, symbol, words=words, **ends, sharp=0.2, digits=".3f", width=width)


def _pair(name: str, symbol: str, words: str, **rest: Any) -> tuple[Parameter, ...]:
    """Parameters of both directions; ``{}`` is replaced by the axis."""
    return tuple(
        Parameter(
            f"{name}_{axis}",
            symbol.replace("{}", axis),
            words=words.replace("{}", axis),
            axis=k,
            **rest,
        )
        for k, axis in enumerate("xy")
    )


_AT_REST = "load at the mounted state, {}"
MOUNTING_PARAMETERS = (
    *_pair(
        "mounting_stretch",
        r"\lambda_{\mathrm{m},{}}",
        "mounting stretch in {}",
        low=0.0,
        sharp=0.02,
        digits=".4f",
        width=0.005,
        kind=STRETCH,
    ),
    *_pair("mounting_force", "p_{0,{}}", _AT_REST, unit=LOAD, digits=".4f", kind=FORCE),
)
"""Stretches, then forces, of a mounted state."""
_OF_LOG: dict[str, Any] = {"low": 0.0, "logarithmic": True, "positive": True}
NOISE_SD = Parameter(
    "noise_sd", "w", LOAD, "standard deviation of the errors", **_OF_LOG, kind=ERROR
)
DIMENSION_PARAMETERS = (
    *_pair("edge", "", "edge in {} over the stated one", low=0.0, kind=DIMENSION),
    Parameter("thickness", words="thickness over the stated one", low=0.0, kind=DIMENSION),
    *_pair("load_offset", "", "load offset in {}", unit=LOAD, kind=DIMENSION),
)
"""True over stated dimensions, and the load offset, the reading of the cell without load."""
_OVER_FIRST = "stiffness of the piece over that of the first"
STIFFNESS = Parameter("stiffness", "s", words=_OVER_FIRST, **_OF_LOG, kind=PIECE)
"""Factor of all stresses of a further piece of the tissue."""
OF_PIECE = (NOISE_SD, *DIMENSION_PARAMETERS, STIFFNESS)
"""Parameters that every piece has for itself, besides its mounted states."""


def name_of(parameter: str, state: str) -> str:
    """Name of a parameter of a mounted state or a piece."""
    return f"{parameter}[{state}]" if state else parameter


def mounting_names(what: str, state: str = "") -> tuple[str, str]:
    """Names, in x and y, of the mounting ``stretch`` or ``force`` of one mounted state."""
    return name_of(f"mounting_{what}_x", state), name_of(f"mounting_{what}_y", state)


@dataclass(frozen=True)
class Quantity:
    """A parameter of one run."""

    parameter: Parameter
    # mounted state or further piece it belongs to: the name of a protocol or piece; empty where
    # all protocols share one state, for the first piece, and for parameters of the material
    state: str = ""
    load_unit: str = ""  # of the run

    @property
    def name(self) -> str:
        """As in ``summary.csv``."""
        return name_of(self.parameter.name, self.state)

    @property
    def axis(self) -> int:
        """0 for x, 1 for y."""
        axis = self.parameter.axis
        if axis is None:
            raise ValueError(f"{self.name} has no direction")
        return axis

    @property
    def unit(self) -> str:
        """``N``, ``kPa``, ``deg`` or ``1``."""
        return self.parameter.unit_in(self.load_unit)


class OfQuantity:
    """What is about one quantity of a run."""

    quantity: Quantity

    @property
    def name(self) -> str:
        """As in ``summary.csv``."""
        return self.quantity.name

    @property
    def unit(self) -> str:
        """Empty for pure numbers."""
        return "" if self.quantity.unit == "1" else self.quantity.unit


@dataclass(frozen=True)
class PieceLabels:
    """What the quantities of a piece are called."""

    label: str = ""  # empty for the first piece
    # labels of its mounted states: its own where all protocols share one; none where no mounting
    # stretch is inferred
    states: tuple[str, ...] = ("",)
    # directions in which it has a mounting stretch and a mounting force
    axes: tuple[int, ...] = (0, 1)
    load_unit: str = ""  # N or kPa


class Quantities(Mapping[str, Quantity]):
    """Quantities of a run (parameters of the law, and its pieces) by name, in column order."""

    def __init__(
        self, material: Sequence[Parameter], pieces: Sequence[PieceLabels] = (PieceLabels(),)
    ) -> None:
        self.material = tuple(material)
        self.pieces = tuple(pieces)
        quantities = [Quantity(p, "", self.pieces[0].load_unit) for p in self.material]
        for what in (STRETCH, FORCE):
            both = [p for p in MOUNTING_PARAMETERS if p.kind == what]
            for piece in self.pieces:
                own = [p for p in both if p.axis in piece.axes]
                # follows from the other
                free = [replace(p, kind=FREE_SIDE) for p in both if len(own) == 1 and p not in own]
                for state in piece.states:
                    quantities += [Quantity(p, state, piece.load_unit) for p in own]
                    quantities += [Quantity(p, state) for p in free if what == STRETCH]
        for piece in self.pieces:
            known = [p for p in OF_PIECE if piece.label or p is not STIFFNESS]
            quantities += [Quantity(p, piece.label, piece.load_unit) for p in known]
        self._quantities = {q.name: q for q in quantities}

    @property
    def states(self) -> tuple[str, ...]:
        """Labels of the mounted states of all pieces."""
        return tuple(state for piece in self.pieces for state in piece.states)

    def __getitem__(self, name: str) -> Quantity:
        return self._quantities[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._quantities)

    def __len__(self) -> int:
        return len(self._quantities)

    def of_kind(self, *kinds: str) -> tuple[Quantity, ...]:
        """Quantities of the given kinds, in their order."""
        return tuple(q for q in self._quantities.values() if q.parameter.kind in kinds)

    def assessed(self) -> tuple[Quantity, ...]:
        """Material parameters and mounting stretches, which get a verdict."""
        return self.of_kind(MATERIAL, STRETCH)

    def force_of(self, quantity: Quantity) -> Quantity:
        """The mounting force for a mounting stretch; any other quantity unchanged."""
        p = quantity.parameter
        if p.kind != STRETCH:
            return quantity
        force = next(f for f in MOUNTING_PARAMETERS if f.kind == FORCE and f.axis == p.axis)
        return Quantity(force, quantity.state, quantity.load_unit)
