"""Any table of a biaxial test, by a map of its columns: ``stretch_x=F11,piola_x_kPa=P11_kPa``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.conversion import (
    Choice,
    Recording,
    chosen_number,
    cycle_label,
    gauge_note,
    take_branch,
)
from biaxbayes.machines.raw_table import RawTable
from biaxbayes.specimens.specimen import STRESS_PAIRS
from biaxbayes.specimens.units import (
    UNITS,
    Unit,
    likely_name,
    stem_of,
    unit_named,
    unit_of_column,
)
from biaxbayes.text_files import cells_of

__all__ = ["TARGETS", "Column", "column_map", "parse_columns", "recordings"]


# --- which raw column is what, with units converted ----------------------------------------------


SHEAR = {"shear_xy": "F12", "shear_yx": "F21"}
TARGETS = {
    "stretch_x": "stretch",
    "stretch_y": "stretch",
    "force_x_N": "force",
    "force_y_N": "force",
    **dict.fromkeys((*STRESS_PAIRS["piola"], *STRESS_PAIRS["cauchy"]), "stress"),
    "time_s": "time",
    "protocol": "text",
    "cycle": "text",
    **dict.fromkeys(SHEAR, "stretch"),
}
"""What can be mapped, and what kind of quantity it is."""
STRETCH_NAMES = re.compile(r"f11|f22|[xy12]?(lambda|lam(?![a-z])|stretch|λ)|lx|ly|lam[xy12]")
GREEN_NAMES = ("e11", "e22", "exx", "eyy", "green")


@dataclass(frozen=True)
class Column:
    """A raw column with the unit that it is in (None for text)."""

    index: int
    name: str
    unit: Unit | None

    def describe(self) -> str:
        """Name and unit, for the report."""
        return self.name if self.unit is None else f"{self.name} ({self.unit.name})"


def parse_columns(texts: Sequence[str]) -> dict[str, str]:
    """Targets and raw columns from ``target=column[:unit]`` texts, separated by commas.

    Raises
    ------
    InputError
        For text that reads otherwise, an unknown target or one given twice.
    """
    wanted: dict[str, str] = {}
    for text in texts:
        for part in cells_of(text):
            target, sign, column = (piece.strip() for piece in part.partition("="))
            if not sign or not column:
                raise InputError(
                    f"--columns: {part[:60]!r} does not read like stretch_x=F11",
                    remedy="give target=column pairs, separated by commas",
                )
            if target not in TARGETS:
                likely, hint = likely_name(target, TARGETS, cutoff=0.7)
                unit = unit_of_column(target)
                if likely and unit is not None and unit != unit_of_column(likely):
                    hint = f"write {likely}={column}:{unit.name}; "
                raise InputError(
                    f"--columns: unknown target {target[:60]!r}",
                    remedy=f"{hint}targets are {', '.join(TARGETS)}",
                )
            if target in wanted:
                raise InputError(f"--columns: {target} is given twice", remedy="keep one")
            wanted[target] = column
    return wanted


def column_map(table: RawTable, wanted: Mapping[str, str]) -> dict[str, Column]:
    """Find the wanted columns in a table, and those that speak for themselves.

    A target that is not named is looked for under its own name, in any unit (``force_x_mN``);
    shear under ``F12`` and ``F21``.

    Parameters
    ----------
    table : RawTable
    wanted : mapping
        From :func:`parse_columns`.

    Raises
    ------
    InputError
        For columns that are missing or ambiguous, or whose unit is not clear.
    """
    named = any(target.split("_")[0] in ("force", "piola", "cauchy") for target in wanted)
    found: dict[str, Column] = {}
    for target, quantity in TARGETS.items():
        index, stated = None, None
        if target in wanted:
            index, stated = _named(table, wanted[target])
        elif quantity not in ("force", "stress") or not named:
            index = table.by_stem(stem_of(target))
            if index is None and target in SHEAR:
                index = table.by_stem(SHEAR[target].lower())
        if index is not None:
            name = table.names[index]
            unit = None if quantity == "text" else _unit(table, index, target, quantity, stated)
            found[target] = Column(index, name, unit)
    _check_complete(table, found)
    return found


def _named(table: RawTable, text: str) -> tuple[int, Unit | None]:
    """Column and stated unit from ``column`` or ``column:unit``."""
    name, colon, ending = text.rpartition(":")
    unit = unit_named(ending) if colon else None
    if unit is not None and text not in table.names:
        return table.column(name), unit
    if colon and text not in table.names and name.strip() in map(str.strip, table.names):
        kinds = ", ".join(UNITS)
        raise InputError(
            f"--columns: {ending[:40]!r} behind {name[:40]!r} is no unit or kind of strain",
            file=table.path,
            column=name.strip(),
            remedy=f"choose one of {kinds}; convert other strains (logarithmic, Almansi) first",
        )
    return table.column(text), None


def _unit(table: RawTable, index: int, target: str, quantity: str, stated: Unit | None) -> Unit:
    name = table.names[index]
    unit = stated or table.unit(index)
    if quantity == "stretch":
        return _stretch_unit(table, index, target, unit)
    if quantity == "time" and unit is None:
        return Unit("s", "time", 1.0)
    if unit is None or unit.quantity != quantity:
        given = "does not say its unit" if unit is None else f"is in {unit.name}"
        example = {"force": "mN", "stress": "kPa", "time": "s"}[quantity]
        raise InputError(
            f"{name!r} {given}, but {target} is a {quantity}",
            file=table.path,
            column=name,
            remedy=f"write {target}={name}:{example}, or choose another column; {table.found}",
        )
    return unit


def _stretch_unit(table: RawTable, index: int, target: str, unit: Unit | None) -> Unit:
    """The kind of stretch or strain of a column; asks rather than guesses."""
    name = table.names[index]
    bare = stem_of(name)
    if unit is not None and unit.quantity in ("stretch", "displacement"):
        return unit
    if unit is not None and unit.quantity == "length":
        displaced = "disp" in bare
        first = table.numbers(index)[0]
        if not displaced and first <= 0.0:
            raise InputError(
                f"{name!r} starts at {first:g}, which is no length",
                file=table.path,
                column=name,
                remedy=f"for a displacement write {target}={name}:displacement_{unit.name}",
            )
        return Unit(unit.name, "displacement" if displaced else "length", unit.factor)
    if unit is None and target in SHEAR:
        return Unit("stretch", "stretch", 1.0)
    if unit is None and bare.startswith(GREEN_NAMES):
        return Unit("green", "stretch", 1.0)
    if unit is None and STRETCH_NAMES.match(bare):
        return Unit("stretch", "stretch", 1.0)
    raise InputError(
        f"it is not clear what kind of stretch or strain {name!r} is",
        file=table.path,
        column=name,
        remedy=f"write {target}={name}:stretch, :engineering, :green, :percent, :mm or "
        ":displacement_mm",
    )


def _check_complete(table: RawTable, found: Mapping[str, Column]) -> None:
    example = "--columns stretch_x=F11,stretch_y=F22,piola_x_kPa=P11,piola_y_kPa=P22"
    for target in ("stretch_x", "stretch_y"):
        if target not in found:
            raise InputError(
                f"no column for {target}", file=table.path, remedy=f"{table.found}; {example}"
            )
    pairs = [p for p, names in STRESS_PAIRS.items() if any(name in found for name in names)]
    if len(pairs) != 1:
        problem = "more than one stress pair" if pairs else "no column for a force or stress"
        raise InputError(problem, file=table.path, remedy=f"{table.found}; {example}")
    for target in STRESS_PAIRS[pairs[0]]:
        if target not in found:
            raise InputError(
                f"no column for {target}", file=table.path, remedy=f"{table.found}; {example}"
            )
    used: dict[int, str] = {}
    for target, column in found.items():
        if column.index in used:
            raise InputError(
                f"{column.name!r} is used for both {used[column.index]} and {target}",
                file=table.path,
                remedy=table.found,
            )
        used[column.index] = target


def stretch_of(values: np.ndarray, unit: Unit, edge_mm: float | None) -> np.ndarray:
    """Stretches from a column in any of the stretch units.

    Parameters
    ----------
    values : ndarray, shape (n,)
    unit : Unit
    edge_mm : float or None
        Edge along the column's direction, for displacements.

    Returns
    -------
    ndarray, shape (n,)
        NaN where a Green strain is below -1/2.
    """
    if unit.quantity == "length":
        return values / values[0]
    if unit.quantity == "displacement":
        assert edge_mm is not None
        return 1.0 + (values - values[0]) * unit.factor / edge_mm
    if unit.name == "green":
        # E = (lambda^2 - 1) / 2
        with np.errstate(invalid="ignore"):
            return np.sqrt(1.0 + 2.0 * values)
    if unit.name == "engineering":
        return 1.0 + values
    if unit.name == "percent":
        return 1.0 + values / 100.0
    return values


# --- recordings ----------------------------------------------------------------------------------


def recordings(
    table: RawTable, choice: Choice, edges_mm: tuple[float, float] | None = None
) -> list[Recording]:
    """Take the branch of a cycle from each protocol of a table.

    Parameters
    ----------
    table : RawTable
    choice : Choice
        Its columns are texts for :func:`parse_columns`. Its cycle is one of the mapped cycle
        column, else of the cycles that the curves themselves show.
    edges_mm : (float, float), optional
        For displacements.

    Returns
    -------
    list of Recording

    Raises
    ------
    InputError
        For columns, cells, cycles or branches that are not there or not clear.
    """
    columns = column_map(table, parse_columns(choice.columns))
    everything = np.arange(table.rows)
    if "protocol" not in columns:
        return [_recording(table, columns, "", everything, choice, edges_mm)]
    labels = np.array(table.text(columns["protocol"].index))
    return [
        _recording(table, columns, name, np.flatnonzero(labels == name), choice, edges_mm)
        for name in dict.fromkeys(labels.tolist())
    ]


def _recording(
    table: RawTable,
    columns: Mapping[str, Column],
    name: str,
    rows: np.ndarray,
    choice: Choice,
    edges_mm: tuple[float, float] | None,
) -> Recording:
    rows, label = _cycle_rows(table, columns, rows, choice.cycle)
    stretch = np.column_stack(
        [
            _stretch(table, columns[f"stretch_{axis}"], rows, edges_mm, k)
            for k, axis in enumerate("xy")
        ]
    )
    pair = next(p for p, names in STRESS_PAIRS.items() if names[0] in columns)
    load = np.column_stack([_scaled(table, columns[target], rows) for target in STRESS_PAIRS[pair]])
    taken, found_label = take_branch(
        stretch, load, choice.branch, "last" if "cycle" in columns else choice.cycle, table
    )
    timed = "time_s" in columns and choice.branch != "unloading"
    gradient = _gradient(table, columns, rows, stretch)
    return Recording(
        name=name,
        source=table.path.name + (f", protocol {name}" if name else ""),
        stretch=stretch[taken],
        load=load[taken],
        columns=(
            columns["stretch_x"].name,
            columns["stretch_y"].name,
            columns[STRESS_PAIRS[pair][0]].name,
            columns[STRESS_PAIRS[pair][1]].name,
        ),
        stress_pair=pair,
        time_s=_scaled(table, columns["time_s"], rows)[taken] if timed else None,
        gradient=None if gradient is None else gradient[taken],
        lines=table.lines[rows][taken],
        rows_in_file=rows.size,
        cycle=label or found_label,
        branch=choice.branch,
        notes=(
            *table.notes,
            ", ".join(f"{target} from {column.describe()}" for target, column in columns.items()),
            *_gauge_lengths(table, columns, rows, edges_mm),
        ),
    )


def _gauge_lengths(
    table: RawTable,
    columns: Mapping[str, Column],
    rows: np.ndarray,
    edges_mm: tuple[float, float] | None,
) -> list[str]:
    """What displacements and lengths were divided by, which the file does not say."""
    told = []
    for k, axis in enumerate("xy"):
        column = columns[f"stretch_{axis}"]
        assert column.unit is not None
        if column.unit.quantity == "displacement" and edges_mm is not None:
            told.append(gauge_note(axis, edges_mm[k]))
        elif column.unit.quantity == "length":
            first = float(table.numbers(column.index, rows[:1])[0])
            told.append(f"stretch {axis} is {column.name} over its first value, {first:g}")
    return told


def _cycle_rows(
    table: RawTable, columns: Mapping[str, Column], rows: np.ndarray, cycle: str
) -> tuple[np.ndarray, str | None]:
    """Rows of the wanted cycle where a column numbers them; else all rows."""
    if "cycle" not in columns:
        return rows, None
    numbers = np.array(table.text(columns["cycle"].index, rows))
    found = list(dict.fromkeys(numbers.tolist()))
    number = chosen_number(cycle, found, table)
    return rows[numbers == found[number]], cycle_label(found, number)


def _scaled(table: RawTable, column: Column, rows: np.ndarray) -> np.ndarray:
    assert column.unit is not None
    return table.numbers(column.index, rows) * column.unit.factor


def _stretch(
    table: RawTable,
    column: Column,
    rows: np.ndarray,
    edges_mm: tuple[float, float] | None,
    k: int,
) -> np.ndarray:
    assert column.unit is not None
    if column.unit.quantity == "displacement" and edges_mm is None:
        raise InputError(
            f"{column.name!r} is a displacement and needs the edges",
            file=table.path,
            column=column.name,
            remedy="give --edge-x-mm and --edge-y-mm",
        )
    values = table.numbers(column.index, rows)
    stretch = stretch_of(values, column.unit, None if edges_mm is None else edges_mm[k])
    bad = np.flatnonzero(~np.isfinite(stretch))
    if bad.size:
        raise InputError(
            f"{values[bad[0]]:g} is no {column.unit.name} strain",
            file=table.path,
            row=int(table.lines[rows[bad[0]]]),
            column=column.name,
            remedy="check the kind of strain that the column holds",
        )
    return stretch


def _gradient(
    table: RawTable, columns: Mapping[str, Column], rows: np.ndarray, stretch: np.ndarray
) -> np.ndarray | None:
    """Deformation gradient with the off-diagonal components that the table has."""
    if not any(target in columns for target in SHEAR):
        return None
    gradient = np.zeros((rows.size, 2, 2))
    gradient[:, 0, 0], gradient[:, 1, 1] = stretch.T
    for target, place in (("shear_xy", (0, 1)), ("shear_yx", (1, 0))):
        if target in columns:
            gradient[:, place[0], place[1]] = table.numbers(columns[target].index, rows)
    return gradient
