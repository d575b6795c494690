"""Any table of a biaxial test, by a map of its columns: ``stretch_x=F11,piola_x_kPa=P11_kPa``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.columns import SHEAR, Column, column_map, parse_columns
from biaxbayes.machines.cycles import (
    Cycle,
    by_ratio,
    cycle_index,
    split_cycles,
    take_branch,
)
from biaxbayes.machines.recording import Gauge, Recording
from biaxbayes.specimens.specimen import STRESS_PAIRS
from biaxbayes.tables.table import Table
from biaxbayes.tables.units import STRAINS, Unit

PER_CENT_RANGE = 0.01
"""Strains in a column of per cent within this range are fractions, as spreadsheets store them."""


def recordings(table: Table, choice: Choice, gauge: Gauge) -> list[Recording]:
    """Take the branch of a cycle from each protocol of a table."""
    columns = column_map(table, parse_columns(choice.columns))
    table = table.without_missing(
        [column.index for column in columns.values() if column.unit is not None],
        drop=choice.drop_missing,
        remedy="leave such rows out with `drop_missing=True`",
    )
    if "protocol" not in columns:
        return _protocols(table, columns, "", np.arange(table.rows), choice, gauge)
    labels = np.array(table.text(columns["protocol"].index))
    taken = []
    for name in dict.fromkeys(labels.tolist()):
        rows = np.flatnonzero(labels == name)
        taken += _protocols(table, columns, name, rows, choice, gauge)
    return taken


def recognises(table: Table, choice: Choice) -> bool:
    """True if a sheet has any column of the map."""
    wanted = parse_columns(choice.columns).values()
    names = [name for text in wanted for name in (text, text.rpartition(":")[0])]
    return not choice.columns or any(table.has_column(name) for name in names)


def _protocols(
    table: Table,
    columns: Mapping[str, Column],
    name: str,
    rows: np.ndarray,
    choice: Choice,
    gauge: Gauge,
) -> list[Recording]:
    """The selected cycle of a record, or the last one of each ratio."""
    whole = _recording(table, columns, rows, gauge)
    labels = table.text(columns["cycle"].index, rows) if "cycle" in columns else None
    cycles = split_cycles(whole.stretch, whole.load, labels, table)
    ratios = by_ratio(whole.stretch, whole.load, cycles)
    if choice.cycle != "last":
        wanted = cycle_index(choice.cycle, cycles, table)
        group = next(group for group in ratios.values() if wanted in group)
        ratios = {"": [n for n in group if n <= wanted]}
    if len(ratios) > 1:
        note = f"the record holds the ratios {', '.join(ratios)}: one protocol for each"
        whole = replace(whole, notes=(*whole.notes, note))

    def record(cycle: Cycle, branch: str) -> Recording:
        return whole.at(cycle.rows(branch))

    out = []
    for ratio, group in ratios.items():
        label = f"{name} {ratio}".strip()
        source = table.path.name + (f", protocol {label}" if label else "")
        taken = take_branch(record, cycles, group, choice.branch, ratio)
        out.append(replace(taken, name=label, source=source))
    return out


def _recording(
    table: Table, columns: Mapping[str, Column], rows: np.ndarray, gauge: Gauge
) -> Recording:
    """All cycles of a protocol, with stretches and loads from their columns."""

    def scaled(target: str) -> np.ndarray:
        unit = columns[target].unit
        assert unit is not None
        return table.numbers(columns[target].index, rows) * unit.factor

    pair = next(p for p, names in STRESS_PAIRS.items() if names[0] in columns)
    assumptions = [column.conflict for column in columns.values() if column.conflict]
    stretches = []
    for k, axis in enumerate("xy"):
        column = columns[f"stretch_{axis}"]
        if column.unit is not None and column.unit.quantity in STRAINS:
            stretches.append(_stretch_from_strain(table, column, column.unit, rows))
            continue
        lengths = scaled(f"stretch_{axis}")
        stretch, note = _stretch_from_length(table, column, lengths, k, pair, gauge)
        stretches.append(stretch)
        assumptions.append(note)
    stretch = np.column_stack(stretches)
    _check_per_cent(table, columns, stretch)
    load = np.column_stack([scaled(target) for target in STRESS_PAIRS[pair]])
    gradient = None
    if any(target in columns for target in SHEAR):
        gradient = stretch[:, :, None] * np.eye(2)
        for target, (i, j) in (("shear_xy", (0, 1)), ("shear_yx", (1, 0))):
            if target in columns:
                gradient[:, i, j] = scaled(target)
    read = ", ".join(f"{target} from {column}" for target, column in columns.items())
    targets = ("stretch_x", "stretch_y", *STRESS_PAIRS[pair])
    return Recording(
        name="",
        source="",
        stretch=stretch,
        load=load,
        columns=tuple(columns[target].name for target in targets),
        stress_pair=pair,
        time_s=scaled("time_s") if "time_s" in columns else None,
        gradient=gradient,
        lines=table.lines[rows],
        rows_in_file=rows.size,
        notes=(*table.notes, read),
        assumptions=tuple(assumptions),
    )


def _stretch_from_length(
    table: Table, column: Column, lengths_mm: np.ndarray, k: int, pair: str, gauge: Gauge
) -> tuple[np.ndarray, str]:
    """Stretches from a displacement or a distance between marks or grips, and a note."""
    unit = column.unit
    assert unit is not None
    displaced = unit.quantity == "displacement"
    if pair == "cauchy" and displaced and gauge.given_mm[k] is None:
        # Nominal stress is Cauchy stress over the stretch that the lab multiplied it by.
        raise InputError(
            f"{column.name!r} is a displacement without a gauge length, and the loads are "
            "Cauchy stresses: stretch and nominal stress would depend on an assumed length",
            file=table.path,
            column=column.name,
            remedy=f"give the gauge length that the stresses were computed with, "
            f"`gauge_{'xy'[k]}_mm`, or the forces in place of the stresses",
        )
    first = float(table.numbers(column.index, np.array([0]))[0]) * unit.factor
    convert = gauge.from_displacement if displaced else gauge.from_distance
    return convert(lengths_mm, first, k, column.name, table.path)


def _stretch_from_strain(table: Table, column: Column, unit: Unit, rows: np.ndarray) -> np.ndarray:
    """Stretches from a column of stretches or strains, which must start near no deformation."""
    start = float(table.numbers(column.index, np.array([0]))[0])
    is_stretch = unit.quantity == "stretch"
    if abs(start * unit.factor - is_stretch) > 0.6:
        raise InputError(
            f"{column.name!r} starts at {start:g}, which is not possible for a {unit.name}"
            f"{'' if is_stretch else ' strain'}",
            file=table.path,
            row=int(table.lines[0]),
            column=column.name,
            remedy="a stretch starts near 1 (100 in per cent), a strain near 0; give another kind",
        )
    values = table.numbers(column.index, rows)
    e = values * unit.factor
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        stretch = {
            "stretch": e,
            "engineering": 1.0 + e,  # e = lambda - 1
            "green": np.sqrt(1.0 + 2.0 * e),  # E = (lambda^2 - 1) / 2
            "log": np.exp(e),  # h = ln lambda
            "almansi": 1.0 / np.sqrt(1.0 - 2.0 * e),  # A = (1 - lambda^-2) / 2
        }[unit.quantity]
    bad = np.flatnonzero(~np.isfinite(stretch))
    if bad.size:
        raise InputError(
            f"{values[bad[0]]:g} is not possible as a {unit.name} strain",
            file=table.path,
            row=int(table.lines[rows[bad[0]]]),
            column=column.name,
            remedy="check the kind of strain of the column",
        )
    return stretch


def _check_per_cent(table: Table, columns: Mapping[str, Column], stretch: np.ndarray) -> None:
    """Refuse per cent in a name where the values are fractions, as spreadsheets keep them."""
    in_per_cent = []
    for k, axis in enumerate("xy"):
        column = columns[f"stretch_{axis}"]
        written = any(u.name == "percent" for u in table.units(column.index))
        if written and column.unit is not None and column.unit.factor < 1.0:
            in_per_cent.append((column.name, float(np.ptp(stretch[:, k]))))
    if in_per_cent and max(extent for _, extent in in_per_cent) <= PER_CENT_RANGE:
        name = in_per_cent[0][0]
        raise InputError(
            f"{name!r} changes by {in_per_cent[0][1]:.2%} only if it is in per cent",
            file=table.path,
            column=name,
            remedy="spreadsheets store 20 % as 0.2: rename the columns without the per cent sign, "
            "or multiply the values by 100",
        )
