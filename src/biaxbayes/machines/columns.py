"""Columns of a table by their target, with unit and kind of strain; nothing is guessed."""

from __future__ import annotations

import contextlib
import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.keys import TUBE_COLUMNS, directions_of
from biaxbayes.specimens.specimen import STRESS_PAIRS
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import MISSING, Table
from biaxbayes.tables.units import (
    STRAIN_CHOICES,
    STRAINS,
    UNITS,
    Unit,
    is_scaled,
    likely_name,
    stem_of,
    strain_kinds,
    unit_named,
    unit_of_column,
    units_of,
    words_of,
)
from biaxbayes.text_files import cells_of, first_few, is_number

SHEAR = {"shear_xy": ("f12", "fxy"), "shear_yx": ("f21", "fyx")}
TARGETS = {
    "stretch_x": "stretch",
    "stretch_y": "stretch",
    "force_x_N": "force",
    "force_y_N": "force",
    **dict.fromkeys((*STRESS_PAIRS["piola"], *STRESS_PAIRS["cauchy"]), "stress"),
    "time_s": "time",
    "protocol": "text",
    "cycle": "text",
    "specimen": "text",
    **dict.fromkeys(SHEAR, "shear"),
    "pressure_kPa": "stress",
    "axial_force_N": "force",
    "outer_diameter_mm": "stretch",
    "length_mm": "stretch",
    "stretch_z": "stretch",
}
"""Targets of a column, and their quantity."""
OF_TUBES = STRESS_PAIRS["tube"]
OF_ALL_TESTS = ("stretch_x", "stretch_y", "time_s", "protocol", "cycle", "specimen")
PLAIN_UNITS = {"time": "s", "shear": "mm/mm"}
"""Units of a name without one, by quantity."""
LENGTHS = ("length", "displacement")
PIXELS = "px"
IGNORE = "ignore"
"""Target of columns that mean nothing here."""
OPTIONAL = ("time_s", *SHEAR)
"""Targets that are mapped automatically if a single column of numbers has their name and a unit."""
LENGTH_WORDS = (
    r"distance|length|size|gap|separation|abstand|l[äa]nge|laenge|gauge|width|breite|diameter|od"
    r"|durchmesser"
)
DISPLACEMENT_WORDS = (
    r"disp(lacement)?s?|extension|elongation|travel|stroke|crosshead|weg|verschiebung|change|delta"
)
STRESSES = {
    "piola": (
        "a first Piola-Kirchhoff stress",
        r"piola|pk1|p11|p22|pxx|pyy|first|1st|nominal|engineering|eng",
    ),
    "cauchy": ("a Cauchy stress", r"cauchy|true|(sigma|σ)[xy12]{0,2}|t[xy12]{1,2}"),
    "pk2": (
        "a second Piola-Kirchhoff stress",
        r"pk2|2pk|pkii|kirchhoffii|second|2nd|spk|s[xy12]{1,2}",
    ),
    "kirchhoff": ("a Kirchhoff (or shear) stress", r"(tau|τ)[xy12]{0,2}"),
    "tension": ("a membrane tension", r"t[xy12]{1,2}"),
}
"""Kinds of stress, and the words of a name that suggest one; T11 may be two kinds."""


@dataclass(frozen=True)
class Column:
    """A column of the table with its unit (None for text), or a sum of several."""

    indices: tuple[int, ...]
    name: str
    unit: Unit | None
    conflict: str = ""  # how the unit that the user gives differs from the column's
    signs: tuple[int, ...] = (1,)  # of the columns in the sum

    def __str__(self) -> str:
        return self.name if self.unit is None else f"{self.name} ({self.unit.name})"


def parse_columns(texts: Sequence[str]) -> dict[str, str]:
    """Columns by target from ``target=column[:unit],...``; a column name may contain commas.

    A later text replaces the targets of an earlier one, as the answer to a question does.
    """
    wanted: dict[str, str] = {}
    for text in texts:
        here: set[str] = set()
        pairs = cells_of(text) if '"' in text else re.split(r",(?=\s*\w+\s*=)", text)
        for pair in (pair for pair in pairs if '"' in text or pair.strip(" ,")):
            target, sign, column = (piece.strip() for piece in pair.partition("="))
            if not sign or not column:
                raise InputError(
                    f"`columns`: {pair[:60]!r} is not of the form stretch_x=F11",
                    remedy="give target=column pairs, separated by commas",
                )
            if target not in (*TARGETS, IGNORE):
                likely, hint = likely_name(target, TARGETS, cutoff=0.7)
                unit = unit_of_column(target)
                if likely and unit is not None and unit != unit_of_column(likely):
                    hint = f"write {likely}={column}:{unit.name}; "
                raise InputError(
                    f"`columns`: unknown target {target[:60]!r}",
                    remedy=f"{hint}targets are {', '.join(TARGETS)}",
                )
            if target in here and target != IGNORE:
                raise InputError(f"`columns`: {target} is given twice", remedy="keep one")
            here.add(target)
            more = f"{wanted[IGNORE]}\n" if target == IGNORE and IGNORE in wanted else ""
            wanted[target] = more + column
    return wanted


def _targets_of(test: str | None) -> list[str]:
    """Targets of the columns of a kind of test."""
    if test == "tube":
        return [*OF_ALL_TESTS, *OF_TUBES, *(name for name in TUBE_COLUMNS if name in TARGETS)]
    directions = directions_of(test)
    loads = [name for pair, names in STRESS_PAIRS.items() if pair != "tube" for name in names]
    read = [name for name in loads if name.split("_")[1] in directions]
    return [*OF_ALL_TESTS, *read, *(SHEAR if directions == "xy" else ())]


def column_map(
    table: Table, wanted: Mapping[str, str], test: str | None = None
) -> tuple[dict[str, Column], frozenset[int]]:
    """The requested columns of a table and others named as a target, and those to ignore.

    ``test`` is the kind of test as a specimen file names it; where it is not stated, a biaxial one,
    and columns of another kind are asked about.
    """
    targets = _targets_of(test)
    for target in wanted:
        if test is None and target in _targets_of("tube") and target not in targets:
            raise Question(f"{target} is read from a tube", {"test=tube": ""}, file=table.path)
        if target not in (*targets, IGNORE):
            raise table.error(
                f"`columns`: {target} is not read from a {test or 'biaxial'} test",
                f"leave it out, or give another `test`; it reads {', '.join(targets)}",
            )
    loads_named = test != "tube" and any(TARGETS.get(t) in ("force", "stress") for t in wanted)
    ignored = {table.column(name) for name in wanted.get(IGNORE, "").split("\n") if name}
    columns: dict[str, Column] = {}
    for target in (target for target in TARGETS if target in targets):
        if target in wanted:
            columns[target] = _requested(table, target, wanted[target])
        elif not (loads_named and TARGETS[target] in ("force", "stress")):
            index = _by_name(table, target)
            if index is not None and index not in ignored:
                with contextlib.suppress(*[InputError] * (target in OPTIONAL)):
                    columns[target] = _column(table, target, (index,))
    for name, (standard, _) in TUBE_COLUMNS.items():
        if name not in columns:
            continue
        own = columns.pop(name)
        # a column that was requested for the standard one may be found by its name as well
        if standard in columns and (name in wanted or own.indices != columns[standard].indices):
            remedy = f"keep one, and write --columns {IGNORE}=COLUMN for the other"
            names = f"{columns[standard].name!r} and {own.name!r}"
            raise table.error(f"{names} both give {standard}", remedy)
        columns.setdefault(standard, own)
    _check_complete(table, columns, test)
    return columns, frozenset(ignored)


def _requested(table: Table, target: str, text: str) -> Column:
    """The column of ``column``, ``column:unit``, ``#3``, ``A+B`` or, confirmed, ``S11:piola``."""
    pair = target.partition("_")[0]
    confirmed = TARGETS[target] == "stress" and text.endswith(f":{pair}")
    text = text.removesuffix(f":{pair}") if confirmed else text
    name, colon, ending = text.rpartition(":")
    given = None if text in table.names or not colon else unit_named(ending)
    name = text if given is None else name
    parts, signs = [name], [1]
    if TARGETS[target] == "stretch" and not table.has_column(name):
        ends = re.split(r"([+-])", name)
        if all(map(table.has_column, ends[::2])):
            parts, signs = ends[::2], [1, *(1 if sign == "+" else -1 for sign in ends[1::2])]
    indices = tuple(map(table.column, parts))
    if TARGETS[target] == "stress" and target not in OF_TUBES and not confirmed:
        _check_kind_of_stress(table, table.names[indices[0]], target)
    return _column(table, target, indices, tuple(signs), given)


def _by_name(table: Table, target: str) -> int | None:
    """The column that is named as a target, in any unit."""
    if target not in OPTIONAL:
        return table.by_stem(stem_of(target))
    stems = (stem_of(target), *SHEAR.get(target, ()))
    same = [i for i, name in enumerate(table.names) if stem_of(name) in stems]
    numeric = len(same) == 1 and np.isfinite(table.sparse_numbers(same[0], texts=True)).all()
    return same[0] if numeric else None


def _column(
    table: Table,
    target: str,
    indices: tuple[int, ...],
    signs: tuple[int, ...] = (1,),
    given: Unit | None = None,
) -> Column:
    """A column, or the sum of several, with its unit."""
    named = zip(signs, indices, strict=True)
    name = "".join(f"{' + ' if k > 0 else ' - '}{table.names[i]}" for k, i in named)[3:]
    if TARGETS[target] == "text":
        return Column(indices, name, None)
    find = _stretch_unit if TARGETS[target] == "stretch" else _unit
    unit, *others = {find(table, index, target, given) for index in indices}
    if others or (len(indices) > 1 and unit.quantity not in LENGTHS):
        remedy = "only displacements or positions of opposite ends, in one unit, are added"
        raise table.error(f"{name!r} cannot be added for {target}", remedy)
    conflicts = [_conflict(table, index, target, given) for index in indices if given]
    return Column(indices, name, unit, next(filter(None, conflicts), ""), signs)


def _conflict(table: Table, index: int, target: str, given: Unit) -> str:
    """How the unit that the user gives differs from that of the column."""
    written = [u for u in table.units(index) if u.quantity == given.quantity]
    suggested = [u.name for u in written] if any(u.factor != given.factor for u in written) else []
    if given.quantity in STRAINS and not suggested:
        suggested = sorted(_kinds(table, index) - {given.quantity})
    name = table.names[index]
    text = f"{target} is read as {given.name}, as given; {name!r} suggests "
    return text + " and ".join(suggested) if suggested else ""


def _as(table: Table, index: int, target: str, unit: str) -> str:
    """A column with a unit, as the user would give it."""
    return shlex.quote(f"{target}={table.names[index]}:{unit}")


def _unit(table: Table, index: int, target: str, given: Unit | None) -> Unit:
    """The unit of a force, stress, time or shear."""
    name, quantity = table.names[index], TARGETS[target]
    unit, unknown = given or table.unit(index), table.unknown_unit(index)
    if unit is None and not unknown and quantity in PLAIN_UNITS:
        return UNITS[PLAIN_UNITS[quantity]]
    needed = "fraction" if quantity == "shear" else quantity
    if unit is None or unit.quantity != needed:
        problem = f"{unknown!r} of {name!r} is not a known unit"
        problem = problem if unknown else f"the unit of {name!r} is not known"
        if unit is not None:
            problem = f"{name!r} is in {unit.name}, a unit of {unit.quantity}"
        remedy = f"write {_as(table, index, target, 'UNIT')} with the unit it is in, one of "
        remedy += f"{units_of(needed)}; or choose another column; {table.listing}"
        raise table.error(f"{problem}, but {target} is a {quantity}", remedy, column=index)
    if given is None:
        _check_not_scaled(table, index, target, unit.name)
    return unit


def _check_not_scaled(table: Table, index: int, target: str, unit: str) -> None:
    name = table.names[index]
    if is_scaled(name):
        problem = f"the name {name!r} suggests a multiple, a power, an inverse or a rate"
        remedy = f"write {_as(table, index, target, unit)} if the values are plain ones; otherwise "
        raise table.error(problem, f"{remedy}compute plain values in the table", column=index)


def _check_kind_of_stress(table: Table, name: str, target: str) -> None:
    """Refuse a stress whose name suggests another kind than its target."""
    words = words_of(name)
    words += [first + second for first, second in pairwise(words)]
    kinds = {
        k: kind
        for k, (kind, pattern) in STRESSES.items()
        if any(re.fullmatch(pattern, word) for word in words)
    }
    pair, axis, _ = target.split("_")
    own = STRESSES[pair][0]
    if not kinds or [*kinds] == [pair]:
        return
    gives = {f"columns={target}={name}:{pair}": f"it is {own}"}
    for k in (k for k in kinds if k in STRESS_PAIRS and k != pair):
        gives[f"columns={k}_{axis}_kPa={name}"] = f"it is {kinds[k]}"
    gives[f"columns={target}=COLUMN"] = (
        "another column; a second Piola-Kirchhoff stress times the stretch is a first one"
    )
    problem = f"the name {name!r} suggests {' or '.join(kinds.values())}, and {target} is {own}"
    raise Question(problem, gives, file=table.path)


def _kinds(table: Table, index: int) -> set[str]:
    """Kinds of strain that the name of a column and the row of units give."""
    return strain_kinds(table.names[index]) | strain_kinds(table.below(index))


def _stretch_unit(table: Table, index: int, target: str, given: Unit | None) -> Unit:
    """The kind of stretch, strain, length or displacement of a column; refuses an open one."""
    name, kinds, units = table.names[index], _kinds(table, index), table.units(index)
    per_cent = next((u for u in units if u.quantity == "fraction" and u.factor < 1.0), None)
    if given is not None:
        if given.name == "percent" and kinds <= {"engineering"}:
            return UNITS["engineering_percent"]
        if given.quantity in STRAINS:
            # ':green' is the kind; per cent in the name is its scale.
            factor = per_cent.factor if per_cent else 1.0
            return Unit(given.name, given.quantity, min(given.factor, factor))
        if given.quantity in LENGTHS:
            return given
        problem = f"{name!r} is given as {given.name}, which leaves its kind open"
        problem += f" (its name suggests {' and '.join(sorted(kinds))})" if kinds else ""
    else:
        table.unit(index)  # refuses two units
        length = next((u for u in units if u.quantity in LENGTHS), None)
        if length is not None:
            _check_not_scaled(table, index, target, length.name)
            return _length_unit(table, index, target, length)
        plain = all(u.quantity == "fraction" or u.quantity in STRAINS for u in units)
        if plain and not table.unknown_unit(index) and len(kinds) == 1:
            (kind,) = kinds
            _check_not_scaled(table, index, target, kind)
            if per_cent is None:
                return UNITS[kind]
            if kind != "stretch":
                return Unit(f"{kind}, {per_cent.name}", kind, per_cent.factor)
        problem = f"it is not clear what kind of stretch or strain {name!r} is"
    remedy = f"write {_as(table, index, target, 'KIND')} with its kind, one of {STRAIN_CHOICES} "
    remedy += f"(Green-Lagrange is green; true and Hencky are log), {units_of(*LENGTHS)}"
    raise table.error(problem, remedy, column=index)


def _length_unit(table: Table, index: int, target: str, unit: Unit) -> Unit:
    """Unit of a column in mm: distance of grips or marks, or their displacement."""
    if unit.quantity == "displacement":
        return unit
    words = words_of(table.names[index])
    words += [re.sub(r"^[xy12]|[xy12]$", "", word) for word in words]
    moved, apart = (
        any(re.fullmatch(pattern, word) for word in words)
        for pattern in (DISPLACEMENT_WORDS, LENGTH_WORDS)
    )
    if moved and not apart and unit.name != PIXELS:
        return UNITS[f"displacement_{unit.name}"]
    if apart and not moved:
        return unit
    distance = f"{_as(table, index, target, unit.name)} for the distance between"
    remedy = f"write {_as(table, index, target, f'displacement_{unit.name}')} for how far grips or "
    remedy += f"marks have moved, {distance} them"
    if unit.name == PIXELS:
        remedy = f"write {distance} marks; a displacement needs the distance in pixels, too: "
        remedy += "compute the stretch in the table"
    problem = f"{table.names[index]!r} may be a displacement or a length"
    raise table.error(problem, remedy, column=index)


def _check_complete(table: Table, columns: Mapping[str, Column], test: str | None) -> None:
    """Refuse a map without the stretches and one pair of loads; ask where another test fits."""
    pairs = [p for p, names in STRESS_PAIRS.items() if any(name in columns for name in names)]
    if len(pairs) > 1:
        raise table.error("more than one stress pair", f"map one of them; {table.listing}")
    pair = pairs[0] if pairs else "tube" if test == "tube" else "force"
    needed = ["stretch_x", "stretch_y", "pressure_kPa"]
    if pair != "tube":
        both = ("stretch_x", "stretch_y", *STRESS_PAIRS[pair])
        needed = [name for name in both if name.split("_")[1] in directions_of(test)]
    missing = [target for target in needed if target not in columns]
    if missing:
        _ask_about_test(table, columns, missing, test)
        load = not pairs and not missing[0].startswith("stretch")
        problem = f"no column for {'a force or stress' if load else missing[0]}"
        raise table.error(problem, f"{table.listing}; {_example(table, needed)}")
    used: dict[int, str] = {}
    for target, column in columns.items():
        for index in column.indices:
            if (first := used.setdefault(index, target)) != target:
                problem = f"{column.name!r} is used for both {first} and {target}"
                raise table.error(problem, table.listing)


def _ask_about_test(
    table: Table, columns: Mapping[str, Column], missing: Sequence[str], test: str | None
) -> None:
    """Ask whether a table without a direction is of a strip, and one with a pressure of a tube."""
    others = {f"columns={','.join(f'{target}=COLUMN' for target in missing)}": "other columns"}
    for axis, across in ("xy", "yx"):
        along = [target for target in columns if f"_{axis}" in target and target not in SHEAR]
        lost = [target for target in missing if f"_{across}" in target]
        if test is None and len(along) == 2 and lost == list(missing):
            gives = {f"test=strip {axis}": f"a strip pulled along {axis}, whose sides are free"}
            problem = f"no column for {' and '.join(missing)}"
            raise Question(problem, gives | others, file=table.path)
    if test is None and any(stem_of(name) == "pressure" for name in table.names):
        gives = {"test=tube": "a tube under pressure"}
        raise Question("there is a pressure, as of a tube", gives | others, file=table.path)


def _example(table: Table, needed: Sequence[str]) -> str:
    """A --columns option with likely columns of the file."""
    likely: dict[str, list[str]] = {}
    for index, name in enumerate(table.names):
        quantity = next((u.quantity for u in table.units(index)), "")
        if quantity in (*LENGTHS, *STRAINS) or strain_kinds(name):
            quantity = "stretch"
        likely.setdefault(quantity, []).append(name)
    if "force" not in likely and "stress" in likely:
        needed = [target.replace("force", "piola").replace("_N", "_kPa") for target in needed]
    names = [(likely.get(TARGETS[target]) or ["COLUMN"]).pop(0) for target in needed]
    pairs = ",".join(f"{target}={name}" for target, name in zip(needed, names, strict=True))
    return f"for example --columns {shlex.quote(pairs)}"


# --- columns that nobody mapped -------------------------------------------------------------------

LEAST_LABELS = 2
MAX_LABELS = 60
LEAST_ROWS_OF_LABEL = 3


def _unused(table: Table, columns: Mapping[str, Column], ignored: frozenset[int]) -> list[int]:
    """Columns of the table that were neither mapped nor to be ignored."""
    used = {i for column in columns.values() for i in column.indices} | ignored
    return [i for i in range(len(table.names)) if i not in used]


def ask_about_labels(table: Table, columns: Mapping[str, Column], ignored: frozenset[int]) -> None:
    """Ask what a column separates that has the same few labels in many rows."""
    for index in _unused(table, columns, ignored):
        name, cells = table.names[index], table.text(index)
        labels = [cell for cell in cells if cell.lower() not in MISSING]
        counts = Counter(labels)
        numbers = all(map(is_number, counts))
        whole = all(re.fullmatch(r"\d+(\.0*)?", label) for label in counts)
        reading = any(u.quantity not in ("fraction", *STRAINS) for u in table.units(index))
        few = LEAST_LABELS <= len(counts) <= MAX_LABELS
        merged = 2 * len(labels) < table.rows
        # numbers may be readings, such as a coarse temperature; words may alternate
        changes = sum(a != b for a, b in pairwise(labels)) + 1 if numbers else len(counts)
        often = changes * LEAST_ROWS_OF_LABEL > (table.rows if merged else len(labels))
        if not few or (numbers and not whole) or reading or often or (merged and not cells[0]):
            continue
        shown = first_few([f"{label}: {count} rows" for label, count in counts.items()], 6)
        gives = {f"specimen_by={name}": "each a specimen"} if "specimen" not in columns else {}
        for target in ("protocol", "cycle"):
            if target not in columns:
                gives[f"columns={target}={name}"] = f"each a {target}"
        raise Question(
            f"column {name!r} has {len(counts)} labels ({shown}), and nothing says what they "
            "separate",
            gives | {f"columns={IGNORE}={name}": "nothing"},
            file=table.path,
        )


def ask_about_opposites(
    table: Table, columns: Mapping[str, Column], ignored: frozenset[int]
) -> None:
    """Ask for the other actuator of a direction where further lengths move with a displacement."""
    lengths = {
        table.names[i]: table.sparse_numbers(i, texts=True)
        for i in _unused(table, columns, ignored)
        if any(u.quantity in LENGTHS for u in table.units(i))
    }
    for target, column in columns.items():
        kind = column.unit
        if kind is None or kind.quantity != "displacement" or len(column.indices) > 1:
            continue
        moved, others = table.sparse_numbers(column.indices[0], texts=True), {}
        for name, values in lengths.items():
            both = np.isfinite(moved) & np.isfinite(values)
            extent = np.ptp(moved[both]) if both.sum() > 2 else 0.0
            if extent and 0.5 * extent < np.ptp(values[both]) < 2.0 * extent:
                sign = np.corrcoef(moved[both], values[both])[0, 1]
                others[name] = "+" if sign > 0.0 else "-"
        if others:
            gives = {
                f"columns={target}={column.name}{sign}{name}:{kind.name}": "both ends move"
                for name, sign in others.items()
            }
            ignore = ",".join(f"{IGNORE}={name}" for name in others)
            gives[f"columns={ignore}"] = "the other end is fixed, or they are of other parts"
            raise Question(
                f"{' and '.join(map(repr, others))} may be the displacement of the other end of "
                f"{column.name!r}; where both ends move, one of them is half of the stretch",
                gives,
                file=table.path,
            )
