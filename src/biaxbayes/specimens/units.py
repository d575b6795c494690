"""Units behind the names of columns and keys, and what a misspelt name was meant to be."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["UNITS", "Unit", "likely_name", "stem_of", "unit_named", "unit_of_column"]


# --- units of names, and what they are in N, kPa, mm and s ---------------------------------------


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
    "N/mm2": "MPa",
    "N/mm²": "MPa",
    "lambda": "stretch",
}
# Where the case is not kept: MPa and mPa would both become mpa, and only one of them is meant.
BY_LOWER_CASE = {name.lower(): unit for name, unit in UNITS.items()}
BY_LOWER_CASE.update({alias.lower(): UNITS[name] for alias, name in ALIASES.items()})

SUFFIX = re.compile(
    r"^(?P<stem>.*?)\s*(?:[\[(](?P<boxed>[^\])]*)[\])]|[_\s,/](?P<tail>N/mm[2²]|[^\s_,/]+))\s*$"
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


# --- a misspelt name -----------------------------------------------------------------------------


OF_KEYS = {
    unit.name: unit
    for unit in (Unit("m", "length", 1e3), Unit("deg", "angle", 1.0), Unit("rad", "angle", 57.2958))
}
"""Units that a key of a header may be given in by mistake, and no column of a machine ends with."""


def _ending(name: str) -> Unit | None:
    return unit_of_column(name) or OF_KEYS.get(name.rpartition("_")[2])


def likely_name(name: str, known: Iterable[str], cutoff: float = 0.75) -> tuple[str, str]:
    """The known name that an unknown one is likely meant to be, and a hint that says so.

    Parameters
    ----------
    name : str
    known : iterable of str
    cutoff : float
        Least likeness, as for :func:`difflib.get_close_matches`.

    Returns
    -------
    likely : str
        Empty where no name is near, or those near are of another quantity.
    hint : str
        Ends with a space; where the names differ in their unit it says how to scale the values.
    """
    given = _ending(name)
    for likely in difflib.get_close_matches(name[:60], known, n=3, cutoff=cutoff):
        kept = _ending(likely)
        if given is not None and (kept is None or kept.quantity != given.quantity):
            continue
        scaled = ""
        if kept is not None and given is not None and kept != given:
            ratio = given.factor / kept.factor
            scaled = f" (values in {kept.name}: 1 {given.name} = {ratio:g} {kept.name})"
        elif kept is not None and given is None and stem_of(likely) != stem_of(name):
            scaled = f" (values in {kept.name})"
        return likely, f"did you mean {likely}{scaled}? "
    return "", ""
