"""Which column of a table is what, in which unit and which kind of strain; nothing is guessed."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from biaxbayes.errors import InputError
from biaxbayes.specimens.specimen import STRESS_PAIRS
from biaxbayes.tables.table import Table
from biaxbayes.tables.units import (
    STRAIN_CHOICES,
    STRAINS,
    UNITS,
    Unit,
    likely_name,
    share_in,
    stem_of,
    strain_kinds,
    unit_named,
    unit_of_column,
    units_of,
    unknown_unit,
)
from biaxbayes.text_files import cells_of

SHEAR = {"shear_xy": "f12", "shear_yx": "f21"}
TARGETS = {
    "stretch_x": "stretch",
    "stretch_y": "stretch",
    "force_x_N": "force",
    "force_y_N": "force",
    **dict.fromkeys((*STRESS_PAIRS["piola"], *STRESS_PAIRS["cauchy"]), "stress"),
    "time_s": "time",
    "protocol": "text",
    "cycle": "text",
    **dict.fromkeys(SHEAR, "shear"),
}
"""What can be mapped, and what kind of quantity it is."""
OPTIONAL = ("time_s", *SHEAR)
"""Taken where a column has their own name, and left out where that holds no numbers."""
LENGTH_WORDS = r"distance|length|size|gap|separation|abstand|l[äa]nge|laenge|gauge"
DISPLACEMENT_WORDS = (
    r"disp(lacement)?s?|extension|elongation|travel|stroke|crosshead|weg|verschiebung|change|delta"
)
STRESS_WORDS = {
    "piola": r"piola|pk1|p11|p22|pxx|pyy|first|1st|nominal|engineering|eng",
    "cauchy": r"cauchy|true",
    "second Piola-Kirchhoff": r"pk2|second|2nd|spk",
}


@dataclass(frozen=True)
class Column:
    """A column of the table with the unit that it is in (None for text)."""

    index: int
    name: str
    unit: Unit | None

    def __str__(self) -> str:
        return self.name if self.unit is None else f"{self.name} ({self.unit.name})"


def parse_columns(texts: Sequence[str]) -> dict[str, str]:
    """Columns by target, from texts of ``target=column[:unit]`` with commas between them.

    Commas inside a column's name need no quotation marks: a pair ends where ``,target=`` follows.

    Raises
    ------
    InputError
        For text that reads otherwise, an unknown target or one given twice.
    """
    wanted: dict[str, str] = {}
    for part in (part for text in texts for part in _pairs(text)):
        target, sign, column = (piece.strip() for piece in part.partition("="))
        if not sign or not column:
            raise InputError(
                f"`columns`: {part[:60]!r} does not read like stretch_x=F11",
                remedy="give target=column pairs, separated by commas",
            )
        if target not in TARGETS:
            likely, hint = likely_name(target, TARGETS, cutoff=0.7)
            unit = unit_of_column(target)
            if likely and unit is not None and unit != unit_of_column(likely):
                hint = f"write {likely}={column}:{unit.name}; "
            raise InputError(
                f"`columns`: unknown target {target[:60]!r}",
                remedy=f"{hint}targets are {', '.join(TARGETS)}",
            )
        if target in wanted:
            raise InputError(f"`columns`: {target} is given twice", remedy="keep one")
        wanted[target] = column
    return wanted


def _pairs(text: str) -> list[str]:
    if '"' in text:
        return cells_of(text)
    return [part for part in re.split(r",(?=\s*\w+\s*=)", text) if part.strip(" ,")]


def column_map(table: Table, wanted: Mapping[str, str]) -> dict[str, Column]:
    """Find the wanted columns of a table, and those that are called like a target.

    A target that is not wanted is looked for under its own name, in any unit (``force_x_mN``);
    shear under ``F12`` and ``F21``.

    Raises
    ------
    InputError
        For columns that are missing or ambiguous, or whose unit or kind is not clear.
    """
    loads_named = any(TARGETS[target] in ("force", "stress") for target in wanted)
    columns: dict[str, Column] = {}
    for target, quantity in TARGETS.items():
        given = None
        if target in wanted:
            index, given = _named(table, wanted[target])
        elif quantity in ("force", "stress") and loads_named:
            continue
        else:
            own = table.by_stem(stem_of(target))
            own = table.by_stem(SHEAR[target]) if own is None and target in SHEAR else own
            if own is None or (target in OPTIONAL and not table.is_numeric(own)):
                continue
            index = own
        unit = None if quantity == "text" else _unit(table, index, target, quantity, given)
        columns[target] = Column(index, table.names[index], unit)
    _check_complete(table, columns)
    return columns


def numeric_columns(columns: Mapping[str, Column]) -> list[int]:
    """Indices of the columns that hold numbers."""
    return [column.index for column in columns.values() if column.unit is not None]


def _named(table: Table, text: str) -> tuple[int, Unit | None]:
    """Column and unit from ``column`` or ``column:unit``."""
    name, colon, ending = text.rpartition(":")
    if not colon or text in table.names:
        return table.column(text), None
    unit = unit_named(ending)
    if unit is not None:
        return table.column(name), unit
    if name.strip() in map(str.strip, table.names):
        raise InputError(
            f"`columns`: {ending[:40]!r} behind {name[:40]!r} is no unit or kind of strain",
            file=table.path,
            column=name.strip(),
            remedy=f"choose one of {', '.join(UNITS)}",
        )
    return table.column(text), None


def _unit(table: Table, index: int, target: str, quantity: str, given: Unit | None) -> Unit:
    name = table.names[index]
    if quantity == "stretch":
        return _stretch_unit(table, index, target, given)
    if quantity == "stress":
        _check_kind_of_stress(table, name, target)
    unit = given or table.unit(index)
    if unit is None and quantity == "time":
        return UNITS["s"]
    if quantity == "shear":
        return UNITS["mm/mm"] if unit is None or unit.quantity != "fraction" else unit
    if unit is None or unit.quantity != quantity:
        problem = f"{name!r} does not say its unit"
        if unknown_unit(name):
            problem = f"{unknown_unit(name)!r} of {name!r} is no known unit"
        elif unit is not None:
            problem = f"{name!r} is in {unit.name}, a {unit.quantity}"
        raise InputError(
            f"{problem}, but {target} is a {quantity}",
            file=table.path,
            column=name,
            remedy=f"write {shlex.quote(f'{target}={name}:UNIT')} with the unit it is in, one of "
            f"{units_of(quantity)}; or choose another column; {table.listing}",
        )
    return unit


def _check_kind_of_stress(table: Table, name: str, target: str) -> None:
    """Refuse a stress whose name speaks of another kind than its target."""
    words = re.split(r"[^0-9a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())
    kinds = [
        k for k, pattern in STRESS_WORDS.items() if any(re.fullmatch(pattern, w) for w in words)
    ]
    pair = target.split("_")[0]
    if kinds and kinds != [pair]:
        axis = target.split("_")[1]
        raise InputError(
            f"{name!r} speaks of a {kinds[-1]} stress, but {target} is a {pair} stress",
            file=table.path,
            column=name,
            remedy="a second Piola-Kirchhoff stress times the stretch is a first one: compute it "
            "in the table"
            if kinds[-1] not in STRESS_PAIRS
            else f"map it to {kinds[-1]}_{axis}_kPa, or rename the column",
        )


def _stretch_unit(table: Table, index: int, target: str, given: Unit | None) -> Unit:
    """The kind of stretch, strain, length or displacement of a column; asks rather than guesses."""
    name = table.names[index]
    kinds, written = strain_kinds(name), table.unit(index)
    if written is not None and written.quantity in STRAINS and written.factor == 1.0:
        written = share_in(name) or written  # `E [%] (Green)`: the kind at the end, per cent before
    per_cent = written is not None and written.quantity == "fraction" and written.factor < 1.0
    if given is not None and given.name == "percent" and kinds <= {"engineering"}:
        return UNITS["engineering_percent"]
    if given is not None and given.quantity in STRAINS:
        # ':green' states the kind; per cent in the name is its scale.
        factor = written.factor if per_cent and written is not None else 1.0
        return Unit(given.name, given.quantity, min(given.factor, factor))
    if given is not None and given.quantity in ("length", "displacement"):
        return given
    if given is None and written is not None and written.quantity == "length":
        return _length_unit(table, index, target, written)
    if given is None and written is not None and written.quantity == "displacement":
        return written
    described = written is None or written.quantity == "fraction" or written.quantity in STRAINS
    if given is None and described and not unknown_unit(name) and len(kinds) == 1:
        (kind,) = kinds
        if not per_cent or written is None:
            return UNITS[kind]
        if kind != "stretch":
            return Unit(f"{kind}, {written.name}", kind, written.factor)
    state = f"it is not clear what kind of stretch or strain {name!r} is"
    if given is not None:
        state = f"{name!r} is given as {given.name}, which leaves its kind open"
    if given is not None and kinds:
        state += f" (its name says {' and '.join(sorted(kinds))})"
    raise InputError(
        state,
        file=table.path,
        column=name,
        remedy=f"write {shlex.quote(f'{target}={name}:KIND')} with its kind, one of "
        f"{STRAIN_CHOICES} (Green-Lagrange is green; true and Hencky are log), "
        f"{units_of('length', 'displacement')}",
    )


def _length_unit(table: Table, index: int, target: str, unit: Unit) -> Unit:
    """Whether a column in mm is the distance of grips or marks, or how far they have moved."""
    name = table.names[index]
    words = re.split(r"[^0-9a-zäöü]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())
    words += [re.sub(r"^[xy12]|[xy12]$", "", word) for word in words]
    moved, apart = (
        any(re.fullmatch(pattern, word) for word in words)
        for pattern in (DISPLACEMENT_WORDS, LENGTH_WORDS)
    )
    if moved and not apart:
        return UNITS[f"displacement_{unit.name}"]
    if apart and not moved:
        return unit
    texts = [shlex.quote(f"{target}={name}:{kind}{unit.name}") for kind in ("displacement_", "")]
    raise InputError(
        f"{name!r} may be a displacement or a length",
        file=table.path,
        column=name,
        remedy=f"write {texts[0]} for how far grips or marks have moved, {texts[1]} for the "
        "distance between them",
    )


def _check_complete(table: Table, columns: Mapping[str, Column]) -> None:
    """Refuse a map without both stretches and one pair of loads, with columns of this file."""
    pairs = [p for p, names in STRESS_PAIRS.items() if any(name in columns for name in names)]
    problem = ""
    if len(pairs) > 1:
        problem = "more than one stress pair"
    elif not pairs and "stretch_x" in columns and "stretch_y" in columns:
        problem = "no column for a force or stress"
    for target in ("stretch_x", "stretch_y", *STRESS_PAIRS[pairs[0] if pairs else "force"]):
        if not problem and target not in columns:
            problem = f"no column for {target}"
    if problem:
        raise InputError(problem, file=table.path, remedy=f"{table.listing}; {_example(table)}")
    used: dict[int, str] = {}
    for target, column in columns.items():
        if column.index in used:
            raise InputError(
                f"{column.name!r} is used for both {used[column.index]} and {target}",
                file=table.path,
                remedy=table.listing,
            )
        used[column.index] = target


def _example(table: Table) -> str:
    """A --columns option with columns that the file has, where enough of them are likely."""
    deformed: list[str] = []
    forces: list[str] = []
    stresses: list[str] = []
    for index, name in enumerate(table.names):
        unit = table.unit(index)
        quantity = "" if unit is None else unit.quantity
        if quantity in ("length", "displacement", *STRAINS) or strain_kinds(name):
            deformed.append(name)
        elif quantity in ("force", "stress"):
            (forces if quantity == "force" else stresses).append(name)
    loads = STRESS_PAIRS["force"] if len(forces) >= 2 else STRESS_PAIRS["piola"]
    values = [*deformed[:2], *(forces if len(forces) >= 2 else stresses)[:2]]
    if len(deformed) < 2 or len(values) < 4:
        values = ["COLUMN"] * 4
    pairs = zip(("stretch_x", "stretch_y", *loads), values, strict=True)
    text = ",".join(f"{target}={name}" for target, name in pairs)
    return f"for example --columns {shlex.quote(text)}"
