"""The columns and header keys of a specimen file, and what each means."""

from __future__ import annotations

from typing import NamedTuple


class Meaning(NamedTuple):
    """What a column or a key says, and what holds without it."""

    words: str
    default: str


NEEDED = "required"
ONE_PAIR = "required, or another pair"
OF_FORCES = "required with forces"
NONE = "none"
EXACT = "exact"
ZERO = "no offset"
FROM_SCATTER = "from the scatter of the rows"
COLUMNS = {
    "stretch_x": Meaning(
        "Stretch along x relative to the mounted state; each protocol is divided by its own value "
        "at rest where that is not 1, unless `reference` is common",
        NEEDED,
    ),
    "stretch_y": Meaning("The same along y", NEEDED),
    "protocol": Meaning(
        "Name of the loading path, the same in all its rows, which stand together", "one protocol"
    ),
    "time_s": Meaning("Time of the row; may not run backwards in a protocol", NONE),
    "force_x_N": Meaning("Force along x, tension positive, not tared after mounting", ONE_PAIR),
    "force_y_N": Meaning("The same along y", ONE_PAIR),
    "piola_x_kPa": Meaning(
        "First Piola-Kirchhoff stress: force over the section in the state of `geometry`", ONE_PAIR
    ),
    "piola_y_kPa": Meaning("The same along y", ONE_PAIR),
    "cauchy_x_kPa": Meaning(
        "Cauchy stress as the lab computes it: that stress times the measured stretch", ONE_PAIR
    ),
    "cauchy_y_kPa": Meaning("The same along y", ONE_PAIR),
}
"""Columns by name; no others are known."""
KEYS = {
    "specimen": Meaning("Name of the specimen", "name of the file"),
    "donor": Meaning("Donor of the specimen, which `batch` groups by", NONE),
    "layer": Meaning("Such as media", NONE),
    "axis_x": Meaning("What x is, such as circumferential", NONE),
    "axis_y": Meaning("What y is", NONE),
    "geometry": Meaning(
        "State that dimensions, and stresses in the file, refer to: unloaded or mounted",
        f"unloaded with stresses; {OF_FORCES}",
    ),
    "reference": Meaning(
        "State that the stretches are relative to: `each protocol` (the first rows of each) or "
        "`common` (one for all protocols; those that do not start at it have no rows at rest)",
        "each protocol; asked for where first rows differ by more than 2 %",
    ),
    "mounted_state_x": Meaning(
        "With a common reference: stretch of the mounted state along x in the columns of the file; "
        "at least one protocol starts there",
        "1",
    ),
    "mounted_state_y": Meaning("The same along y", "1"),
    "edge_x_mm": Meaning("Edge along x", OF_FORCES),
    "edge_y_mm": Meaning("Edge along y; the force in x acts on edge_y x thickness", OF_FORCES),
    "thickness_mm": Meaning("Thickness", OF_FORCES),
    "edge_sd_mm": Meaning("Standard deviation of the edges", EXACT),
    "thickness_sd_mm": Meaning("Standard deviation of the thickness", EXACT),
    "load_noise_N": Meaning("Standard deviation of one force reading", FROM_SCATTER),
    "load_noise_kPa": Meaning("The same of a stress", FROM_SCATTER),
    "load_offset_sd_N": Meaning(
        "Standard deviation of the zero of the load cells, an unknown of each direction",
        ZERO,
    ),
    "load_offset_sd_kPa": Meaning("The same of a stress", ZERO),
    "mounting_stretch_x": Meaning(
        "Mounting stretch along x known from an image, as `1.03 +- 0.01`", "inferred"
    ),
    "mounting_stretch_y": Meaning("The same along y", "inferred"),
    "rest_rows": Meaning(
        "Leading rows at rest: one number for all protocols, or one for each with commas; 0 "
        "for a protocol that starts elsewhere than the common reference",
        "found from the stretches",
    ),
    "missing_rows": Meaning(
        "`drop` leaves out rows in which a reading is missing (empty or NaN) and counts them",
        "such rows are refused",
    ),
    "stress_limit_kPa": Meaning("Accept stresses up to this", "5000"),
    "source": Meaning("Where the record is from, as `convert` writes it", NONE),
    "conversion": Meaning("What `convert` took stretches and loads to be", NONE),
    "cycle": Meaning("Cycle that `convert` took", NONE),
    "branch": Meaning("Branch that `convert` took; `check` warns unless it is loading", NONE),
    "largest_shear": Meaning("Largest shear, which the model ignores", NONE),
    "largest_shear_angle_deg": Meaning("The same as an angle", NONE),
}
"""Header keys by name; no others are known."""
