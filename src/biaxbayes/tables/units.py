"""Units behind column names and header keys, names of stretches, and misspelt names."""

from __future__ import annotations

import difflib
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

# --- units, and their size in N, kPa, mm and s ----------------------------------------------------


@dataclass(frozen=True)
class Unit:
    """A unit: its quantity, and its size in N, kPa, mm, s or 1."""

    name: str
    quantity: str
    factor: float


GRAVITY = 9.80665
FACTORS: dict[str, dict[str, float]] = {
    "force": {
        "N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3, "gf": 1e-3 * GRAVITY, "kgf": GRAVITY,
        "lbf": 4.4482216152605, "dyn": 1e-5,
    },
    "stress": {
        "kPa": 1.0, "Pa": 1e-3, "MPa": 1e3, "GPa": 1e6, "N/m2": 1e-3, "N/cm2": 10.0, "N/mm2": 1e3,
        "mN/mm2": 1.0, "kN/m2": 1.0, "gf/mm2": GRAVITY, "gf/cm2": 1e-2 * GRAVITY,
        "kgf/mm2": 1e3 * GRAVITY, "kgf/cm2": 10.0 * GRAVITY, "dyn/cm2": 1e-4,
        "psi": 6.894757293168, "bar": 100.0, "mbar": 0.1, "mmHg": 0.133322387415,
        "cmH2O": 1e-2 * GRAVITY,
    },
    "length": {"mm": 1.0, "um": 1e-3, "cm": 10.0, "m": 1e3, "inch": 25.4, "px": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    "fraction": {"percent": 0.01, "permille": 1e-3, "microstrain": 1e-6, "mm/mm": 1.0},
    # Units that a column may have, but that cannot be converted; named in errors.
    "membrane tension": {"N/m": 1.0, "N/mm": 1e3, "N/cm": 100.0, "mN/mm": 1.0, "gf/cm": GRAVITY},
    "angle": {"deg": 1.0, "rad": 57.29577951308232},
}  # fmt: skip
UNITS = {
    name: Unit(name, quantity, factor)
    for quantity, factors in FACTORS.items()
    for name, factor in factors.items()
}
"""Units by name."""
ALIASES = {
    "g": "gf", "gram": "gf", "grams": "gf", "kg": "kgf", "kp": "kgf", "lb": "lbf", "lbs": "lbf",
    "dyne": "dyn", "dynes": "dyn", "newton": "N", "g/mm2": "gf/mm2", "g/cm2": "gf/cm2",
    "kg/mm2": "kgf/mm2", "kg/cm2": "kgf/cm2", "dyne/cm2": "dyn/cm2", "lbf/in2": "psi",
    "lb/in2": "psi", "in": "inch", "micron": "um", "sec": "s", "seconds": "s", "hr": "h",
    "%": "percent", "pct": "percent", "‰": "permille", "ue": "microstrain", "uε": "microstrain",
    "ustrain": "microstrain", "um/m": "microstrain", "ppm": "microstrain", "mm/m": "permille",
    "m/m": "mm/mm", "um/um": "mm/mm", "in/in": "mm/mm",
    "g/cm": "gf/cm", "pixel": "px", "pixels": "px", "°": "deg",
}  # fmt: skip
# "mPa" in small letters is not MPa, and nobody measures tissue in it.
LOWER_CASE = {name.lower(): unit for name, unit in UNITS.items()} | {
    alias: UNITS[name] for alias, name in ALIASES.items()
}


def units_of(*quantities: str) -> str:
    """Names of the units of some quantities, for help and messages."""
    return ", ".join(name for quantity in quantities for name in FACTORS[quantity])


def unit_named(text: str) -> Unit | None:
    """The unit of a name as files write it (``kgf/cm^2``, ``N mm-2``, ``µm``), or None."""
    name = text.strip("[](){} \t").replace("µ", "u").replace("μ", "u").replace("²", "2")
    name = re.sub(r"\^|\*\*", "", name)
    name = re.sub(r"[\s.*·]+(mm|cm|m|in)-2$", r"/\g<1>2", name)
    name = re.sub(r"\s*/\s*", "/", name)
    if name in UNITS:
        return UNITS[name]
    return None if name == "mPa" else LOWER_CASE.get(name.lower())


BOX = re.compile(r"[\[({][^\[\](){}]*[\])}]")
SHARE = re.compile(
    r"[%‰]|(?:(?<![A-Za-z])[Pp]|(?<=[a-z])P)(ercent|ct|ermille)(?![a-z])|(?<![A-Z])PERCENT(?![A-Z])"
)


def split_units(column: str) -> tuple[str, list[Unit]]:
    """Split a column name such as ``Force X [mN]`` or ``P, N/mm2`` into name and units."""
    units = []
    for pattern in (BOX, SHARE):
        for match in reversed(list(pattern.finditer(column))):
            if (unit := unit_named(match[0])) is not None:
                units.append(unit)
                column = f"{column[: match.start()].rstrip()} {column[match.end() :].lstrip()}"
    column = column.strip()
    for separator in re.finditer(r"[-_\s,/]+", "" if column.endswith(tuple("])}")) else column):
        unit = unit_named(column[separator.end() :])
        if unit is not None and separator.start() > 0:
            return column[: separator.start()], [*units, unit]
    return column, units


def unit_of_column(column: str) -> Unit | None:
    """The unit that a column name gives; None without one."""
    return next(iter(split_units(column)[1]), None)


def unknown_unit(text: str) -> str:
    """The text in brackets at the end, if it is neither a unit nor an axis."""
    match = re.search(BOX.pattern + r"\s*$", text)
    boxed = match[0].strip(" \t[](){}") if match else ""
    if unit_named(boxed) is not None or names_stretch(boxed, ""):
        return ""
    return "" if re.fullmatch(r"[-\s]*|1|[xyXY12]{1,2}", boxed) else boxed


def stem_of(column: str) -> str:
    """A column name without its unit, in lower case and without spaces: ``xforce``."""
    return re.sub(r"[\s_-]+", "", split_units(column)[0]).lower()


SCALED = re.compile(
    r"\^|\*\*|²|³|squared|[*×]\s*\d|(?<=[a-z)])\s*/\s*\d|(?<!\w)x\s?10+(?!\d)"
    r"|(?<!\d)1\s*/\s*\D|inverse|reciprocal|(?<![a-z])rate(?![a-z])",
    re.IGNORECASE,
)


def is_scaled(column: str) -> bool:
    """True if a name has a power, multiple, inverse or rate: ``lambda^2``, ``F*100``."""
    return SCALED.search(split_units(column)[0]) is not None


def words_of(column: str) -> list[str]:
    """Words of a column name in lower case, those of ``nominalStrain`` apart."""
    plain = unicodedata.normalize("NFKC", column)  # an italic letter is the letter
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", plain).lower()
    return [word for word in re.split(r"[^0-9a-zλστäöü]+", spaced) if word]


# --- stretches ------------------------------------------------------------------------------------

STRETCH = re.compile(
    r"\w*stretch\w*|[xy]?(lambda|lam)([xy12]{1,2})?|\w*λ\w*|f11|f22|fxx|fyy|lx|ly|lz"
)
STRAIN = re.compile(
    r"strain|dehnung|engineering|eng|nominal|technical|biot|green|true|hencky|log|logarithmic|ln"
    r"|almansi|e|e11|e22|exx|eyy"
)


def names_stretch(column: str, below: str) -> bool:
    """Whether a column's name, with the row below it, says a stretch and no kind of strain."""
    words = words_of(f"{column} {below}")
    return any(map(STRETCH.fullmatch, words)) and not any(map(STRAIN.fullmatch, words))


# --- a misspelt name ------------------------------------------------------------------------------


def likely_name(name: str, names: Iterable[str], cutoff: float = 0.75) -> tuple[str, str]:
    """The likely intended name and a hint with a trailing space; both empty if no name is near."""
    given = unit_of_column(name)
    for likely in difflib.get_close_matches(name[:60], names, n=3, cutoff=cutoff):
        known_unit = unit_of_column(likely)
        if given is not None and (known_unit is None or known_unit.quantity != given.quantity):
            continue
        scaled = ""
        if known_unit is not None and given is not None and known_unit != given:
            ratio = given.factor / known_unit.factor
            scaled = f" (values in {known_unit.name}: 1 {given.name} = {ratio:g} {known_unit.name})"
        elif known_unit is not None and given is None and stem_of(likely) != stem_of(name):
            scaled = f" (values in {known_unit.name})"
        return likely, f"did you mean {likely}{scaled}? "
    return "", ""
