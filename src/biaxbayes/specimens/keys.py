"""The columns and header keys of a specimen file: meaning, default and allowed values."""

from __future__ import annotations

import re
from typing import NamedTuple

from biaxbayes.errors import InputError
from biaxbayes.mechanics.experiments import TESTS
from biaxbayes.text_files import number_in, one_line

REQUIRED = "required"
ONE_PAIR = "required, or another pair"
OF_FORCES = "required with forces"
OF_TUBES = "required of a tube"
NONE = "none"
EXACT = "exact"
ZERO = "no offset"
FROM_SCATTER = "from the scatter of the rows"
EDGE_MM = (0.01, 10_000.0)
SD_MM = (1e-9, 1_000.0)
LOAD_SD = (1e-15, 1e9)
STRETCH_RANGE = (0.2, 5.0)
"""Stretches that a biaxial test of soft tissue can reach."""
GEOMETRIES = ("unloaded", "mounted")
STRETCHES_FROM = ("markers", "grips")
HOOK_WIDTH_MM = 2.0
REFERENCES = ("each protocol", "common")
"""References of measured stretches: the first rows of each protocol, or one state for all."""


class FileColumn(NamedTuple):
    """Meaning of a column, and its default."""

    meaning: str
    default: str


class Key(NamedTuple):
    """Meaning, default and allowed values of a header key; any text without range and choices."""

    meaning: str
    default: str
    range: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    extra: bool = False  # kept in the metadata


COLUMNS = {
    "stretch_x": FileColumn(
        "Stretch along x relative to the mounted state; each protocol is divided by its own value "
        "at rest where that is not 1, unless `reference` is common",
        REQUIRED,
    ),
    "stretch_y": FileColumn("The same along y", REQUIRED),
    "protocol": FileColumn(
        "Name of the loading path, the same in all its rows, which are together", "one protocol"
    ),
    "time_s": FileColumn("Time of the row; may not run backwards in a protocol", NONE),
    "force_x_N": FileColumn("Force along x, tension positive, not tared after mounting", ONE_PAIR),
    "force_y_N": FileColumn("The same along y", ONE_PAIR),
    "piola_x_kPa": FileColumn(
        "First Piola-Kirchhoff stress: force over the section in the state of `geometry`", ONE_PAIR
    ),
    "piola_y_kPa": FileColumn("The same along y", ONE_PAIR),
    "cauchy_x_kPa": FileColumn(
        "Cauchy stress as the lab computes it: that stress times the measured stretch", ONE_PAIR
    ),
    "cauchy_y_kPa": FileColumn("The same along y", ONE_PAIR),
    "pressure_kPa": FileColumn("Of a tube: pressure inside less that outside", OF_TUBES),
    "pressure_mmHg": FileColumn("The same in millimetres of mercury", "pressure_kPa"),
    "axial_force_N": FileColumn(
        "Of a tube: force of the transducer at its closed end, that is the axial force of the wall "
        "less pressure times lumen",
        "not read",
    ),
    "outer_diameter_mm": FileColumn(
        "Of a tube: outer diameter under load; or `stretch_x`, the same over the unloaded one",
        OF_TUBES,
    ),
    "length_mm": FileColumn(
        "Of a tube: length under load between the marks of `unloaded_length_mm`", "stretch_z"
    ),
    "stretch_z": FileColumn(
        "Of a tube: axial stretch, relative to the unloaded tube; `stretch_y` means the same",
        OF_TUBES,
    ),
}
"""Known columns by name."""
KEYS = {
    "specimen": Key("Name of the specimen", "name of the file"),
    "test": Key(
        "Kind of test: `biaxial`; `strip x` or `strip y`, a strip pulled along x or y, whose file "
        "has stretch and load of that direction, and the other stretch if the width was measured; "
        "`tube`, a pressurised tube, whose circumference is x and whose axis is y",
        "biaxial",
        choices=TESTS,
    ),
    "donor": Key("Donor of the specimen, which `batch` groups by", NONE, extra=True),
    "layer": Key("Such as media", NONE),
    "axis_x": Key("What x is, such as circumferential", NONE),
    "axis_y": Key("What y is", NONE),
    "geometry": Key(
        "State that dimensions, and stresses in the file, refer to: unloaded or mounted",
        f"unloaded with stresses; {OF_FORCES}",
        choices=GEOMETRIES,
    ),
    "reference": Key(
        "State that the stretches are relative to: `each protocol` (the first rows of each) or "
        "`common` (one for all protocols; those that do not start at it have no rows at rest)",
        "each protocol; required where first rows differ by more than 2 %",
        choices=REFERENCES,
    ),
    "mounted_state_x": Key(
        "With a common reference: stretch of the mounted state along x in the columns of the file; "
        "at least one protocol starts there",
        "1",
        STRETCH_RANGE,
    ),
    "mounted_state_y": Key("The same along y", "1", STRETCH_RANGE),
    "edge_x_mm": Key("Edge along x", OF_FORCES, EDGE_MM),
    "edge_y_mm": Key("Edge along y; the force in x acts on edge_y x thickness", OF_FORCES, EDGE_MM),
    "thickness_mm": Key("Thickness, of a tube unloaded", OF_FORCES, (1e-4, 1_000.0)),
    "unloaded_outer_diameter_mm": Key(
        "Outer diameter of a tube without pressure and force", OF_TUBES, EDGE_MM, extra=True
    ),
    "unloaded_length_mm": Key(
        "Length of a tube without pressure and force between the same two marks",
        "required with a column length_mm",
        EDGE_MM,
        extra=True,
    ),
    "opening_angle_fung_deg": Key(
        "Opening angle of a ring of a tube cut open, between the lines from the middle of its "
        "inner wall to the ends of the inner wall; half the missing sector",
        "0, no residual stress",
        (0.0, 175.0),
        extra=True,
    ),
    "missing_sector_deg": Key(
        "Angle that the opened ring lacks of a full circle, at its centre",
        "0, no residual stress",
        (0.0, 350.0),
        extra=True,
    ),
    "axial_force_noise_N": Key(
        "Standard deviation of one reading of the axial force of a tube",
        FROM_SCATTER,
        LOAD_SD,
        extra=True,
    ),
    "edge_sd_mm": Key("Standard deviation of the edges", EXACT, SD_MM, extra=True),
    "thickness_sd_mm": Key("Standard deviation of the thickness", EXACT, SD_MM, extra=True),
    "load_noise_N": Key("Standard deviation of one force reading", FROM_SCATTER, LOAD_SD),
    "load_noise_kPa": Key("The same of a stress or a pressure", FROM_SCATTER, LOAD_SD),
    "load_offset_sd_N": Key(
        "Standard deviation of the zero of the load cells, an unknown of each direction",
        ZERO,
        LOAD_SD,
        extra=True,
    ),
    "load_offset_sd_kPa": Key("The same of a stress", ZERO, LOAD_SD, extra=True),
    "mounting_stretch_x": Key(
        "Mounting stretch along x known from an image, as `1.03 +- 0.01`", "inferred", extra=True
    ),
    "mounting_stretch_y": Key("The same along y", "inferred", extra=True),
    "grips": Key(
        "Hooks per edge, as `hooks 5`: `sample` and `fit` correct the loads for them by finite "
        "elements; `none` for loads of a uniform test",
        "no correction, with a note",
        extra=True,
    ),
    "grip_inset_mm": Key(
        "Distance of the hooks from the edge; required with `grips`", NONE, EDGE_MM, extra=True
    ),
    "grip_width_mm": Key(
        "Diameter of the patch of tissue that a hook moves",
        f"{HOOK_WIDTH_MM:g}, less where hooks are closer to each other or to the edge",
        EDGE_MM,
        extra=True,
    ),
    "grip_spacing_mm": Key(
        "Distance between neighbouring hooks",
        "equal distances from each other and the corners",
        EDGE_MM,
        extra=True,
    ),
    "stretch_from": Key(
        "Whether stretches are measured between four markers in the centre or between opposite "
        "hooks (`grips`); needs `grips`",
        "markers",
        choices=STRETCHES_FROM,
        extra=True,
    ),
    "grip_correction": Key(
        "`applied` in the files that `sample` writes, whose loads are corrected for the grips",
        "loads as measured",
        choices=("applied",),
        extra=True,
    ),
    "rest_rows": Key(
        "Leading rows at rest: one number for all protocols, or one for each with commas; 0 "
        "for a protocol that starts elsewhere than the common reference",
        "counted from the stretches",
    ),
    "missing_rows": Key(
        "`drop` leaves out rows in which a reading is missing (empty or NaN) and counts them",
        "such rows are refused",
        choices=("drop",),
    ),
    "stress_limit_kPa": Key("Accept stresses up to this", "5000", (1.0, 1e9), extra=True),
    "source": Key("Where the record is from, as `convert` writes it", NONE, extra=True),
    "conversion": Key("What `convert` took stretches and loads to be", NONE, extra=True),
    "cycle": Key("Cycle that `convert` took", NONE, extra=True),
    "branch": Key(
        "Branch that `convert` took; `check` warns unless it is loading", NONE, extra=True
    ),
    "largest_shear": Key("Largest shear, which the model ignores", NONE, (0.0, 10.0), extra=True),
    "largest_shear_angle_deg": Key("The same as an angle", NONE, (0.0, 90.0), extra=True),
}
"""Known header keys by name."""
DIMENSIONS = ("edge_x_mm", "edge_y_mm", "thickness_mm")
ARGUMENT_KEYS = ("layer", "axis_x", "axis_y", *DIMENSIONS, "reference")
"""Keys that are arguments of a specimen of the same name, without a default of their own."""
METADATA_KEYS = tuple(name for name, key in KEYS.items() if key.extra)
NO_GRIPS = "none"
"""Value of `grips` for loads of a uniform test."""
GRIP_DETAILS = tuple(k for k in KEYS if k.startswith("grip_")) + ("stretch_from",)
"""Keys that need `grips`."""
TUBE_KEYS = (
    "unloaded_outer_diameter_mm",
    "unloaded_length_mm",
    "opening_angle_fung_deg",
    "missing_sector_deg",
    "axial_force_noise_N",
)
"""Keys of tubes alone."""
TUBE_COLUMNS = {
    "outer_diameter_mm": ("stretch_x", "unloaded_outer_diameter_mm"),
    "length_mm": ("stretch_y", "unloaded_length_mm"),
    "stretch_z": ("stretch_y", ""),
    "pressure_mmHg": ("pressure_kPa", ""),
}
"""Columns of tubes alone: the column that they stand for, and the key they are divided by."""
NOT_OF_TUBES = (
    "edge_x_mm", "edge_y_mm", "edge_sd_mm", "thickness_sd_mm", "reference", "rest_rows",
    "mounted_state_x", "mounted_state_y", "mounting_stretch_x", "mounting_stretch_y",
    "load_noise_N", "load_offset_sd_N", "load_offset_sd_kPa", "grips", "grip_correction",
    *GRIP_DETAILS,
)  # fmt: skip
"""Keys that a tube, whose stretches are total, does not have."""


def directions_of(test: str | None) -> str:
    """Directions in which a kind of test reads stretch and load; both if it is not known."""
    return test[-1] if test and test.startswith("strip") else "xy"


def needed_with_forces(test: str | None) -> list[str]:
    """Keys that forces need; no section depends on the length of a strip."""
    return [key for key in (*DIMENSIONS, "geometry") if key != f"edge_{directions_of(test)}_mm"]


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
        unit = "" if key.startswith("mounted_state") else f" in {key.rsplit('_', 1)[1]}"
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
    if not (low < mean < high and 0.0 < sd < high):
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
