"""Any table of a test, by a map of its columns: ``stretch_x=F11,piola_x_kPa=P11_kPa``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from biaxbayes.machines.choice import Choice
from biaxbayes.machines.columns import (
    SHEAR,
    Column,
    ask_about_labels,
    ask_about_opposites,
    column_map,
    parse_columns,
)
from biaxbayes.machines.cycles import Cycle, cut, quieter_path
from biaxbayes.machines.gauge import Gauge
from biaxbayes.machines.lines import outside
from biaxbayes.machines.readings import (
    ask_about_falls_of_one,
    ask_about_jumps,
    ask_about_steps,
    check_signs,
)
from biaxbayes.machines.record import Record
from biaxbayes.specimens.keys import directions_of
from biaxbayes.specimens.specimen import STRESS_PAIRS
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import Table
from biaxbayes.tables.units import STRAINS, Unit

INFLATES = 0.5
"""Change of a pressure over its largest value, from which a tube is inflated."""
PER_CENT_RANGE = 0.01
"""Strains in a column of per cent within this range are fractions, as spreadsheets store them."""


def records(table: Table, choice: Choice, gauge: Gauge) -> list[Record]:
    """The record of a table, with the cycles of each of its protocols."""
    wanted = parse_columns(choice.columns)
    by = {"specimen": choice.specimen_by, "protocol": choice.separating_column}
    wanted |= {target: column for target, column in by.items() if column is not None}
    columns, ignored = column_map(table, wanted, choice.test)
    ask_about_labels(table, columns, ignored)
    ask_about_opposites(table, columns, ignored)
    reasons = _left_out(table, columns, choice)
    rows = np.flatnonzero(reasons == "")
    record = _converted(table, columns, rows, reasons, choice, gauge)
    labels = {
        target: np.array(table.labels(columns[target].indices[0], choice.fill_labels))
        for target in ("protocol", "cycle")
        if target in columns
    }
    protocols = labels.get("protocol", np.full(table.rows, ""))
    for name in dict.fromkeys(protocols[rows].tolist()):
        of_protocol = rows[protocols[rows] == name]
        if choice.rows is None:
            ask_about_jumps(record, of_protocol)
            ask_about_steps(record, of_protocol)
        check_signs(record, of_protocol)
        record.cycles[name] = _cycles(record, of_protocol, labels.get("cycle"), table)
        if choice.rows is None:
            ask_about_falls_of_one(record, of_protocol, record.cycles[name])
    return [record]


def recognises(table: Table, choice: Choice) -> bool:
    """True if a sheet has any column of the map."""
    wanted = parse_columns(choice.columns).values()
    names = [name for text in wanted for name in (text, text.rpartition(":")[0])]
    return not choice.columns or any(table.has_column(name) for name in names)


def _left_out(table: Table, columns: Mapping[str, Column], choice: Choice) -> np.ndarray:
    """Why each row is left out before anything is converted: specimen, lines, missing readings."""
    reasons = outside(table.lines, choice.rows, table.path)
    reasons[table.hidden] = "hidden"
    if "specimen" in columns:
        labels = np.array(table.labels(columns["specimen"].indices[0], choice.fill_labels))
        counts = Counter(labels.tolist())
        if choice.specimen not in counts and len(counts) > 1:
            gives = {f"specimen={name}": f"{count} rows" for name, count in counts.items()}
            raise Question("holds several specimens", gives, file=table.path)
        if len(counts) > 1:
            reasons[(labels != choice.specimen) & (reasons == "")] = "another specimen"
    lacking = table.lacking(
        [
            index
            for column in columns.values()
            if column.unit is not None
            for index in column.indices
        ],
        np.flatnonzero(reasons == ""),
        drop=choice.drop_missing,
        remedy="leave such rows out with `drop_missing=True`",
    )
    reasons[lacking] = "a reading is missing"
    return reasons


def _cycles(
    record: Record, rows: np.ndarray, labels: np.ndarray | None, table: Table
) -> list[Cycle]:
    """Cycles of a protocol, by the labels of a column, otherwise from the curves."""
    path = np.full(table.rows, np.nan)
    path[rows] = quieter_path(*(curves[rows] for curves in record.pulled))
    groups = {"": rows}
    if labels is not None:
        groups = {str(k): rows[labels[rows] == k] for k in dict.fromkeys(labels[rows].tolist())}
    cycles = []
    for label, of_label in groups.items():
        found = cut(path[of_label], label)[-1 if labels is not None else 0 :]
        cycles += [
            Cycle(c.label, of_label[c.loading], of_label[c.hold], of_label[c.unloading])
            for c in found
        ]
    if not cycles:
        problem = "the record never rises over five rows: no loading branch"
        raise table.error(problem, f"check the columns; {table.listing}")
    return cycles


def _converted(
    table: Table,
    columns: Mapping[str, Column],
    rows: np.ndarray,
    reasons: np.ndarray,
    choice: Choice,
    gauge: Gauge,
) -> Record:
    """The table with stretches and loads from their columns; rows left out as far as they can."""
    values = {
        target: np.dot(column.signs, [table.values(i, rows) for i in column.indices])
        * column.unit.factor
        for target, column in columns.items()
        if column.unit is not None
    }
    pair = next(p for p, names in STRESS_PAIRS.items() if set(names) & set(columns))
    nothing = np.zeros(table.rows)
    load = np.column_stack([values.get(target, nothing) for target in STRESS_PAIRS[pair]])
    stretch, notes = _stretches(table, columns, values, rows, gauge)
    gradient = None
    if any(target in columns for target in SHEAR):
        gradient = stretch[:, :, None] * np.eye(2)
        for target, (i, j) in (("shear_xy", (0, 1)), ("shear_yx", (1, 0))):
            gradient[:, i, j] = values.get(target, 0.0)
        if all(target in columns for target in SHEAR):
            # the stretch of a line along x is |F e_x|: a rotation of the specimen leaves it
            stretch = np.sqrt((gradient**2).sum(axis=1))
    axes = tuple("xy".index(axis) for axis in directions_of(choice.test))
    if choice.test == "tube":
        # at constant pressure a tube is pulled along its axis
        pressure = load[rows, 0]
        axes = (0,) if np.ptp(pressure) > INFLATES * np.abs(pressure).max() else (1,)
    targets = ("stretch_x", "stretch_y", *STRESS_PAIRS[pair])
    read = ", ".join(f"{target} from {column}" for target, column in columns.items())
    conflicts = [column.conflict for column in columns.values() if column.conflict]
    return Record(
        name="",
        path=table.path,
        lines=table.lines,
        stretch=stretch,
        load=load * choice.signs,
        time_s=values.get("time_s"),
        gradient=gradient,
        columns=tuple(columns[t].name if t in columns else "" for t in targets),
        stress_pair=pair,
        cycles={},
        reasons=reasons,
        notes=(*table.notes, read),
        assumptions=(*conflicts, *notes, *choice.sign_notes),
        axes=axes,
    )


def _stretches(
    table: Table,
    columns: Mapping[str, Column],
    values: Mapping[str, np.ndarray],
    rows: np.ndarray,
    gauge: Gauge,
) -> tuple[np.ndarray, list[str]]:
    """Stretches in x and y from strains, displacements or distances, and notes on them."""
    stretch, notes, in_per_cent = np.ones((table.rows, 2)), [], []
    for k, axis in enumerate("xy"):
        column = columns.get(f"stretch_{axis}")
        if column is None or column.unit is None:  # across a strip
            continue
        along, unit = values[f"stretch_{axis}"], column.unit
        first = float(along[rows[0]])
        if unit.quantity in STRAINS:
            (index,) = column.indices
            stretch[:, k] = _stretch_from_strain(table, index, unit, along, rows, gauge)
            if unit.factor < 1.0 and "percent" in (u.name for u in table.units(index)):
                in_per_cent.append((index, float(np.ptp(stretch[rows, k]))))
            continue
        if unit.name == "px" and not gauge.is_of_tube:
            stretch[:, k] = along / first
            note = f"stretch {axis} is {column.name} over its first value, {first:g} px"
        else:
            displaced = unit.quantity == "displacement"
            convert = gauge.from_displacement if displaced else gauge.from_distance
            stretch[:, k], note = convert(along, first, k, column.name, table.path)
        notes.append(note)
    if in_per_cent and max(extent for _, extent in in_per_cent) <= PER_CENT_RANGE:
        index, extent = in_per_cent[0]
        raise table.error(
            f"{table.names[index]!r} changes by {extent:.2%} only if it is in per cent",
            "spreadsheets store 20 % as 0.2: rename the columns without the per cent sign, or "
            "multiply the values by 100",
            column=index,
        )
    return stretch, notes


def _stretch_from_strain(
    table: Table, index: int, unit: Unit, e: np.ndarray, rows: np.ndarray, gauge: Gauge
) -> np.ndarray:
    """Stretches from stretches or strains, which must start near no deformation."""
    is_stretch = unit.quantity == "stretch"
    # an artery in place is up to twice as long as one cut out
    if abs(e[rows[0]] - is_stretch) > (1.2 if gauge.is_of_tube else 0.6):
        problem = f"{table.names[index]!r} starts at {e[rows[0]] / unit.factor:g}, which is not "
        problem += f"possible for a {unit.name}{'' if is_stretch else ' strain'}"
        remedy = "a stretch starts near 1 (100 in per cent), a strain near 0; give another kind"
        raise table.error(problem, remedy, column=index, row=rows[0])
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        stretch = {
            "stretch": e,
            "engineering": 1.0 + e,  # e = lambda - 1
            "green": np.sqrt(1.0 + 2.0 * e),  # E = (lambda^2 - 1) / 2
            "log": np.exp(e),  # h = ln lambda
            "almansi": 1.0 / np.sqrt(1.0 - 2.0 * e),  # A = (1 - lambda^-2) / 2
        }[unit.quantity]
    bad = rows[~np.isfinite(stretch[rows])]
    if bad.size:
        problem = f"{e[bad[0]] / unit.factor:g} is not possible as a {unit.name} strain"
        remedy = "check the kind of strain of the column"
        raise table.error(problem, remedy, column=index, row=bad[0])
    return stretch
