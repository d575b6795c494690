"""Whether numbers can be what their column says: ratios near one, stresses that tissue bears."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from biaxbayes.errors import InputError

__all__ = ["STRESS_LIMIT_KPA", "check_load", "check_stretch", "check_time"]

STRETCH_RANGE = (0.2, 5.0)
STRESS_LIMIT_KPA = 5_000.0
"""Soft tissue tears below; beyond, the unit is wrong (``stress_limit_kPa`` overrides)."""
STRESS_FLOOR_KPA = 1e-6
OUTLIER = 1e4
"""So many times the limit is no question of units."""
TIME_LIMIT_S = 1e9


def check_stretch(
    values: np.ndarray, lines: Sequence[int] | np.ndarray, column: str, file: object
) -> None:
    """Refuse stretches that are strains, per cent, or nonsense.

    Parameters
    ----------
    values : ndarray, shape (n,)
    lines : sequence of int
        Line of the file that each value stands in.
    column : str
    file : object
        For the message.
    """
    bad = np.flatnonzero((values < STRETCH_RANGE[0]) | (values > STRETCH_RANGE[1]))
    if not bad.size:
        return
    value = values[bad[0]]
    if value < 0.0 and np.median(values) > STRETCH_RANGE[0]:
        remedy = "a stretch is positive; mend the value or remove the row"
    else:
        remedy = "stretches are ratios near 1, not strains or per cent"
    raise InputError(
        f"a stretch of {value:g} cannot be",
        file=file,
        row=int(lines[bad[0]]),
        column=column,
        remedy=remedy,
    )


def check_load(
    values: np.ndarray,
    lines: Sequence[int] | np.ndarray,
    column: str,
    file: object,
    *,
    section_mm2: float | None,
    limit_kPa: float | None = None,
) -> None:
    """Refuse a load column without a load, or with one that no soft tissue bears.

    Parameters
    ----------
    values : ndarray, shape (n,)
        N where ``section_mm2`` is given, else kPa.
    lines, column, file
        As in :func:`check_stretch`.
    section_mm2 : float or None
    limit_kPa : float, optional
        Another limit than :data:`STRESS_LIMIT_KPA`, as the file's header states it.
    """
    row = int(np.argmax(np.abs(values)))
    peak = abs(float(values[row]))
    if np.all(values == values[0]):
        raise InputError(
            "every value is zero" if peak == 0.0 else f"every value is {values[0]:g}",
            file=file,
            row=int(lines[0]),
            column=column,
            remedy="no load was recorded",
        )
    # kPa = N / mm^2 * 1e3
    stress = peak if section_mm2 is None else peak / section_mm2 * 1e3
    limit = limit_kPa or STRESS_LIMIT_KPA
    if stress > limit:
        raise InputError(
            f"{values[row]:g} means a stress of {stress / 1000:.3g} MPa, "
            "more than soft tissue bears",
            file=file,
            row=int(lines[row]),
            column=column,
            remedy=_remedy(stress, limit, "Pa" if section_mm2 is None else "mN"),
        )
    if stress < STRESS_FLOOR_KPA:
        raise InputError(
            f"the largest value, {values[row]:g}, means a stress of {stress:.3g} kPa",
            file=file,
            row=int(lines[row]),
            column=column,
            remedy="check the unit",
        )


def _remedy(stress: float, limit: float, unit: str) -> str:
    if stress > OUTLIER * limit:
        return "mend the value or remove the row"
    return (
        f"if the values are in {unit}, divide them by 1000; "
        f"if they are right, add a line '# stress_limit_kPa: {1.5 * stress:.2g}'"
    )


def check_time(
    values: np.ndarray, lines: Sequence[int] | np.ndarray, column: str, file: object
) -> None:
    """Refuse times that no record has."""
    bad = np.flatnonzero(np.abs(values) > TIME_LIMIT_S)
    if bad.size:
        raise InputError(
            f"a time of {values[bad[0]]:g} s",
            file=file,
            row=int(lines[bad[0]]),
            column=column,
            remedy="give seconds from the start of the test",
        )
