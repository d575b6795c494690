"""The header of a specimen file: ``# key: value`` lines above the table."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.specimens.keys import KEYS
from biaxbayes.specimens.plausibility import NUMBER_RANGES
from biaxbayes.specimens.protocol import STRETCH_RANGE
from biaxbayes.specimens.specimen import REFERENCES
from biaxbayes.tables.units import likely_name
from biaxbayes.text_files import cells_of, number_in, one_line

MEASURED_STRETCH_KEYS = ("mounting_stretch_x", "mounting_stretch_y")
METADATA_KEYS = (
    "donor",
    *MEASURED_STRETCH_KEYS,
    "edge_sd_mm",
    "thickness_sd_mm",
    "load_offset_sd_N",
    "load_offset_sd_kPa",
    "stress_limit_kPa",
    "largest_shear",
    "largest_shear_angle_deg",
    "source",
    "conversion",
    "cycle",
    "branch",
)
"""Keys that a specimen keeps as they are, in ``metadata``."""
KNOWN_KEYS = tuple(KEYS)
GEOMETRIES = ("unloaded", "mounted")
MOUNTED_STATE = ("mounted_state_x", "mounted_state_y")
"""Measured stretch of the mounted state, in a record with one common reference."""


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
        """Leading rows at rest as the file states them: one for all protocols, or one each."""
        value = self.values.get("rest_rows")
        return None if value is None else tuple(int(part) for part in str(value).split(","))


def read_header(lines: Sequence[str], path: Path) -> tuple[Header, int]:
    """Header of a file, and the index of the line with the column names.

    Raises
    ------
    InputError
        For an unknown or repeated key, a value that cannot be, or a file without a table.
    """
    values: dict[str, float | str] = {}
    rows: dict[str, int] = {}
    for index, line in enumerate(lines):
        stripped = _as_written(line)
        if not stripped:
            continue
        if not stripped.startswith("#"):
            _check_mounted_state(values, rows, path)
            return Header(values, rows), index
        key, colon, value = stripped.lstrip("#").partition(":")
        if not colon:
            continue  # a plain comment
        key, value = key.strip(), one_line(value)
        _check_key(key, values, index + 1, path)
        if value:
            values[key] = checked_value(key, value, index + 1, path)
            rows[key] = index + 1
    raise InputError(
        "the file has no table",
        file=path,
        remedy="give a line of column names (stretch_x,stretch_y,force_x_N,force_y_N) and rows",
    )


def _check_mounted_state(values: Mapping[str, object], rows: Mapping[str, int], path: Path) -> None:
    """The mounted state is stated apart only where the protocols share a reference."""
    for key in MOUNTED_STATE:
        if key in values and values.get("reference") != "common":
            raise InputError(
                f"{key} needs one common reference",
                file=path,
                row=rows[key],
                remedy="add a line '# reference: common', or leave it out",
            )


def _as_written(line: str) -> str:
    """A header line as it was before a spreadsheet quoted it and padded it with separators."""
    stripped = line.strip()
    if stripped.startswith('"#'):
        stripped = cells_of(stripped)[0].strip()
    return stripped.rstrip(",").rstrip() if stripped.endswith(",,") else stripped


def _check_key(key: str, values: Mapping[str, object], row: int, path: Path) -> None:
    if key in values:
        raise InputError(f"header key {key!r} appears twice", file=path, row=row, remedy="keep one")
    if key in KNOWN_KEYS:
        return
    _, hint = likely_name(key, KNOWN_KEYS)
    raise InputError(
        f"unknown header key {key[:60]!r}",
        file=path,
        row=row,
        remedy=f"{hint}known keys are {', '.join(KNOWN_KEYS)}; drop the colon for a plain comment",
    )


def checked_value(key: str, value: str, row: int | None = None, path: object = None) -> float | str:
    """Value of a known key from its text.

    Raises
    ------
    InputError
        If it cannot be.
    """
    if key in NUMBER_RANGES:
        return _number(key, value, row, path)
    if key in MEASURED_STRETCH_KEYS:
        measured_stretch(value, path, row)
    if key == "geometry" and value not in GEOMETRIES:
        raise InputError(
            f"geometry must be {' or '.join(map(repr, GEOMETRIES))}, not {value[:40]!r}",
            file=path,
            row=row,
            remedy="say in which state the dimensions were measured",
        )
    if key == "reference" and value not in REFERENCES:
        raise InputError(
            f"reference must be {' or '.join(map(repr, REFERENCES))}, not {value[:40]!r}",
            file=path,
            row=row,
            remedy="say what the stretches are relative to: the first rows of each protocol, or "
            "one state for all",
        )
    if key == "missing_rows" and value != "drop":
        raise InputError(
            f"missing_rows must be 'drop', not {value[:40]!r}",
            file=path,
            row=row,
            remedy="leave the line out to have such rows refused",
        )
    if key == "rest_rows" and not re.fullmatch(r"\d{1,9}(\s*,\s*\d{1,9})*", value):
        raise InputError(
            f"rest_rows must be a whole number from 1, not {value[:40]!r}",
            file=path,
            row=row,
            remedy="give one for all protocols, or one each, separated by commas",
        )
    return value


def _number(key: str, value: str, row: int | None, path: object) -> float:
    low, high = NUMBER_RANGES[key]
    try:
        number = number_in(value)
    except ValueError:
        number = None
    if number is None or number < 0.0 or (number == 0.0 and low > 0.0):
        kind = "a positive number" if low > 0.0 else "a number from 0"
        raise InputError(
            f"{key} must be {kind}, not {value[:40]!r}",
            file=path,
            row=row,
            remedy="leave the line out where it is not known"
            if number == 0.0
            else "write it with a decimal point and without unit, as in '# thickness_mm: 1.35'",
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
    """Mean and standard deviation from text such as ``1.03 +- 0.01``.

    Parameters
    ----------
    text : str
        Value, ``+-`` or ``±``, standard deviation.
    path, row : optional
        For the message.

    Returns
    -------
    float, float

    Raises
    ------
    InputError
        If the text reads otherwise, or a number is not positive.
    """
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
