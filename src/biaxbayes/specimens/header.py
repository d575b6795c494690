"""The header of a specimen file: ``# key: value`` lines above the table."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.specimens.keys import CHOICES, KEYS, NUMBER_RANGES, STRETCH_RANGE
from biaxbayes.tables.units import likely_name
from biaxbayes.text_files import cells_of, number_in, one_line

MOUNTED_STATE = ("mounted_state_x", "mounted_state_y")
"""Measured stretch of the mounted state, in a record with one common reference."""
CHOICE_REMEDIES = {
    "geometry": "say in which state the dimensions were measured",
    "reference": "say what the stretches are relative to: the first rows of each protocol, or "
    "one state for all",
    "missing_rows": "leave the line out to have such rows refused",
}


@dataclass(frozen=True)
class Header:
    """Values by key, and the line of the file that each stands in."""

    values: Mapping[str, float | str]
    rows: Mapping[str, int]

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def number(self, key: str) -> float | None:
        """A number, None where the file has no such key."""
        value = self.values.get(key)
        return None if value is None else float(value)

    def text(self, key: str) -> str | None:
        """A text, None where the file has no such key or leaves it empty."""
        return str(self.values.get(key) or "") or None

    @property
    def rest_rows(self) -> tuple[int, ...] | None:
        """Leading rows at rest where the file gives them: one for all protocols, or one each."""
        value = self.values.get("rest_rows")
        return None if value is None else tuple(int(part) for part in str(value).split(","))


def read_header(lines: Sequence[str], path: Path) -> tuple[Header, int]:
    """Header of a file, and the index of the line with the column names.

    Unknown or repeated keys, values that cannot be, and a file without a table are refused.
    """
    values: dict[str, float | str] = {}
    rows: dict[str, int] = {}
    for row, line in enumerate(lines, start=1):
        stripped = line.strip()
        # A spreadsheet quotes header lines and pads them with separators.
        if stripped.startswith('"#'):
            stripped = cells_of(stripped)[0].strip()
        if stripped.endswith(",,"):
            stripped = stripped.rstrip(",").rstrip()
        if not stripped:
            continue
        if not stripped.startswith("#"):
            _check_mounted_state(values, rows, path)
            return Header(values, rows), row - 1
        key, colon, value = stripped.lstrip("#").partition(":")
        if not colon:
            continue  # a plain comment
        key, value = key.strip(), one_line(value)
        if key in values:
            raise InputError(
                f"header key {key!r} appears twice", file=path, row=row, remedy="keep one"
            )
        if key not in KEYS:
            _, hint = likely_name(key, KEYS)
            raise InputError(
                f"unknown header key {key[:60]!r}",
                file=path,
                row=row,
                remedy=f"{hint}known keys are {', '.join(KEYS)}; drop the colon for a plain "
                "comment",
            )
        if value:
            values[key] = checked_value(key, value, row, path)
            rows[key] = row
    raise InputError(
        "the file has no table",
        file=path,
        remedy="give a line of column names (stretch_x,stretch_y,force_x_N,force_y_N) and rows",
    )


def _check_mounted_state(values: Mapping[str, object], rows: Mapping[str, int], path: Path) -> None:
    for key in MOUNTED_STATE:
        if key in values and values.get("reference") != "common":
            raise InputError(
                f"{key} needs one common reference",
                file=path,
                row=rows[key],
                remedy="add a line '# reference: common', or leave it out",
            )


def checked_value(key: str, value: str, row: int | None = None, path: object = None) -> float | str:
    """Value of a known key from its text; one that cannot be is refused."""
    if key in NUMBER_RANGES:
        return _number(key, value, row, path)
    problem = remedy = ""
    if key in ("mounting_stretch_x", "mounting_stretch_y"):
        measured_stretch(value, path, row)
    elif key in CHOICES and value not in CHOICES[key]:
        problem = f"{key} must be {' or '.join(map(repr, CHOICES[key]))}"
        remedy = CHOICE_REMEDIES[key]
    elif key == "rest_rows" and not re.fullmatch(r"\d{1,9}(\s*,\s*\d{1,9})*", value):
        problem = "rest_rows must be a whole number from 1"
        remedy = "give one for all protocols, or one each, separated by commas"
    if problem:
        raise InputError(f"{problem}, not {value[:40]!r}", file=path, row=row, remedy=remedy)
    return value


def _number(key: str, value: str, row: int | None, path: object) -> float:
    low, high = NUMBER_RANGES[key]
    try:
        number = number_in(value)
    except ValueError:
        number = None
    if number is None or number < 0.0 or (number == 0.0 and low > 0.0):
        kind = "a positive number" if low > 0.0 else "a number from 0"
        remedy = "write it with a decimal point and without unit, as in '# thickness_mm: 1.35'"
        raise InputError(
            f"{key} must be {kind}, not {value[:40]!r}",
            file=path,
            row=row,
            remedy="leave the line out where it is not known" if number == 0.0 else remedy,
        )
    if not low <= number <= high:
        unit = "" if key in MOUNTED_STATE else f" in {key.rsplit('_', 1)[1]}"
        raise InputError(
            f"{key} of {number:g} cannot be",
            file=path,
            row=row,
            remedy=f"give it{unit}, between {low:g} and {high:g}",
        )
    return number


def measured_stretch(text: str, path: object = None, row: int | None = None) -> tuple[float, float]:
    """Mean and standard deviation from text such as ``1.03 +- 0.01`` (or ``±``)."""
    parts = text.replace("±", "+-").split("+-")
    try:
        mean, sd = (number_in(part) for part in parts)
    except ValueError:
        mean = sd = 0.0
    low, high = STRETCH_RANGE
    if not (low < mean < high and 0.0 < sd < high):
        raise InputError(
            f"a mounting stretch known from an image reads like '1.03 +- 0.01', not {text[:40]!r}",
            file=path,
            row=row,
            remedy="give value and standard deviation",
        )
    return mean, sd
