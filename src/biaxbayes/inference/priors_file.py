"""Priors files: a number is fixed, a string is tied, a table is a distribution.

The format is TOML, one key a parameter::

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
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.inference.priors import DEFAULT_BOUNDS, FAMILIES, LOG_SCALE, Prior, Tie
from biaxbayes.specimens.text_file import read_text

__all__ = ["check_fixed", "parse_priors", "read_priors"]

FIXABLE = ("C1", "k1", "k2", "alpha", "kappa", "noise_sd")
SETTABLE = (
    *FIXABLE,
    "noise_growth",
    "mounting_stretch",
    "mounting_stretch_x",
    "mounting_stretch_y",
)
LEAST_MASS = 1e-9
"""A prior with less than this inside the possible range was meant for something else."""


def read_priors(path: Path) -> dict[str, Prior | float | Tie]:
    """Read a priors file.

    Raises
    ------
    InputError
        Naming the key that cannot be used.
    """
    try:
        table = tomllib.loads(read_text(path))
    except ValueError as error:  # also integers of thousands of digits
        raise InputError(f"not valid TOML ({str(error)[:80]})", file=path) from None
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
    ties = {name: value.other for name, value in out.items() if isinstance(value, Tie)}
    for name, other in ties.items():
        if ties.get(other) == name:
            raise InputError(
                f"{name} and {other} are tied in a circle",
                file=path,
                remedy="leave one of them free",
            )
    return out


def _parse(name: str, value: object, path: object) -> Prior | float | Tie:
    if isinstance(value, bool):
        raise InputError(f"{name} must be a number, a tie or a distribution", file=path)
    if isinstance(value, int | float):
        return check_fixed(name, _number(value), path)
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


def _number(value: object) -> float:
    """A number of a TOML file; NaN for what is none, infinite for what is too large."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf


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
    if not isinstance(family, str) or family not in FAMILIES:
        raise InputError(
            f"{name}: unknown distribution {str(family)[:40]!r}",
            file=path,
            remedy=f"use one of {', '.join(FAMILIES)}",
        )
    first, second = FAMILIES[family]
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
        values[key] = _number(value)
        if not math.isfinite(values[key]):
            raise InputError(f"{name}: {key} must be a finite number", file=path)
    for key in (first, second):
        if key not in values:
            raise InputError(f"{name}: the {family} prior lacks {key}", file=path)
    try:
        prior = Prior(
            family,
            values.get(first, 0.0) if first != "low" else 0.0,
            values.get(second, 1.0) if second != "high" else 1.0,
            values.get("low", -math.inf),
            values.get("high", math.inf),
        ).within(*DEFAULT_BOUNDS.get(name, (-math.inf, math.inf)))
        positive = name in LOG_SCALE or name.startswith("mounting_stretch")
        if prior.mass(positive=positive) < LEAST_MASS:
            raise ValueError("the prior has no mass where the parameter can be")
        prior.encode(log_scale=name in LOG_SCALE)
    except ValueError as error:
        raise InputError(f"{name}: {error}", file=path) from None
    return prior
