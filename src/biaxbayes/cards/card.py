"""A material card: one draw, in one unit system, with what a reader of the file must know."""

from __future__ import annotations

import re
import textwrap
import unicodedata
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from biaxbayes.errors import InputError
from biaxbayes.laws.goh import GOH


class UnitSystem(NamedTuple):
    """Units that belong together: force = mass length / time^2, stress = force / length^2."""

    stress: str
    per_kPa: float  # number of the stress unit for 1 kPa
    description: str


UNIT_SYSTEMS = {
    "kPa-mm": UnitSystem("kPa", 1.0, "kPa-mm: stress kPa, length mm, force mN, mass kg, time s"),
    "MPa-mm": UnitSystem("MPa", 1e-3, "MPa-mm: stress MPa, length mm, force N, mass tonne, time s"),
    "Pa-m": UnitSystem("Pa", 1e3, "Pa-m: stress Pa, length m, force N, mass kg, time s"),
}
"""Consistent units of finite-element input."""
K2_FLOOR = 1e-9
"""Smallest exponent written. The programs divide by k2; at 1e-9 the stress differs from its
limit by less than k2 E^2, 1e-9 of itself while the fibre strain is below one."""

UNLOADED = "Reference state: the unloaded specimen; the mounting stretch is already taken out."
MOUNTED = (
    "WARNING: the run ignored the mounting stretch, so this material takes the mounted state, "
    "which was loaded, as its stress-free reference."
)
LINE = 96  # characters; both programs take more
MAX_LABEL = 56  # an Abaqus label may have 80, and suffixes follow
MAX_TEXT = 200


@dataclass(frozen=True)
class Card:
    """One material for a finite-element program."""

    label: str  # letters, digits and underscores
    material: Any  # as written: no exponent of GOH below K2_FLOOR
    units: UnitSystem
    bulk_kPa: float | None  # None for incompressible
    specimen: str = ""  # any text, as origin
    origin: str = ""
    # the mounting stretch was inferred, so that the material starts unloaded
    prestretch: bool = True
    notes: tuple[str, ...] = ()  # plain ASCII

    def stress(self, value_kPa: float) -> float:
        """A stress in the units of the card."""
        return value_kPa * self.units.per_kPa


def exportable(material: GOH) -> tuple[GOH, tuple[str, ...]]:
    """The material as the programs can take it, with notes; InputError if C1 is zero."""
    if not material.C1_kPa > 0.0:
        raise InputError(
            "C1 is zero: a material without matrix stiffness has no shear modulus",
            remedy="Abaqus and FEBio need C1 above zero; choose another draw",
        )
    kappa = min(material.kappa, 1.0 / 3.0)  # the programs allow no rounding beyond
    if material.k2 >= K2_FLOOR:
        return replace(material, kappa=kappa), ()
    note = (
        f"NOTE: k2 = {material.k2:g} is written as {K2_FLOOR:g}, because the energy divides by "
        "k2; the stress changes by less than k2 E^2 of itself."
    )
    return replace(material, k2=K2_FLOOR, kappa=kappa), (note,)


def safe_label(text: str) -> str:
    """A name that every file system and both programs accept, made from any text."""
    decomposed = unicodedata.normalize("NFKD", text)
    ascii_text = decomposed.encode("ascii", "ignore").decode()
    label = re.sub(r"[^A-Za-z0-9]+", "_", ascii_text)[:MAX_LABEL].strip("_")
    if not label:
        return "material"
    return label if label[0].isalpha() else f"M_{label}"[:MAX_LABEL]


def plain_text(text: str) -> str:
    """One line of printable ASCII; what is not becomes a question mark, and it ends somewhere."""
    decomposed = unicodedata.normalize("NFKD", text)
    plain = (ch for ch in decomposed if not unicodedata.combining(ch))
    line = "".join(ch if ch.isascii() and ch.isprintable() else "?" for ch in plain)
    line = " ".join(line.split())
    return line if len(line) <= MAX_TEXT else line[: MAX_TEXT - 3] + "..."


def header_lines(card: Card, version: str, conventions: list[str]) -> list[str]:
    """ASCII lines at the top of a card, at most 96 long; those that start with a blank stay."""
    paragraphs = [
        f"biaxbayes {version}: material card",
        f"Specimen: {plain_text(card.specimen)}",
        f"Material: {plain_text(card.origin)}",
        f"Units: {card.units.description}",
        UNLOADED if card.prestretch else MOUNTED,
        *conventions,
        "Density is not part of the fit: add it, in these units, where inertia or weight matter.",
        *card.notes,
    ]
    lines: list[str] = []
    for paragraph in paragraphs:
        stays = paragraph.startswith(" ")
        lines += [paragraph] if stays else textwrap.wrap(paragraph, LINE, subsequent_indent="  ")
    return lines
