"""Priors: a number is fixed, a tie follows another parameter, a distribution is free."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from scipy.stats import norm

from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import measured_stretch

__all__ = ["DEFAULT_BOUNDS", "FAMILIES", "LOG_SCALE", "Prior", "Tie", "default_priors"]

LOG_SCALE = ("C1", "k1", "k2", "noise_sd", "noise_growth")
"""Parameters sampled as natural logs."""

DEFAULT_BOUNDS: dict[str, tuple[float, float]] = {
    "alpha": (0.0, 90.0),
    "kappa": (0.0, 1.0 / 3.0),
}
"""Physical ranges that no prior can widen."""

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

    def mass(self, *, positive: bool) -> float:
        """Probability of the range, of positive values only where only these count."""
        if self._uniform:
            return float(self.high > 0.0 or not positive)
        location, scale, low, high = self._standard_range()
        if positive and not self._logs:
            low = max(low, 0.0)
        return float(norm.cdf((high - location) / scale) - norm.cdf((low - location) / scale))

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
