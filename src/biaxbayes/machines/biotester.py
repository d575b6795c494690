"""CellScale BioTester exports: sets, numbered phases, rake distance, tracked points."""

from __future__ import annotations

import re

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.cycles import RecordedCycle, chosen_number, cycle_label, settling
from biaxbayes.machines.gauge import Gauge
from biaxbayes.machines.recording import Recording
from biaxbayes.specimens.protocol import rest_rows
from biaxbayes.tables.table import Table

PHASE = re.compile(r"\s*(\d+)\s*-\s*(\w+)")
LEAST_TRACKED = 5
"""Least number of rows in which all points are tracked."""


def recordings(table: Table, choice: Choice, gauge: Gauge) -> list[Recording]:
    """Take the branch of a cycle from each selected set of a BioTester export.

    Columns: Cycle (1-Preload, 1-Stretch, 1-Hold, 1-Recover ...), XForce_mN, YForce_mN, and the
    rake (XSize_um, XDisplacement_um ...) or tracked points (X1, Y1 to X4, Y4); optionally SetName
    and Time_S. A branch is the Stretch phase, the reversed Recover phase, or both.
    """
    numbers, phases = _phases(table)
    out = []
    sets = _sets(table, choice.sets)
    others = [name for name in _set_names(table) if name not in sets]
    for name, rows in sets.items():
        cycles = _cycles(table, numbers, phases, name, rows)
        labels = [cycle.label for cycle in cycles]
        number = chosen_number(choice.cycle, labels, table)
        rows, stretch, gradient, origin, assumptions = _stretches(
            table, _branch(table, cycles[number], choice.branch), choice, gauge
        )
        notes = [*table.notes, *origin]
        if number > 0:
            curves = []
            for cycle in cycles[number - 1 : number + 1]:
                up, curve, *_ = _stretches(table, _branch(table, cycle, "loading"), choice, gauge)
                curves.append((curve, _forces(table, up)))
            text, settled = settling(*curves)
            (notes if settled else assumptions).append(f"{name}: {text}" if name else text)
        if others:
            notes.append(f"sets left out: {', '.join(others)} (--set NAME or --set all takes them)")
        source = "Size_um" if gradient is None else "tracked points"
        time = _quantity(table, "time", "time", rows)
        out.append(
            Recording(
                name=name,
                source=table.path.name + (f", set {name}" if name else ""),
                stretch=stretch,
                load=_forces(table, rows),
                columns=(f"X {source}", f"Y {source}", "XForce", "YForce"),
                stress_pair="force",
                time_s=None if choice.branch == "unloading" else time,
                gradient=gradient,
                lines=table.lines[rows],
                rows_in_file=table.rows,
                cycle=cycle_label(labels, number),
                branch=choice.branch,
                notes=tuple(notes),
                assumptions=tuple(assumptions),
            )
        )
    return out


def recognises(table: Table, choice: Choice) -> bool:
    """True if a sheet is an export of a BioTester."""
    return table.by_stem("cycle") is not None or table.by_stem("xforce") is not None


# --- sets, phases and cycles ----------------------------------------------------------------------


def _phases(table: Table) -> tuple[np.ndarray, np.ndarray]:
    """Number of the cycle and lower-case name of the phase of each row."""
    index = table.by_stem("cycle")
    if index is None:
        raise InputError(
            "no column 'Cycle', so this is not a BioTester export",
            file=table.path,
            remedy=f"use `machine=generic` with `columns`; {table.listing}",
        )
    numbers, phases = [], []
    for cell, line in zip(table.text(index), table.lines, strict=True):
        match = PHASE.match(cell)
        if match is None:
            raise InputError(
                f"{cell[:30]!r} is not a phase of a cycle",
                file=table.path,
                row=int(line),
                column=table.names[index],
                remedy="a BioTester writes 1-Preload, 1-Stretch, 1-Hold, 1-Recover",
            )
        numbers.append(match[1].lstrip("0") or "0")
        phases.append(match[2].lower())
    return np.array(numbers), np.array(phases)


def _set_names(table: Table) -> list[str]:
    index = table.by_stem("setname")
    return [] if index is None else list(dict.fromkeys(table.text(index)))


def _sets(table: Table, wanted: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Rows of the selected sets by their names; all rows if the file has no sets."""
    index, names = table.by_stem("setname"), _set_names(table)
    if index is None:
        if wanted:
            raise InputError(
                "no column 'SetName', so the file has no sets",
                file=table.path,
                remedy=table.listing,
            )
        return {"": np.arange(table.rows)}
    wanted = tuple(names) if wanted == ("all",) else wanted or (names[-1],)
    for name in wanted:
        if name not in names:
            raise InputError(
                f"no set {name[:40]!r}", file=table.path, remedy=f"found {', '.join(names)[:200]}"
            )
    labels = np.array(table.text(index))
    return {name: np.flatnonzero(labels == name) for name in wanted}


def _cycles(
    table: Table, numbers: np.ndarray, phases: np.ndarray, name: str, rows: np.ndarray
) -> list[RecordedCycle]:
    """Cycles of a set that have a Stretch phase."""
    labels = dict.fromkeys(numbers[rows][phases[rows] == "stretch"].tolist())
    if not labels:
        raise InputError(
            f"no Stretch phase in set {name!r}" if name else "no Stretch phase",
            file=table.path,
            column="Cycle",
            remedy=f"found {', '.join(sorted(set(phases[rows].tolist())))[:80]}",
        )
    return [
        RecordedCycle(
            label,
            *(
                rows[(numbers[rows] == label) & (phases[rows] == phase)]
                for phase in ("stretch", "recover")
            ),
        )
        for label in labels
    ]


def _branch(table: Table, cycle: RecordedCycle, branch: str) -> np.ndarray:
    """Rows of a branch of a cycle, at least two."""
    rows = cycle.rows(branch)
    if rows.size < 2:
        raise InputError(
            f"{rows.size} rows in the {branch} branch of cycle {cycle.label}",
            file=table.path,
            remedy="choose another `cycle` or `branch`",
        )
    return rows


# --- stretches and forces of some rows ------------------------------------------------------------


def _stretches(
    table: Table, rows: np.ndarray, choice: Choice, gauge: Gauge
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, list[str], list[str]]:
    """Rows with their stretches, gradient, origin and assumptions; by default of tracked points."""
    points = _tracked_points(table, rows, required=choice.stretch_from == "tracked")
    if points is None or choice.stretch_from == "rake":
        stretch, assumptions = _rake_stretch(table, rows, gauge)
        return rows, stretch, None, ["stretch from the rakes, not from the tissue"], assumptions
    complete = np.isfinite(points).all(axis=(1, 2))
    notes = [f"stretch from {points.shape[1]} tracked points"]
    if not complete.all():
        notes.append(f"{int((~complete).sum())} rows without tracked points left out")
    rows = rows[complete]
    gradient = _deformation_gradient(points[complete], table, rows)
    return rows, gradient[:, [0, 1], [0, 1]], gradient, notes, []


def _tracked_points(table: Table, rows: np.ndarray, *, required: bool) -> np.ndarray | None:
    """Positions of tracked points, shape (n, points, 2), NaN where one is lost."""
    pairs = []
    for number in range(1, 100):
        x, y = table.by_stem(f"x{number}"), table.by_stem(f"y{number}")
        if x is None or y is None:
            break
        pairs.append([table.sparse_numbers(x, rows), table.sparse_numbers(y, rows)])
    if len(pairs) >= 3:
        points = np.moveaxis(np.array(pairs), 2, 0)
        # Trackers write 0, 0 for a point that they lost.
        points[(points == 0.0).all(axis=2)] = np.nan
        if np.isfinite(points).all(axis=(1, 2)).sum() >= LEAST_TRACKED:
            return points
    if required:
        raise InputError(
            "no tracked points X1, Y1, X2, Y2, X3, Y3 ... in these rows",
            file=table.path,
            remedy=f"use `stretch_from=rake`; {table.listing}",
        )
    return None


def _deformation_gradient(points: np.ndarray, table: Table, rows: np.ndarray) -> np.ndarray:
    """In-plane deformation gradient of points by least squares, (n, 2, 2), from rows at rest."""
    reference = points[0]
    for _ in range(2):
        X = reference - reference.mean(axis=0)
        metric = X.T @ X
        if np.linalg.cond(metric) > 1e6:
            raise InputError(
                "the tracked points lie on one line",
                file=table.path,
                row=int(table.lines[rows[0]]),
                remedy="use `stretch_from=rake`",
            )
        x = points - points.mean(axis=1, keepdims=True)
        # x = F X for every point, in the least-squares sense: F = (sum x X^T) (sum X X^T)^-1
        gradient = np.einsum("nmi,mj->nij", x, X) @ np.linalg.inv(metric)
        resting = rest_rows(gradient[:, 0, 0], gradient[:, 1, 1])
        reference = points[:resting].mean(axis=0)
    return gradient


def _quantity(table: Table, stem: str, quantity: str, rows: np.ndarray) -> np.ndarray | None:
    """A column in N, mm or s; None where the file has none."""
    index = table.by_stem(stem)
    if index is None:
        return None
    unit = table.unit(index)
    if unit is None or unit.quantity != quantity:
        raise InputError(
            f"the unit of {table.names[index]!r} is not clear",
            file=table.path,
            column=table.names[index],
            remedy=f"name it like XForce_mN or XSize_um; {table.listing}",
        )
    return table.numbers(index, rows) * unit.factor


def _forces(table: Table, rows: np.ndarray) -> np.ndarray:
    """Forces in N, shape (n, 2)."""
    forces = []
    for axis in "xy":
        force = _quantity(table, f"{axis}force", "force", rows)
        if force is None:
            column = f"{axis.upper()}Force_mN"
            raise InputError(f"no column '{column}'", file=table.path, remedy=table.listing)
        forces.append(force)
    return np.column_stack(forces)


def _rake_stretch(table: Table, rows: np.ndarray, gauge: Gauge) -> tuple[np.ndarray, list[str]]:
    """Stretches from the distance of the rakes, and their assumptions."""
    columns, assumptions = [], []
    for k, axis in enumerate("xy"):
        size = _quantity(table, f"{axis}size", "length", rows)
        moved = _quantity(table, f"{axis}displacement", "length", rows)
        if size is not None:
            # XSize is the rake distance at every moment, or that at the start
            length = size if moved is None or np.ptp(size) > 0.0 else size + moved
        elif moved is not None:
            first = _quantity(table, f"{axis}displacement", "length", np.array([0]))
            assert first is not None
            name = f"{axis.upper()}Displacement"
            length, note = gauge.from_displacement(moved, float(first[0]), k, name, table.path)
            assumptions.append(note)
        else:
            raise InputError(
                f"no column '{axis.upper()}Size_um', so the distance of the rakes is unknown",
                file=table.path,
                remedy=table.listing,
            )
        if length.min() <= 0.0:
            raise InputError(
                f"the rake distance of {length.min():g} mm in {axis} is not positive",
                file=table.path,
                row=int(table.lines[rows[int(length.argmin())]]),
                remedy="check the size and displacement columns",
            )
        columns.append(length)
    lengths = np.column_stack(columns)
    resting = rest_rows(lengths[:, 0], lengths[:, 1])
    return lengths / lengths[:resting].mean(axis=0), assumptions
