"""The columns and header keys of a specimen file: meaning, default and allowed values."""

from __future__ import annotations

import re

from biaxbayes.errors import InputError
from biaxbayes.experiments import BIAXIAL, EXPERIMENTS, Experiment
from biaxbayes.experiments.experiment import (
    DIMENSIONS,
    FROM_SCATTER,
    LOAD_SD,
    OF_FORCES,
    STRETCH_RANGE,
    Column,
    Key,
)
from biaxbayes.text_files import number_in, one_line

GEOMETRIES = ("unloaded", "mounted")
STRETCHES = ("stretch_x", "stretch_y")
COLUMNS = {
    "stretch_x": Column(
        "Stretch along x relative to the mounted state; each protocol is divided by its own value "
        "at rest where that is not 1, unless `reference` is common",
        "required",
    ),
    "stretch_y": Column("The same along y", "required"),
    "protocol": Column(
        "Name of the loading path, the same in all its rows, which are together", "one protocol"
    ),
    "time_s": Column("Time of the row; may not run backwards in a protocol", "none"),
    **{name: column for test in EXPERIMENTS.values() for name, column in test.columns.items()},
}
"""Known columns by name."""
KEYS = {
    "specimen": Key("Name of the specimen", "name of the file"),
    "test": Key(
        "Kind of test: "
        + "; ".join(f"`{name}`, {test.meaning}" for name, test in EXPERIMENTS.items()),
        BIAXIAL.name,
        choices=tuple(EXPERIMENTS),
    ),
    "donor": Key("Donor of the specimen, which `batch` groups by"),
    "layer": Key("Such as media"),
    "axis_x": Key("What x is, such as circumferential"),
    "axis_y": Key("What y is"),
    "geometry": Key(
        "State that dimensions, and stresses in the file, refer to: unloaded or mounted",
        f"unloaded with stresses; {OF_FORCES}",
        choices=GEOMETRIES,
    ),
    "thickness_mm": Key("Thickness, of a tube unloaded", OF_FORCES, (1e-4, 1_000.0)),
    **{name: key for test in EXPERIMENTS.values() for name, key in test.keys.items()},
    "load_noise_N": Key("Standard deviation of one force reading", FROM_SCATTER, LOAD_SD),
    "load_noise_kPa": Key("The same of a stress or a pressure", FROM_SCATTER, LOAD_SD),
    "missing_rows": Key(
        "`drop` leaves out rows in which a reading is missing (empty or NaN) and counts them",
        "such rows are refused",
        choices=("drop",),
    ),
    "stress_limit_kPa": Key("Accept stresses up to this", "5000", (1.0, 1e9)),
    "source": Key("Where the record is from, as `convert` writes it"),
    "conversion": Key("What `convert` took stretches and loads to be"),
    "cycle": Key("Cycle that `convert` took"),
    "branch": Key("Branch that `convert` took; `check` warns unless it is loading"),
    "largest_shear": Key("Largest shear, which the model ignores", range=(0.0, 10.0)),
    "largest_shear_angle_deg": Key("The same as an angle", range=(0.0, 90.0)),
}
"""Known header keys by name."""
ARGUMENT_KEYS = ("layer", "axis_x", "axis_y", *DIMENSIONS, "reference")
"""Keys that are arguments of a specimen of the same name, without a default of their own."""
MOUNTED_STATE = ("mounted_state_x", "mounted_state_y")
"""Measured stretch of the mounted state, in a record with one common reference."""
_OTHERS = ("specimen", "test", "geometry", "load_noise_N", "load_noise_kPa", "missing_rows")
METADATA_KEYS = tuple(
    key for key in KEYS if key not in (*ARGUMENT_KEYS, *MOUNTED_STATE, *_OTHERS, "rest_rows")
)
NO_GRIPS = "none"  # of `grips`, for loads of a uniform test
GRIP_DETAILS = tuple(k for k in KEYS if k.startswith("grip_")) + ("stretch_from",)
"""Keys that need `grips`."""
LEAST_SD = 1e-6  # of a mounting stretch from an image


def keys_of_others(test: Experiment) -> list[str]:
    """Keys of other kinds of test that this one has not."""
    of_tests = {key: None for other in EXPERIMENTS.values() for key in other.keys}
    return [key for key in of_tests if key not in test.keys]


def checked_value(key: str, value: object) -> float | str:
    """Value of a known key from a number or text; refuses impossible ones."""
    text, known = one_line(str(value)), KEYS[key]
    if known.range is not None:
        return _number(key, str(value), *known.range)
    if key in ("mounting_stretch_x", "mounting_stretch_y"):
        measured_stretch(text)
    elif key == "grips" and text != NO_GRIPS:
        hook_count(text)
    elif known.choices and text not in known.choices:
        problem = f"{key} must be {' or '.join(map(repr, known.choices))}, not {text[:40]!r}"
        remedy = f"without the line: {known.default}"
        raise InputError(problem, remedy=remedy)
    elif key == "rest_rows" and not re.fullmatch(r"\d{1,9}(\s*,\s*\d{1,9})*", text):
        problem = f"rest_rows must be a whole number from 1, not {text[:40]!r}"
        remedy = "give one for all protocols, or one each, separated by commas"
        raise InputError(problem, remedy=remedy)
    return text


def _number(key: str, text: str, low: float, high: float) -> float:
    try:
        number = number_in(text)
    except ValueError:
        number = -1.0
    if number < 0.0 or (number == 0.0 and low > 0.0):
        kind = "a positive number" if low > 0.0 else "a number from 0"
        remedy = "write it with a decimal point and without unit, as in '# thickness_mm: 1.35'"
        remedy = "leave the line out where it is not known" if number == 0.0 else remedy
        raise InputError(f"{key} must be {kind}, not {text[:40]!r}", remedy=remedy)
    if not low <= number <= high:
        has_unit = "stretch" not in key and key not in MOUNTED_STATE
        unit = f" in {key.rsplit('_', 1)[1]}" if has_unit else ""
        remedy = f"give it{unit}, between {low:g} and {high:g}"
        raise InputError(f"{key} of {number:g} is out of range", remedy=remedy)
    return number


def measured_stretch(text: str) -> tuple[float, float]:
    """Mean and standard deviation from text such as ``1.03 +- 0.01`` (or ``±``)."""
    try:
        mean, sd = (number_in(part) for part in text.replace("±", "+-").split("+-"))
    except ValueError:
        mean = sd = 0.0
    low, high = STRETCH_RANGE
    if not (low < mean < high and LEAST_SD < sd < high):
        problem = "a mounting stretch known from an image must be of the form '1.03 +- 0.01', not "
        raise InputError(f"{problem}{text[:40]!r}", remedy="give value and standard deviation")
    return mean, sd


def hook_count(text: str) -> int:
    """Hooks per edge from text such as ``hooks 5``."""
    match = re.fullmatch(r"hooks\s+([1-9]\d?)", text)
    if match is None:
        problem = f"grips must be of the form 'hooks 5', five hooks per edge, not {text[:40]!r}"
        remedy = "write 'none' for rakes, clamps and uniform tests, which are not corrected"
        raise InputError(problem, remedy=remedy)
    return int(match[1])
