"""The columns and header keys of a specimen file, and what each means."""

from __future__ import annotations

from typing import NamedTuple


class Column(NamedTuple):
    """What a column means, and what holds without it."""

    words: str
    default: str


class Key(NamedTuple):
    """What a header key means, what holds without it, and which values it takes.

    ``values`` is a range of numbers outside of which the unit or the value must be wrong, or a
    tuple of words; None stands for any text. The specimen keeps an ``extra`` key in its metadata.
    """

    words: str
    default: str
    values: tuple[float, float] | tuple[str, ...] | None = None
    extra: bool = False


NEEDED = "required"
ONE_PAIR = "required, or another pair"
OF_FORCES = "required with forces"
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
REFERENCES = ("each protocol", "common")
"""What measured stretches are relative to: the first rows of each protocol, or one state."""
COLUMNS = {
    "stretch_x": Column(
        "Stretch along x relative to the mounted state; each protocol is divided by its own value "
        "at rest where that is not 1, unless `reference` is common",
        NEEDED,
    ),
    "stretch_y": Column("The same along y", NEEDED),
    "protocol": Column(
        "Name of the loading path, the same in all its rows, which stand together", "one protocol"
    ),
    "time_s": Column("Time of the row; may not run backwards in a protocol", NONE),
    "force_x_N": Column("Force along x, tension positive, not tared after mounting", ONE_PAIR),
    "force_y_N": Column("The same along y", ONE_PAIR),
    "piola_x_kPa": Column(
        "First Piola-Kirchhoff stress: force over the section in the state of `geometry`", ONE_PAIR
    ),
    "piola_y_kPa": Column("The same along y", ONE_PAIR),
    "cauchy_x_kPa": Column(
        "Cauchy stress as the lab computes it: that stress times the measured stretch", ONE_PAIR
    ),
    "cauchy_y_kPa": Column("The same along y", ONE_PAIR),
}
"""Columns by name; no others are known."""
KEYS = {
    "specimen": Key("Name of the specimen", "name of the file"),
    "donor": Key("Donor of the specimen, which `batch` groups by", NONE, extra=True),
    "layer": Key("Such as media", NONE),
    "axis_x": Key("What x is, such as circumferential", NONE),
    "axis_y": Key("What y is", NONE),
    "geometry": Key(
        "State that dimensions, and stresses in the file, refer to: unloaded or mounted",
        f"unloaded with stresses; {OF_FORCES}",
        GEOMETRIES,
    ),
    "reference": Key(
        "State that the stretches are relative to: `each protocol` (the first rows of each) or "
        "`common` (one for all protocols; those that do not start at it have no rows at rest)",
        "each protocol; asked for where first rows differ by more than 2 %",
        REFERENCES,
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
    "thickness_mm": Key("Thickness", OF_FORCES, (1e-4, 1_000.0)),
    "edge_sd_mm": Key("Standard deviation of the edges", EXACT, SD_MM, extra=True),
    "thickness_sd_mm": Key("Standard deviation of the thickness", EXACT, SD_MM, extra=True),
    "load_noise_N": Key("Standard deviation of one force reading", FROM_SCATTER, LOAD_SD),
    "load_noise_kPa": Key("The same of a stress", FROM_SCATTER, LOAD_SD),
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
    "rest_rows": Key(
        "Leading rows at rest: one number for all protocols, or one for each with commas; 0 "
        "for a protocol that starts elsewhere than the common reference",
        "found from the stretches",
    ),
    "missing_rows": Key(
        "`drop` leaves out rows in which a reading is missing (empty or NaN) and counts them",
        "such rows are refused",
        ("drop",),
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
"""Header keys by name; no others are known."""
METADATA_KEYS = tuple(name for name, key in KEYS.items() if key.extra)
NUMBER_RANGES: dict[str, tuple[float, float]] = {
    name: (float(key.values[0]), float(key.values[1]))
    for name, key in KEYS.items()
    if key.values and not isinstance(key.values[0], str)
}
CHOICES: dict[str, tuple[str, ...]] = {
    name: tuple(map(str, key.values))
    for name, key in KEYS.items()
    if key.values and isinstance(key.values[0], str)
}
