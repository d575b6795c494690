"""Priors: a number is fixed, a string is tied, a table is a distribution.

The file format is TOML, one key a parameter::

    kappa = 0.0                                          # fixed
    k1 = "2.0 * C1"                                      # tied
    alpha = { distribution = "normal", mean = 41, sd = 5 }
    C1 = { distribution = "lognormal", median = 10, sd_log = 2 }
    k2 = { distribution = "loguniform", low = 0.01, high = 500 }
    mounting_stretch = { distribution = "normal", mean = 1, sd = 0.1 }

Units are kPa for C1 and k1, degrees for alpha, and the file's own (N or kPa) for noise_sd.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.stats import norm

from biaxbayes.errors import InputError
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import measured_stretch
from biaxbayes.specimens.text_file import read_text

__all__ = ["DEFAULT_BOUNDS", "Prior", "Tie", "default_priors", "read_priors"]

LOG_SCALE = ("C1", "k1", "k2", "noise_sd", "noise_growth")
"""Parameters sampled as natural logs."""

DEFAULT_BOUNDS: dict[str, tuple[float, float]] = {
    "alpha": (0.0, 90.0),
    "kappa": (0.0, 1.0 / 3.0),
}
"""Physical ranges that no prior can widen."""

FIXABLE = ("C1", "k1", "k2", "alpha", "kappa", "noise_sd")
SETTABLE = (
    *FIXABLE,
    "noise_growth",
    "mounting_stretch",
    "mounting_stretch_x",
    "mounting_stretch_y",
)
FAMILIES = {
    "normal": ("mean", "sd"),
    "lognormal": ("median", "sd_log"),
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
}


@dataclass(frozen=True)
class Prior:
    """A one-dimensional prior, optionally cut off.

    Parameters
    ----------
    family : {"normal", "lognormal", "uniform", "loguniform"}
    location, scale : float
        Mean and sd; median and sd of the natural log; unused for the uniform families.
    low, high : float
        Range, in natural units.
    """

    family: str
    location: float = 0.0
    scale: float = 1.0
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise ValueError(f"unknown distribution {self.family!r}")
        if not self.low < self.high:
            raise ValueError("low must be below high")
        if self.family in ("normal", "lognormal"):
            if not (self.scale > 0 and math.isfinite(self.scale) and math.isfinite(self.location)):
                raise ValueError("the standard deviation must be positive")
        elif not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise ValueError("a uniform prior needs finite low and high")
        if self.family == "lognormal" and self.location <= 0:
            raise ValueError("the median must be positive")
        if self.family == "loguniform" and self.low <= 0:
            raise ValueError("low must be positive")

    def within(self, low: float, high: float) -> Prior:
        """The same prior cut to a range."""
        return Prior(
            self.family, self.location, self.scale, max(self.low, low), min(self.high, high)
        )

    @property
    def _logs(self) -> bool:
        return self.family in ("lognormal", "loguniform")

    def _standard_range(self) -> tuple[float, float, float, float]:
        """Location, scale, low and high on the scale where the density is normal or flat."""
        if not self._logs:
            return self.location, self.scale, self.low, self.high
        low = math.log(self.low) if self.low > 0 else -math.inf
        high = math.log(self.high) if self.high < math.inf else math.inf
        location = math.log(self.location) if self.family == "lognormal" else 0.0
        return location, self.scale, low, high

    @property
    def _uniform(self) -> bool:
        return self.family in ("uniform", "loguniform")

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws in natural units, shape (size,)."""
        location, scale, low, high = self._standard_range()
        if self._uniform:
            x = rng.uniform(low, high, size)
        else:
            a, b = (float(norm.cdf((edge - location) / scale)) for edge in (low, high))
            x = location + scale * norm.ppf(rng.uniform(a, b, size))
        return np.exp(x) if self._logs else x

    def encode(self, *, log_scale: bool) -> tuple[int, list[float]]:
        """Kind and row for the compiled density, on the slot's own scale.

        ``log_scale`` says that the slot holds ln(x). The density is then one in ln(x).
        """
        location, scale, low, high = self._standard_range()
        if self._uniform:
            log_norm = -math.log(high - low)
        else:
            mass = norm.cdf((high - location) / scale) - norm.cdf((low - location) / scale)
            log_norm = -math.log(scale) - 0.5 * math.log(2 * math.pi) - math.log(max(mass, 1e-300))
        same_scale = self._logs == log_scale
        kind = (2 if self._uniform else 1) + (0 if same_scale else 2)
        if not same_scale and not log_scale:
            raise ValueError(f"a {self.family} prior does not fit this parameter")
        if not same_scale:  # stated for x, sampled as ln x
            low = math.log(low) if low > 0 else -math.inf
            high = math.log(high) if 0 < high < math.inf else math.inf
            if not self._uniform:
                mass = norm.cdf((self.high - location) / scale) - norm.cdf(
                    (max(self.low, 0.0) - location) / scale
                )
                log_norm = -math.log(scale * mass) - 0.5 * math.log(2 * math.pi)
            else:
                log_norm = -math.log(self.high - max(self.low, 0.0))
        return kind, [location, scale, low, high, log_norm]

    def as_table(self) -> dict[str, object]:
        """The TOML table that reads back to this prior (infinite limits left out)."""
        table: dict[str, object] = {"distribution": self.family}
        if not self._uniform:
            first, second = FAMILIES[self.family]
            table |= {first: self.location, second: self.scale}
        values = asdict(self)
        return table | {k: values[k] for k in ("low", "high") if math.isfinite(values[k])}


@dataclass(frozen=True)
class Tie:
    """A parameter tied to another: ``factor * other``."""

    factor: float
    other: str


def default_priors(specimen: Specimen) -> dict[str, Prior | float | Tie]:
    """The default priors, in the order of the parameters; a number is fixed.

    C1 ~ LN(10 kPa, 2), k1 ~ LN(30 kPa, 2.5), k2 ~ LN(10, 2), alpha ~ U(0, 90), kappa ~ U(0, 1/3),
    mounting stretches ~ N(1, 0.1), noise sd ~ LN(0.005 Fmax, 1.5). A mounting stretch that the
    specimen file states from an image replaces its prior.
    """
    priors: dict[str, Prior | float | Tie] = {
        "C1": Prior("lognormal", 10.0, 2.0),
        "k1": Prior("lognormal", 30.0, 2.5),
        "k2": Prior("lognormal", 10.0, 2.0),
        "alpha": Prior("uniform", low=0.0, high=90.0),
        "kappa": Prior("uniform", low=0.0, high=1.0 / 3.0),
        "noise_sd": Prior("lognormal", 0.005 * specimen.peak_load, 1.5),
        "noise_growth": Prior("lognormal", 0.03, 1.0),
    }
    for axis in "xy":
        name = f"mounting_stretch_{axis}"
        stated = specimen.metadata.get(name)
        mean, sd = (1.0, 0.1) if stated is None else measured_stretch(str(stated))
        priors[name] = Prior("normal", mean, sd, low=0.0)
    return priors


def read_priors(path: Path) -> dict[str, Prior | float | Tie]:
    """Read a priors file.

    Raises
    ------
    InputError
        Naming the key that cannot be used.
    """
    try:
        table = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not valid TOML ({error})", file=path) from None
    except RecursionError:
        raise InputError("not valid TOML (nested too deeply)", file=path) from None
    return parse_priors(table, path)


def parse_priors(
    table: Mapping[str, object], path: object = None
) -> dict[str, Prior | float | Tie]:
    """Priors from a parsed table; see the module's docstring for the format."""
    out: dict[str, Prior | float | Tie] = {}
    for name, value in table.items():
        if name not in SETTABLE:
            raise InputError(
                f"unknown parameter {name[:60]!r}",
                file=path,
                remedy=f"parameters are {', '.join(SETTABLE)}",
            )
        parsed = _parse(name, value, path)
        names = [f"{name}_x", f"{name}_y"] if name == "mounting_stretch" else [name]
        for each in names:
            if each in out:
                raise InputError(f"{each} is given twice", file=path)
            out[each] = parsed
    return out


def _parse(name: str, value: object, path: object) -> Prior | float | Tie:
    if isinstance(value, bool):
        raise InputError(f"{name} must be a number, a tie or a distribution", file=path)
    if isinstance(value, int | float):
        return check_fixed(name, float(value), path)
    if isinstance(value, str):
        return _parse_tie(name, value, path)
    if not isinstance(value, dict):
        raise InputError(f"{name} must be a number, a tie or a distribution", file=path)
    return _parse_distribution(name, value, path)


def check_fixed(name: str, value: float, path: object = None) -> float:
    """A fixed value, checked against the physical range of its parameter."""
    if name not in FIXABLE:
        raise InputError(
            f"{name[:60]!r} cannot be fixed", file=path, remedy=f"fix one of {', '.join(FIXABLE)}"
        )
    low, high = DEFAULT_BOUNDS.get(name, (0.0, math.inf))
    positive = name in ("C1", "noise_sd")
    if not (low <= value <= high and math.isfinite(value)) or (positive and value == 0.0):
        raise InputError(
            f"{name} cannot be fixed at {value:g}",
            file=path,
            remedy=f"its range is {low:g} to {high:.6g}" + (", above zero" if positive else ""),
        )
    return value


def _parse_tie(name: str, text: str, path: object) -> Tie:
    factor_text, star, other = text.rpartition("*")
    other = other.strip()
    try:
        factor = float(factor_text) if star else 1.0
    except ValueError:
        factor = math.nan
    allowed = {("k1", "C1"), ("C1", "k1"), ("mounting_stretch_y", "mounting_stretch_x")}
    good = (name, other) in allowed and factor > 0 and math.isfinite(factor)
    if not good or (name == "mounting_stretch_y" and factor != 1.0):
        raise InputError(
            f"{name} cannot be tied to {text[:60]!r}",
            file=path,
            remedy="ties read 'k1 = \"2.0 * C1\"' or 'mounting_stretch_y = \"mounting_stretch_x\"'",
        )
    return Tie(factor, other)


def _parse_distribution(name: str, table: Mapping[str, object], path: object) -> Prior:
    family = table.get("distribution")
    if family not in FAMILIES:
        raise InputError(
            f"{name}: unknown distribution {str(family)[:40]!r}",
            file=path,
            remedy=f"use one of {', '.join(FAMILIES)}",
        )
    first, second = FAMILIES[str(family)]
    values: dict[str, float] = {}
    for key, value in table.items():
        if key == "distribution":
            continue
        if key not in {first, second, "low", "high"}:
            raise InputError(
                f"{name}: a {family} prior has no {key[:40]!r}",
                file=path,
                remedy=f"it has {first} and {second}, and optionally low and high",
            )
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
        ):
            raise InputError(f"{name}: {key} must be a finite number", file=path)
        values[key] = float(value)
    for key in (first, second):
        if key not in values:
            raise InputError(f"{name}: the {family} prior lacks {key}", file=path)
    try:
        prior = Prior(
            str(family),
            values.get(first, 0.0) if first != "low" else 0.0,
            values.get(second, 1.0) if second != "high" else 1.0,
            values.get("low", -math.inf),
            values.get("high", math.inf),
        ).within(*DEFAULT_BOUNDS.get(name, (-math.inf, math.inf)))
        prior.encode(log_scale=name in LOG_SCALE)
    except ValueError as error:
        raise InputError(f"{name}: {error}", file=path) from None
    return prior
