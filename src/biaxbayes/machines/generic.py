"""Any table of a biaxial test, by a map of its columns: ``stretch_x=F11,piola_x_kPa=P11_kPa``."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.columns import SHEAR, Column, column_map, numeric_columns, parse_columns
from biaxbayes.machines.cycles import (
    by_ratio,
    chosen_number,
    cycle_label,
    recorded_cycles,
    settling,
)
from biaxbayes.machines.gauge import Gauge
from biaxbayes.machines.recording import Recording
from biaxbayes.specimens.specimen import STRESS_PAIRS
from biaxbayes.tables.table import Table
from biaxbayes.tables.units import STRAINS, Unit


def recordings(table: Table, choice: Choice, gauge: Gauge) -> list[Recording]:
    """Take the branch of a cycle from each protocol of a table.

    The cycle is one of the mapped cycle column, else of those that the curves themselves show.
    Columns, cells, cycles or branches that are missing or not clear are refused.
    """
    columns = column_map(table, parse_columns(choice.columns))
    table = table.without_missing(
        numeric_columns(columns),
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


def is_other_table(table: Table, choice: Choice) -> bool:
    """Whether a sheet has none of the columns of the map."""
    for text in parse_columns(choice.columns).values():
        for name in (text, text.rpartition(":")[0]):
            try:
                table.column(name)
            except InputError:
                continue
            return False
    return bool(choice.columns)


def _protocols(
    table: Table,
    columns: Mapping[str, Column],
    name: str,
    rows: np.ndarray,
    choice: Choice,
    gauge: Gauge,
) -> list[Recording]:
    """The wanted cycle of a record, or the last one of each ratio where it has several."""
    pair = next(p for p, names in STRESS_PAIRS.items() if names[0] in columns)
    _check_gauge_of_cauchy(table, columns, pair, gauge)
    stretch, notes = _stretches(table, columns, rows, gauge)
    load = np.column_stack([_scaled(table, columns[target], rows) for target in STRESS_PAIRS[pair]])
    labels = table.text(columns["cycle"].index, rows) if "cycle" in columns else None
    cycles = recorded_cycles(stretch, load, labels, table)
    numbers = [cycle.label for cycle in cycles]
    ratios = by_ratio(stretch, load, cycles)
    if choice.cycle != "last":
        wanted = chosen_number(choice.cycle, numbers, table)
        ratios = {"": [n for group in ratios.values() if wanted in group for n in group]}
        ratios[""] = [n for n in ratios[""] if n <= wanted]
    gradient = _gradient(table, columns, rows, stretch)
    time = None
    if "time_s" in columns and choice.branch != "unloading":
        time = _scaled(table, columns["time_s"], rows)
    read = ", ".join(f"{target} from {column}" for target, column in columns.items())
    out = []
    for ratio, group in ratios.items():
        taken = cycles[group[-1]].rows(choice.branch)
        lines, assumptions = [*table.notes, read], list(notes)
        if ratio:
            lines.append(f"the record holds the ratios {', '.join(ratios)}: a protocol each")
        if len(group) > 1:
            up = [cycles[n].loading for n in group[-2:]]
            words, settled = settling(*((stretch[r], load[r]) for r in up))
            (lines if settled else assumptions).append(f"{ratio}: {words}" if ratio else words)
        label = f"{name} {ratio}".strip()
        out.append(
            Recording(
                name=label,
                source=table.path.name + (f", protocol {label}" if label else ""),
                stretch=stretch[taken],
                load=load[taken],
                columns=tuple(
                    columns[t].name for t in ("stretch_x", "stretch_y", *STRESS_PAIRS[pair])
                ),
                stress_pair=pair,
                time_s=None if time is None else time[taken],
                gradient=None if gradient is None else gradient[taken],
                lines=table.lines[rows][taken],
                rows_in_file=rows.size,
                cycle=cycle_label(numbers, group[-1]),
                branch=choice.branch,
                notes=tuple(lines),
                assumptions=tuple(assumptions),
            )
        )
    return out


def _check_gauge_of_cauchy(
    table: Table, columns: Mapping[str, Column], pair: str, gauge: Gauge
) -> None:
    """Refuse Cauchy stresses with displacements over an assumed length.

    The nominal stress is the Cauchy stress over the stretch by which the lab multiplied it; over
    another gauge length than the lab's it would be off as well as the stretch.
    """
    for k, axis in enumerate("xy"):
        column = columns[f"stretch_{axis}"]
        displaced = column.unit is not None and column.unit.quantity == "displacement"
        if pair == "cauchy" and displaced and gauge.given_mm[k] is None:
            raise InputError(
                f"{column.name!r} is a displacement without a gauge length, and the loads are "
                "Cauchy stresses: stretch and nominal stress would both rest on an assumed length",
                file=table.path,
                column=column.name,
                remedy=f"give the gauge length that the stresses were computed with, "
                f"`gauge_{axis}_mm`, or the forces in place of the stresses",
            )


def _scaled(table: Table, column: Column, rows: np.ndarray) -> np.ndarray:
    assert column.unit is not None
    return table.numbers(column.index, rows) * column.unit.factor


def _stretches(
    table: Table, columns: Mapping[str, Column], rows: np.ndarray, gauge: Gauge
) -> tuple[np.ndarray, list[str]]:
    """Stretches in both directions, shape (n, 2), and what had to be assumed for them."""
    out, notes = [], []
    for k, axis in enumerate("xy"):
        column = columns[f"stretch_{axis}"]
        unit = column.unit
        assert unit is not None
        values = table.numbers(column.index, rows)
        start = float(table.numbers(column.index, np.array([0]))[0])
        if unit.quantity in STRAINS:
            _check_start(table, column, start)
            stretch = stretch_from(values, unit)
        else:
            scaled, first = values * unit.factor, start * unit.factor
            displaced = unit.quantity == "displacement"
            convert = gauge.from_displacement if displaced else gauge.from_distance
            stretch, note = convert(scaled, first, k, column.name, table.path)
            notes.append(note)
        bad = np.flatnonzero(~np.isfinite(stretch))
        if bad.size:
            raise InputError(
                f"{values[bad[0]]:g} is no {unit.name} strain",
                file=table.path,
                row=int(table.lines[rows[bad[0]]]),
                column=column.name,
                remedy="check the kind of strain that the column holds",
            )
        out.append(stretch)
    stretches = np.column_stack(out)
    _check_per_cent(table, columns, stretches)
    return stretches, notes


def stretch_from(values: np.ndarray, unit: Unit) -> np.ndarray:
    """Stretches from a stretch or any kind of strain; not finite where a value cannot be."""
    e = values * unit.factor
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        if unit.quantity == "engineering":
            return 1.0 + e  # e = lambda - 1
        if unit.quantity == "green":
            return np.sqrt(1.0 + 2.0 * e)  # E = (lambda^2 - 1) / 2
        if unit.quantity == "log":
            return np.exp(e)  # h = ln lambda
        if unit.quantity == "almansi":
            return 1.0 / np.sqrt(1.0 - 2.0 * e)  # A = (1 - lambda^-2) / 2
    return e


def _check_start(table: Table, column: Column, start: float) -> None:
    """Refuse a strain that starts near one, and a stretch that starts near zero."""
    assert column.unit is not None
    stretch = column.unit.quantity == "stretch"
    if abs(start * column.unit.factor - stretch) > 0.6:
        raise InputError(
            f"{column.name!r} starts at {start:g}, as no {column.unit.name} "
            f"{'does' if stretch else 'strain does'}",
            file=table.path,
            row=int(table.lines[0]),
            column=column.name,
            remedy="a stretch starts near 1 (100 in per cent), a strain near 0; state another kind",
        )


def _check_per_cent(table: Table, columns: Mapping[str, Column], stretch: np.ndarray) -> None:
    """Refuse per cent in a name where the values are fractions, as spreadsheets keep them."""
    for axis in "xy":
        unit = columns[f"stretch_{axis}"].unit
        written = table.unit(columns[f"stretch_{axis}"].index)
        if unit is None or written is None or written.quantity != "fraction":
            return
        if unit.factor == 1.0 or np.ptp(stretch) > 0.01:
            return
    name = columns["stretch_x"].name
    raise InputError(
        f"{name!r} reaches {np.abs(stretch - 1.0).max():.2%} if it is in per cent",
        file=table.path,
        column=name,
        remedy="spreadsheets keep 20 % as 0.2: rename the columns without the per cent sign, or "
        "multiply the values by 100",
    )


def _gradient(
    table: Table, columns: Mapping[str, Column], rows: np.ndarray, stretch: np.ndarray
) -> np.ndarray | None:
    """Deformation gradient with the off-diagonal components that the table has."""
    if not any(target in columns for target in SHEAR):
        return None
    gradient = np.zeros((rows.size, 2, 2))
    gradient[:, 0, 0], gradient[:, 1, 1] = stretch.T
    for target, place in (("shear_xy", (0, 1)), ("shear_yx", (1, 0))):
        if target in columns:
            gradient[:, place[0], place[1]] = _scaled(table, columns[target], rows)
    return gradient
