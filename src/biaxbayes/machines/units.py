"""Units that machines write behind their column names, and what they are in N, kPa, mm and s."""

from __future__ import annotations

import re
from dataclasses import dataclass

__all__ = ["UNITS", "Unit", "stem_of", "unit_named", "unit_of_column"]


@dataclass(frozen=True)
class Unit:
    """A unit: what it measures, and its size in the unit that this program keeps.

    Attributes
    ----------
    name : str
    quantity : {"force", "stress", "length", "displacement", "time", "stretch"}
    factor : float
        Of N, kPa, mm or s; one for the kinds of stretch.
    """

    name: str
    quantity: str
    factor: float


UNITS = {
    unit.name: unit
    for unit in (
        Unit("N", "force", 1.0),
        Unit("mN", "force", 1e-3),
        Unit("uN", "force", 1e-6),
        Unit("kN", "force", 1e3),
        Unit("gf", "force", 9.80665e-3),
        Unit("g", "force", 9.80665e-3),
        Unit("kgf", "force", 9.80665),
        Unit("Pa", "stress", 1e-3),
        Unit("kPa", "stress", 1.0),
        Unit("MPa", "stress", 1e3),
        Unit("mmHg", "stress", 0.133322387415),
        Unit("um", "length", 1e-3),
        Unit("mm", "length", 1.0),
        Unit("cm", "length", 10.0),
        Unit("displacement_um", "displacement", 1e-3),
        Unit("displacement_mm", "displacement", 1.0),
        Unit("px", "pixel", 1.0),
        Unit("s", "time", 1.0),
        Unit("ms", "time", 1e-3),
        Unit("min", "time", 60.0),
        Unit("stretch", "stretch", 1.0),
        Unit("engineering", "stretch", 1.0),
        Unit("green", "stretch", 1.0),
        Unit("percent", "stretch", 1.0),
    )
}
"""Units by name."""
ALIASES = {
    "µN": "uN",
    "μN": "uN",
    "µm": "um",
    "μm": "um",
    "sec": "s",
    "seconds": "s",
    "%": "percent",
    "eng": "engineering",
    "lambda": "stretch",
}
# Where the case is not kept: MPa and mPa would both become mpa, and only one of them is meant.
BY_LOWER_CASE = {name.lower(): unit for name, unit in UNITS.items()}
BY_LOWER_CASE.update({alias.lower(): UNITS[name] for alias, name in ALIASES.items()})

SUFFIX = re.compile(
    r"^(?P<stem>.*?)\s*(?:[\[(](?P<boxed>[^\])]*)[\])]|[_\s,/](?P<tail>[^\s_,/]+))\s*$"
)


def unit_named(text: str) -> Unit | None:
    """The unit of a name, None where there is no such unit."""
    text = text.strip()
    if text in UNITS:
        return UNITS[text]
    if text in ALIASES:
        return UNITS[ALIASES[text]]
    return None if text == "mPa" else BY_LOWER_CASE.get(text.lower())


def _split(column: str) -> tuple[str, Unit | None]:
    match = SUFFIX.match(column.strip())
    if match is None:
        return column.strip(), None
    unit = unit_named(match["boxed"] if match["boxed"] is not None else match["tail"])
    return (match["stem"], unit) if unit is not None else (column.strip(), None)


def unit_of_column(column: str) -> Unit | None:
    """The unit behind a column name: ``XForce_mN``, ``Force X [mN]``, ``Time (s)``.

    None where the name ends with none.
    """
    return _split(column)[1]


def stem_of(column: str) -> str:
    """A column name without its unit, in lower case and without spaces: ``xforce``."""
    return re.sub(r"[\s_-]+", "", _split(column)[0]).lower()
