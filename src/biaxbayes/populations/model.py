"""Pooled values with scales and priors (docs/population.md); group and donor of each specimen.

The sampling coordinates of single runs are never pooled: an average of them is not a material.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws.law import Law
from biaxbayes.model.priors import FAMILIES
from biaxbayes.options import PopulationOptions
from biaxbayes.parameters import MOUNTING_PARAMETERS, STRETCH, Parameter
from biaxbayes.populations.hierarchy import Layout
from biaxbayes.studies.groups import LINEAR, LOG, spread_scale
from biaxbayes.text_files import read_toml

ETA = 2.0
SPECIMENS_PER_VALUE = 4
"""Specimens (or donors) per pooled value, below which correlations are left out."""


@dataclass(frozen=True)
class PooledValue:
    """A parameter whose distribution specimens share; means and scales are on its scale."""

    parameter: Parameter
    mean: float  # normal prior of a group's mean
    mean_sd: float
    donor_scale: float  # of the half-normal priors of the sds between donors and within them
    specimen_scale: float

    @property
    def name(self) -> str:
        """Name as in ``summary.csv``."""
        return self.parameter.name

    @property
    def scale(self) -> str:
        """``log`` or ``linear``."""
        return LOG if self.parameter.logarithmic else LINEAR

    @property
    def limits(self) -> tuple[float, float]:
        """Range on the scale; infinite where unbounded."""
        return (-math.inf, math.inf) if self.parameter.logarithmic else self.parameter.range

    def to_scale(self, natural: np.ndarray) -> np.ndarray:
        """Natural values on the scale of the model."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(natural) if self.parameter.logarithmic else np.asarray(natural)

    def from_scale(self, values: np.ndarray) -> np.ndarray:
        """Inverse of :meth:`to_scale`."""
        return np.exp(values) if self.parameter.logarithmic else np.asarray(values)

    def mean_in_words(self) -> str:
        """The prior of a group's mean."""
        if self.parameter.logarithmic:
            return f"LN({math.exp(self.mean):.4g}, {self.mean_sd:.3g})"
        return f"N({self.mean:.4g}, {self.mean_sd:.3g})"


def pooled_values(law: Law, free: Sequence[str], *, mounting: bool = False) -> list[PooledValue]:
    """The pooled values of a law for the parameters that the runs sampled, with default priors.

    A group's mean has the prior of a single run.
    """
    chosen = [p for p in law.parameters if p.name in free]
    if mounting:
        chosen += [p for p in MOUNTING_PARAMETERS if p.kind == STRETCH]
    out = []
    for p in chosen:
        family, first, second = p.prior or ("uniform", p.low, p.high)
        if family in ("lognormal", "loguniform"):
            first = math.log(first)
        if p.kind == STRETCH:
            mean, sd = 1.0, 0.1
        elif family in ("uniform", "loguniform"):
            last = math.log(second) if family == "loguniform" else second
            mean, sd = 0.5 * (first + last), 0.25 * (last - first)
        else:
            mean, sd = first, second
        scale = spread_scale(p, 0.5 * sd, log=p.logarithmic)
        out.append(PooledValue(p, mean, sd, scale, scale))
    return out


@dataclass(frozen=True)
class PopulationPriors:
    """User priors in place of the defaults, by parameter."""

    # mean and sd on the scale
    mean: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sd_donors: Mapping[str, float] = field(default_factory=dict)
    sd_specimens: Mapping[str, float] = field(default_factory=dict)
    # of the LKJ priors
    correlations: Mapping[str, float] = field(
        default_factory=lambda: dict.fromkeys(("donors", "specimens"), ETA)
    )

    def apply_to(self, values: Sequence[PooledValue]) -> list[PooledValue]:
        """The values with these priors; InputError for a parameter that is not pooled."""
        names = [v.name for v in values]
        for table in ("mean", "sd_donors", "sd_specimens"):
            for name in getattr(self, table):
                if name not in names:
                    raise InputError(
                        f"[{table}] {name[:60]!r} is not a pooled parameter of this study",
                        remedy=f"pooled are {', '.join(names)}",
                    )
        out = []
        for v in values:
            mean, sd = self.mean.get(v.name, (v.mean, v.mean_sd))
            donors = self.sd_donors.get(v.name, v.donor_scale)
            specimens = self.sd_specimens.get(v.name, v.specimen_scale)
            out.append(PooledValue(v.parameter, mean, sd, donors, specimens))
        return out

    @classmethod
    def read(cls, path: Path) -> PopulationPriors:
        """Read a priors file (docs/population.md); InputError for a wrong key or value."""
        read: dict[str, Any] = {key: dict(known) for key, known in vars(cls()).items()}
        for table, entries in read_toml(path).items():
            if table not in read or not isinstance(entries, dict):
                raise InputError(
                    f"{table[:60]!r} is not a table of population priors",
                    file=path,
                    remedy=f"tables are {', '.join(f'[{k}]' for k in read)}",
                )
            for name, value in entries.items():
                if table == "correlations" and name not in read[table]:
                    raise InputError(f"[correlations] has no {name[:60]!r}", file=path)
                one = _read_mean if table == "mean" else _read_number
                read[table][name] = one(f"[{table}] {name[:60]}", value, path)
        return cls(**read)


def _read_number(where: str, value: Any, path: Path, *, least: float = 0.0) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (number and least < float(value) < math.inf):
        above = " above zero" if least == 0.0 else ""
        raise InputError(f"{where} must be a number{above}", file=path)
    return float(value)


def _read_mean(where: str, value: Any, path: Path) -> tuple[float, float]:
    """Mean and sd on the scale of the model."""
    for family, least in (("normal", -math.inf), ("lognormal", 0.0)):
        first, second = FAMILIES[family]
        named = isinstance(value, dict) and value.get("distribution") == family
        if named and set(value) == {"distribution", first, second}:
            mean = _read_number(f"{where}: {first}", value[first], path, least=least)
            sd = _read_number(f"{where}: {second}", value[second], path)
            return (math.log(mean) if family == "lognormal" else mean), sd
    remedy = "give mean and sd, or median and sd_log"
    raise InputError(
        f"{where} must be a normal or a lognormal distribution", file=path, remedy=remedy
    )


@dataclass(frozen=True)
class Grouping:
    """Label, group and donor of each specimen."""

    labels: tuple[str, ...]
    group: tuple[str, ...]
    donor: tuple[str, ...]

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups in their order."""
        return tuple(dict.fromkeys(self.group))

    @property
    def donors(self) -> tuple[str, ...]:
        """Names of the donors in their order."""
        return tuple(dict.fromkeys(self.donor))

    def donors_of(self, group: str) -> set[str]:
        """Names of the donors of a group."""
        return {d for d, g in zip(self.donor, self.group, strict=True) if g == group}

    @property
    def one_specimen_per_donor(self) -> bool:
        """True if only the prior splits the spread into that of donors and that of specimens."""
        return len(self.donors) == len(self.labels)


def make_layout(
    grouping: Grouping,
    values: Sequence[PooledValue],
    options: PopulationOptions,
    priors: PopulationPriors | None = None,
) -> Layout:
    """Arrays for the sampler; ``priors`` are of the correlations."""
    chosen = priors or PopulationPriors()
    donors, groups = grouping.donors, grouping.groups
    by_group = options.spread == "by-group"
    least = {"never": math.inf, "auto": SPECIMENS_PER_VALUE * len(values), "always": 0}
    counts = {"donors": len(donors), "specimens": len(grouping.labels)}
    eta = [
        chosen.correlations[side]
        if len(values) > 1 and count >= least[options.correlations]
        else 0.0
        for side, count in counts.items()
    ]
    centre = np.array([v.mean for v in values])
    return Layout(
        group=np.array([groups.index(g) for g in grouping.group]),
        donor=np.array([donors.index(d) for d in grouping.donor]),
        covariance_index=np.arange(len(groups)) if by_group else np.zeros(len(groups), int),
        donors=len(donors),
        sets=len(groups) if by_group else 1,
        low=np.array([v.limits[0] for v in values]) - centre,
        high=np.array([v.limits[1] for v in values]) - centre,
        mean_sd=np.array([v.mean_sd for v in values]),
        scale=np.array([[v.donor_scale, v.specimen_scale] for v in values]).T,
        eta=np.array(eta),
    )
