"""Parameters that a fit holds, by the names and units that users know."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.inference.starting_points import LOWER, UPPER
from biaxbayes.mechanics.goh import PARAMETERS

__all__ = ["held_and_free"]

RANGES = {
    "C1": (LOWER[0], UPPER[0], "kPa"),
    "k1": (LOWER[1], UPPER[1], "kPa"),
    "k2": (LOWER[2], UPPER[2], ""),
    "alpha": (0.0, 90.0, "degrees"),
    "kappa": (LOWER[4], UPPER[4], ""),
}


def held_and_free(fixed: Mapping[str, float] | None) -> tuple[np.ndarray, np.ndarray]:
    """Held values as (C1, k1, k2, t, kappa) and the indices of the free ones.

    Parameters
    ----------
    fixed : mapping of str to float, optional
        C1 and k1 in kPa, k2, alpha in degrees, kappa.

    Raises
    ------
    InputError
        For an unknown name or a value outside the parameter's range.
    """
    point = np.zeros(5)
    held = dict(fixed or {})
    for name, value in held.items():
        if name not in RANGES:
            raise InputError(
                f"unknown parameter {name!r}", remedy=f"one of {', '.join(PARAMETERS)}"
            )
        low, high, unit = RANGES[name]
        if not (math.isfinite(value) and low <= value <= high + 1e-12):
            raise InputError(
                f"{name} = {value:g} is out of range",
                remedy=f"{name} lies between {low:g} and {high:g} {unit}".rstrip(),
            )
        index = PARAMETERS.index(name)
        if name == "alpha":
            point[index] = 0.0 if value == 90.0 else math.cos(math.radians(value)) ** 2
        else:
            point[index] = min(value, high)
    return point, np.array([i for i, name in enumerate(PARAMETERS) if name not in held], dtype=int)
