"""Priors and priors files: a number fixes a parameter, a string ties it to another one.

The format of a priors file is TOML, one key per parameter::

    kappa = 0.0                                          # fixed
    k1 = "2.0 * C1"                                      # tied
    alpha = { distribution = "normal", mean = 41, sd = 5 }
    C1 = { distribution = "lognormal", median = 10, sd_log = 2 }
    k2 = { distribution = "loguniform", low = 0.01, high = 500 }
    mounting_stretch = { distribution = "student", centre = 1, scale = 0.1 }   # t, 3 degrees

Units are kPa for C1 and k1, degrees for alpha, and the file's own (N or kPa) for noise_sd.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.options import Settings
from biaxbayes.parameters import MOUNTING_PARAMETERS, NOISE_SD, STRETCH, Parameter, mounting_names
from biaxbayes.text_files import read_text

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law
    from biaxbayes.specimens.specimen import Specimen


# --- priors --------------------------------------------------------------------------------------


FAMILIES = {
    "normal": ("mean", "sd"),
    "lognormal": ("median", "sd_log"),
    "student": ("centre", "scale"),
    "logstudent": ("median", "scale_log"),
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
}
DEGREES_OF_FREEDOM = 3
"""Of the Student t distributions, of a quantity or of its log."""


# Kinds in the compiled density; the last two are densities of exp(x) where the slot holds ln x.
FIXED, NORMAL, UNIFORM, STUDENT, NORMAL_NATURAL, UNIFORM_NATURAL = range(6)


@dataclass(frozen=True)
class Prior:
    """A one-dimensional prior, optionally cut off.

    Student t distributions have three degrees of freedom; the uniform families have only a range.
    """

    family: str  # one of FAMILIES; those with log are of the natural log of the quantity
    location: float = 0.0  # mean or centre; of the logs the median
    scale: float = 1.0  # sd or scale; of the logs that of the log
    low: float = -math.inf  # range, in natural units
    high: float = math.inf

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise ValueError(f"unknown distribution {self.family!r}")
        if not self.low < self.high:
            raise ValueError("low must be below high")
        if not self._uniform:
            if not (self.scale > 0 and math.isfinite(self.scale) and math.isfinite(self.location)):
                raise ValueError("the standard deviation must be positive")
        elif not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise ValueError("a uniform prior needs finite low and high")
        if self.family in ("lognormal", "logstudent") and self.location <= 0:
            raise ValueError("the median must be positive")
        if self.family == "loguniform" and self.low <= 0:
            raise ValueError("low must be positive")

    @classmethod
    def from_numbers(cls, family: str, first: float, second: float) -> Prior:
        """A prior from its two numbers: location and scale, or low and high."""
        if family in ("uniform", "loguniform"):
            return cls(family, low=first, high=second)
        return cls(family, first, second)

    def within(self, low: float, high: float) -> Prior:
        """The same prior cut to a range."""
        return replace(self, low=max(self.low, low), high=min(self.high, high))

    @property
    def _logs(self) -> bool:
        return self.family in ("lognormal", "logstudent", "loguniform")

    def _standard_range(self) -> tuple[float, float, float, float]:
        """Location, scale, low and high on the scale on which the density is normal or uniform."""
        if not self._logs:
            return self.location, self.scale, self.low, self.high
        location = 0.0 if self._uniform else math.log(self.location)
        return location, self.scale, *_logs_of_range(self.low, self.high)

    @property
    def _uniform(self) -> bool:
        return self.family in ("uniform", "loguniform")

    @property
    def _student(self) -> bool:
        return self.family in ("student", "logstudent")

    def _level(self, x: Any) -> Any:
        """Cumulative probability on that scale, without the cut of the range."""
        from scipy.special import ndtr, stdtr  # imported late because it is slow

        location, scale, low, high = self._standard_range()
        with np.errstate(over="ignore"):  # an end may be further away than numbers reach
            if self._uniform:
                return np.clip((x - low) / (high - low), 0.0, 1.0)
            z = (x - location) / scale
            return stdtr(DEGREES_OF_FREEDOM, z) if self._student else ndtr(z)

    def _end_levels(self) -> tuple[float, float]:
        """Cumulative probability at both ends of the range, without the cut."""
        _, _, low, high = self._standard_range()
        return float(self._level(low)), float(self._level(high))

    def mass(self, *, positive: bool) -> float:
        """Probability of the range, or of the positive part of it."""
        if self._uniform:
            return float(self.high > 0.0 or not positive)
        if positive and not self._logs:
            return self.within(0.0, math.inf).mass(positive=False) if self.high > 0.0 else 0.0
        below_low, below_high = self._end_levels()
        return below_high - below_low

    def cdf(self, natural: np.ndarray) -> np.ndarray:
        """Cumulative probability at natural values."""
        with np.errstate(divide="ignore"):
            x = np.log(np.maximum(natural, 0.0)) if self._logs else np.asarray(natural, dtype=float)
        first, last = self._end_levels()
        # F = (Phi(x) - Phi(low)) / (Phi(high) - Phi(low))
        with np.errstate(over="ignore"):
            return np.clip((self._level(x) - first) / (last - first), 0.0, 1.0)

    def ppf(self, probability: np.ndarray) -> np.ndarray:
        """Natural values at cumulative probabilities."""
        from scipy.special import ndtri, stdtrit

        location, scale, low, high = self._standard_range()
        first, last = self._end_levels()
        # x = Phi^-1(Phi(low) + F (Phi(high) - Phi(low)))
        level = first + (last - first) * probability
        if self._uniform:
            x = level * (high - low) + low
        else:
            z = stdtrit(DEGREES_OF_FREEDOM, level) if self._student else ndtri(level)
            x = z * scale + location
        return np.exp(x) if self._logs else x

    def log_density(self, natural: np.ndarray) -> np.ndarray:
        """Log density up to a constant, on the scale on which it is normal, t or uniform."""
        location, scale, _, _ = self._standard_range()
        z = ((np.log(natural) if self._logs else natural) - location) / scale
        if self._uniform:
            return np.zeros_like(z)
        return np.asarray(-2.0 * np.log1p(z * z / 3.0) if self._student else -0.5 * z * z)

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws in natural units, shape (size,)."""
        return self.ppf(rng.random(size))

    def encode(self, *, log_scale: bool) -> tuple[int, list[float]]:
        """Kind and row for the compiled density, of ln(x) where the slot holds ln(x)."""
        location, scale, low, high = self._standard_range()
        same_scale = self._logs == log_scale
        if not same_scale and (self._student or not log_scale):
            raise ValueError(f"a {self.family} prior does not fit this parameter")
        if not same_scale:  # a prior of x, sampled as ln x: only positive values
            low = max(low, 0.0)
        if self._uniform:
            log_norm = -math.log(high - low)
        else:
            mass = self.mass(positive=not same_scale)
            mass = max(mass, 1e-300) if same_scale else mass
            # density at the centre: 1 / sqrt(2 pi), of the t distribution 2 / (pi sqrt(3))
            top = 2.0 / (math.pi * math.sqrt(3.0)) if self._student else 1.0 / math.sqrt(math.tau)
            log_norm = math.log(top / scale) - math.log(mass)
        row = [location, scale, low, high, log_norm]
        if same_scale:
            return (UNIFORM if self._uniform else STUDENT if self._student else NORMAL), row
        row[2:4] = _logs_of_range(low, high)
        return (UNIFORM_NATURAL if self._uniform else NORMAL_NATURAL), row

    def as_table(self) -> dict[str, object]:
        """The TOML table that reads back to this prior (infinite limits left out)."""
        numbers = {k: getattr(self, name) for k, name in _attributes(self.family).items()}
        finite = {k: v for k, v in numbers.items() if math.isfinite(v)}
        return {"distribution": self.family, **finite}


def _logs_of_range(low: float, high: float) -> tuple[float, float]:
    """Logs of both ends; ValueError if no positive number lies between."""
    return math.log(low) if low > 0 else -math.inf, math.log(high)


class DrawnPrior:
    """A prior given by draws in natural units, for a quantity that is computed from others."""

    low, high = -math.inf, math.inf

    def __init__(self, draws: np.ndarray) -> None:
        self._values = np.sort(np.asarray(draws, dtype=float))
        self._levels = (np.arange(self._values.size) + 0.5) / self._values.size

    def cdf(self, natural: np.ndarray) -> np.ndarray:
        """Cumulative probability at natural values."""
        return np.interp(natural, self._values, self._levels, left=0.0, right=1.0)

    def ppf(self, probability: np.ndarray) -> np.ndarray:
        """Natural values at cumulative probabilities."""
        return np.interp(probability, self._levels, self._values)


def _attributes(family: str) -> dict[str, str]:
    """The numbers of a distribution in a priors file, and their attributes of a prior."""
    pairs = zip(FAMILIES[family], ("location", "scale"), strict=True)
    return dict(pairs) | {"low": "low", "high": "high"}


@dataclass(frozen=True)
class Tie:
    """A parameter tied to another: ``factor * other``."""

    factor: float
    other: str


def default_priors(specimen: Specimen, settings: Settings) -> dict[str, Prior | float | Tie]:
    """The default priors, in the order of the parameters.

    Parameters of the law have their own priors; the sd of independent errors ~ LN(0.005 Fmax, 1.5)
    above the resolution of the load cell, mounting stretches a Student t about 1. A mounting
    stretch that the header of the file gives replaces its prior.
    """
    priors: dict[str, Prior | float | Tie] = {
        p.name: Prior.from_numbers(*p.prior)
        for p in settings.material_law.parameters
        if p.prior is not None
    }
    if not settings.has_misfit:
        priors[NOISE_SD.name] = Prior(
            "lognormal", 0.005 * specimen.peak_load, 1.5, low=specimen.load_resolution
        )
    measured = specimen.measured_mounting.T
    for name, (mean, sd) in zip(mounting_names("stretch"), measured, strict=True):
        if math.isnan(mean):
            priors[name] = Prior("student", 1.0, settings.mounting_sd, low=0.0)
        else:
            priors[name] = Prior("normal", float(mean), float(sd), low=0.0)
    return priors


# --- priors files --------------------------------------------------------------------------------


BOTH = "mounting_stretch"
"""Name for the mounting stretches in x and y together."""
LEAST_MASS = 1e-9
"""Least probability of the physical range under a prior; below it, a unit is probably wrong."""


def named_priors() -> dict[str, dict[str, Any]]:
    """Priors from imaging by name: ``tissue``, ``source``, ``stated``, ``assumed``, ``priors``."""
    return tomllib.loads(Path(__file__).with_name("named_priors.toml").read_text("utf-8"))


def read_priors(path: Path, law: Law | None = None) -> dict[str, Prior | float | Tie]:
    """Read a priors file, or named ones; InputError names the wrong key, or the known names."""
    named = named_priors()
    if str(path) in named:
        return parse_priors(named[str(path)]["priors"], path, law)
    if not path.suffix and not path.exists():
        raise InputError(
            "no such file, and no named priors", file=path, remedy=f"names are {', '.join(named)}"
        )
    try:
        table = tomllib.loads(read_text(path))
    except ValueError as error:  # also integers of thousands of digits
        raise InputError(f"not valid TOML ({str(error)[:80]})", file=path) from None
    except RecursionError:
        raise InputError("not valid TOML (nested too deeply)", file=path) from None
    return parse_priors(table, path, law)


def prior_value(prior: Prior | float | Tie) -> Any:
    """A prior as in a priors file: a table, the text of a tie, or a number."""
    if isinstance(prior, Prior):
        return prior.as_table()
    return f"{prior.factor!r} * {prior.other}" if isinstance(prior, Tie) else float(prior)


PRIOR_NUMBERS = {
    "sd_log": "sd of its logarithm",
    "scale_log": "scale of its logarithm",
    "low": "not below",
    "high": "not above",
}
"""Texts of the numbers of a prior, if other than their names."""


SHAPES = {
    "student": f"Student t of {DEGREES_OF_FREEDOM} degrees of freedom",
    "logstudent": f"Student t of the logarithm, of {DEGREES_OF_FREEDOM} degrees of freedom",
}


def prior_text(prior: Any, unit: str = "") -> str:
    """A prior, or its value in a priors file, as a phrase, with its unit where it has one."""
    value = prior_value(prior) if isinstance(prior, Prior | Tie) else prior
    unit = f" {unit}" if unit not in ("", "1") else ""
    if isinstance(value, int | float):
        return f"fixed at {value:g}{unit}"
    if not isinstance(value, dict):
        return f"tied: {value}"
    shape = str(value.get("distribution", ""))
    numbers = {k: v for k, v in value.items() if isinstance(v, int | float)}
    if shape in ("uniform", "loguniform") and {"low", "high"} <= set(numbers):
        return f"{shape} from {numbers['low']:g} to {numbers['high']:.4g}{unit}"
    natural = {"median", "mean", "sd", "centre", "scale", "low", "high"}
    parts = [
        f"{PRIOR_NUMBERS.get(k, k)} {v:.4g}{unit if k in natural else ''}"
        for k, v in numbers.items()
    ]
    shape = SHAPES.get(shape, shape)
    return f"{shape} ({', '.join(parts)})" if parts else shape


def parse_priors(
    table: Mapping[str, object], path: object = None, law: Law | None = None
) -> dict[str, Prior | float | Tie]:
    """Priors from a parsed table; see the module's docstring for the format."""
    law = law or law_named(DEFAULT_LAW)
    stretches = [p for p in MOUNTING_PARAMETERS if p.kind == STRETCH]
    known = {p.name: p for p in (*law.parameters, NOISE_SD)}
    known |= {BOTH: stretches[0]} | {p.name: p for p in stretches}
    out: dict[str, Prior | float | Tie] = {}
    for key, value in table.items():
        name = law.known_name(str(key))
        if name not in known:
            raise InputError(
                f"unknown parameter {name[:60]!r}",
                file=path,
                remedy=f"parameters are {', '.join(known)}",
            )
        parsed: Prior | float | Tie
        if isinstance(value, str):
            parsed = _parse_tie(name, value, path, law)
        elif isinstance(value, dict):
            parsed = _parse_distribution(known[name], name, value, path)
        elif isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{name} must be a number, a tie or a distribution", file=path)
        else:
            parsed = check_fixed(name, _number(value), path, law)
        for known_name in mounting_names("stretch") if name == BOTH else (name,):
            if known_name in out:
                raise InputError(f"{known_name} is given twice", file=path)
            out[known_name] = parsed
    ties = {name: value.other for name, value in out.items() if isinstance(value, Tie)}
    for name, other in ties.items():
        if ties.get(other) == name:
            raise InputError(
                f"{name} and {other} are tied in a circle",
                file=path,
                remedy="leave one of them free",
            )
    return out


def check_fixed(name: str, value: float, path: object = None, law: Law | None = None) -> float:
    """A fixed value, checked against the physical range of its parameter."""
    law = law or law_named(DEFAULT_LAW)
    fixable = {p.name: p for p in (*law.parameters, NOISE_SD)}
    if name not in fixable:
        raise InputError(
            f"{name[:60]!r} cannot be fixed", file=path, remedy=f"fix one of {', '.join(fixable)}"
        )
    low, high = fixable[name].range
    positive = fixable[name].positive
    if not (low <= value <= high and math.isfinite(value)) or (positive and value == 0.0):
        raise InputError(
            f"{name} cannot be fixed at {value:g}",
            file=path,
            remedy=f"its range is {low:g} to {high:.6g}" + (", above zero" if positive else ""),
        )
    return value


def _number(value: object) -> float:
    """A number of a TOML file; NaN for anything else, infinite where it is too large."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _parse_tie(name: str, text: str, path: object, law: Law) -> Tie:
    factor_text, star, other = text.rpartition("*")
    other = other.strip()
    try:
        factor = float(factor_text) if star else 1.0
    except ValueError:
        factor = math.nan
    first, second = mounting_names("stretch")
    allowed = {*law.ties, (second, first)}
    good = (name, other) in allowed and factor > 0 and math.isfinite(factor)
    if not good or (name == second and factor != 1.0):
        example = f"'{law.ties[0][0]} = \"2.0 * {law.ties[0][1]}\"' or " if law.ties else ""
        raise InputError(
            f"{name} cannot be tied to {text[:60]!r}",
            file=path,
            remedy=f"ties read {example}'{second} = \"{first}\"'",
        )
    return Tie(factor, other)


def _parse_distribution(
    parameter: Parameter, name: str, table: Mapping[str, object], path: object
) -> Prior:
    family = table.get("distribution")
    if not isinstance(family, str) or family not in FAMILIES:
        raise InputError(
            f"{name}: unknown distribution {str(family)[:40]!r}",
            file=path,
            remedy=f"use one of {', '.join(FAMILIES)}",
        )
    first, second = FAMILIES[family]
    attributes = _attributes(family)
    values: dict[str, float] = {}
    for key, value in table.items():
        if key == "distribution":
            continue
        if key not in attributes:
            raise InputError(
                f"{name}: a {family} prior has no {key[:40]!r}",
                file=path,
                remedy=f"it has {first} and {second}, and optionally low and high",
            )
        values[attributes[key]] = _number(value)
        if not math.isfinite(values[attributes[key]]):
            raise InputError(f"{name}: {key} must be a finite number", file=path)
    for key in (first, second):
        if attributes[key] not in values:
            raise InputError(f"{name}: the {family} prior lacks {key}", file=path)
    try:
        prior = Prior(family, **values)
        if parameter.bounded:
            prior = prior.within(*parameter.range)
        positive = parameter.logarithmic or parameter.kind == STRETCH
        if prior.mass(positive=positive) < LEAST_MASS:
            raise ValueError("the prior has no mass where the parameter can be")
        prior.encode(log_scale=parameter.logarithmic)
    except ValueError as error:
        raise InputError(f"{name}: {error}", file=path) from None
    return prior
