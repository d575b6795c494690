"""Any table of a biaxial test, by a map of its columns."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.column_map import SHEAR, Column, column_map, stretch_of
from biaxbayes.specimens.raw_table import RawTable
from biaxbayes.specimens.recording import Recording, chosen_number, cycle_label, take_branch
from biaxbayes.specimens.specimen import STRESS_PAIRS

__all__ = ["generic_recordings"]


def generic_recordings(
    table: RawTable,
    wanted: Mapping[str, str],
    *,
    cycle: str = "last",
    branch: str = "loading",
    edges_mm: tuple[float, float] | None = None,
) -> list[Recording]:
    """Take the branch of a cycle from each protocol of a table.

    Parameters
    ----------
    table : RawTable
    wanted : mapping
        Targets and raw columns, from :func:`~biaxbayes.specimens.column_map.parse_columns`.
    cycle : str
        ``last`` or a number: of the mapped cycle column, else of the cycles that the curves
        themselves show.
    branch : {"loading", "unloading", "both"}
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
    columns = column_map(table, wanted)
    everything = np.arange(table.rows)
    if "protocol" not in columns:
        return [_recording(table, columns, "", everything, cycle, branch, edges_mm)]
    labels = np.array(table.text(columns["protocol"].index))
    return [
        _recording(table, columns, name, np.flatnonzero(labels == name), cycle, branch, edges_mm)
        for name in dict.fromkeys(labels.tolist())
    ]


def _recording(
    table: RawTable,
    columns: Mapping[str, Column],
    name: str,
    rows: np.ndarray,
    cycle: str,
    branch: str,
    edges_mm: tuple[float, float] | None,
) -> Recording:
    rows, label = _cycle_rows(table, columns, rows, cycle)
    stretch = np.column_stack(
        [
            _stretch(table, columns[f"stretch_{axis}"], rows, edges_mm, k)
            for k, axis in enumerate("xy")
        ]
    )
    pair = next(p for p, names in STRESS_PAIRS.items() if names[0] in columns)
    load = np.column_stack([_scaled(table, columns[target], rows) for target in STRESS_PAIRS[pair]])
    taken, found_label = take_branch(
        stretch, load, branch, "last" if "cycle" in columns else cycle, table
    )
    timed = "time_s" in columns and branch != "unloading"
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
        branch=branch,
        notes=(
            *table.notes,
            ", ".join(f"{target} from {column.describe()}" for target, column in columns.items()),
        ),
    )


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
