"""CellScale BioTester exports: sets, numbered phases, rake distance, tracked points."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.cycles import Cycle, cycle_index, take_branch
from biaxbayes.machines.recording import Gauge, Recording
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
    index = table.by_stem("setname")
    names = [] if index is None else list(dict.fromkeys(table.text(index)))
    chosen = _chosen_sets(table, names, choice.sets)
    others = [name for name in names if name not in chosen]
    out = []
    for name in chosen:
        rows = np.arange(table.rows)
        if index is not None:
            rows = np.flatnonzero(np.array(table.text(index)) == name)
        cycles = _cycles(table, numbers, phases, name, rows)
        number = cycle_index(choice.cycle, cycles, table)
        taken = take_branch(
            partial(_recording, table, name, choice, gauge),
            cycles,
            range(max(number - 1, 0), number + 1),
            choice.branch,
            name,
        )
        if others:
            note = f"sets left out: {', '.join(others)} (--set NAME or --set all takes them)"
            taken = replace(taken, notes=(*taken.notes, note))
        out.append(taken)
    return out


def recognises(table: Table, choice: Choice) -> bool:
    """True if a sheet is an export of a BioTester."""
    return table.by_stem("cycle") is not None or table.by_stem("xforce") is not None


# --- sets, phases and cycles ----------------------------------------------------------------------


def _phases(table: Table) -> tuple[np.ndarray, np.ndarray]:
    """Number of the cycle and lower-case name of the phase of each row."""
    index = table.by_stem("cycle")
    if index is None:
        problem = "no column 'Cycle', so this is not a BioTester export"
        remedy = f"use `machine=generic` with `columns`; {table.listing}"
        raise InputError(problem, file=table.path, remedy=remedy)
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


def _chosen_sets(table: Table, names: Sequence[str], wanted: Sequence[str]) -> Sequence[str]:
    """Names of the selected sets, by default the last; an empty one if the file has no sets."""
    if not names:
        if wanted:
            problem = "no column 'SetName', so the file has no sets"
            raise InputError(problem, file=table.path, remedy=table.listing)
        return ("",)
    if tuple(wanted) == ("all",):
        return names
    for name in wanted:
        if name not in names:
            remedy = f"sets are {', '.join(names)[:200]}"
            raise InputError(f"no set {name[:40]!r}", file=table.path, remedy=remedy)
    return tuple(dict.fromkeys(wanted)) or names[-1:]


def _cycles(
    table: Table, numbers: np.ndarray, phases: np.ndarray, name: str, rows: np.ndarray
) -> list[Cycle]:
    """Cycles of a set that have a Stretch phase."""
    labels = dict.fromkeys(numbers[rows][phases[rows] == "stretch"].tolist())
    if not labels:
        problem = f"no Stretch phase in set {name!r}" if name else "no Stretch phase"
        remedy = f"phases are {', '.join(sorted(set(phases[rows].tolist())))[:80]}"
        raise InputError(problem, file=table.path, column="Cycle", remedy=remedy)
    cycles = []
    for label in labels:
        of_cycle = numbers[rows] == label
        up, down = (rows[of_cycle & (phases[rows] == phase)] for phase in ("stretch", "recover"))
        cycles.append(Cycle(label, up, down))
    return cycles


# --- stretches and forces of some rows ------------------------------------------------------------


def _recording(
    table: Table, name: str, choice: Choice, gauge: Gauge, cycle: Cycle, branch: str
) -> Recording:
    """Convert a branch of a cycle; stretches are those of tracked points if there are any."""
    rows = cycle.rows(branch)
    if rows.size < 2:
        problem = f"{rows.size} rows in the {branch} branch of cycle {cycle.label}"
        raise InputError(problem, file=table.path, remedy="choose another `cycle` or `branch`")
    points = _tracked_points(table, rows, required=choice.stretch_from == "tracked")
    gradient: np.ndarray | None = None
    assumptions: list[str] = []
    if points is None or choice.stretch_from == "rake":
        source, notes = "Size_um", ["stretch from the rakes, not from the tissue"]
        stretch, assumptions = _rake_stretch(table, rows, gauge)
    else:
        source, notes = "tracked points", [f"stretch from {points.shape[1]} tracked points"]
        complete = np.isfinite(points).all(axis=(1, 2))
        if not complete.all():
            notes.append(f"{int((~complete).sum())} rows without tracked points left out")
        rows = rows[complete]
        gradient = _deformation_gradient(points[complete], table, rows)
        stretch = gradient[:, [0, 1], [0, 1]]
    forces = []
    for axis in "XY":
        force = _quantity(table, f"{axis.lower()}force", "force", rows)
        if force is None:
            problem = f"no column '{axis}Force_mN'"
            raise InputError(problem, file=table.path, remedy=table.listing)
        forces.append(force)
    return Recording(
        name=name,
        source=table.path.name + (f", set {name}" if name else ""),
        stretch=stretch,
        load=np.column_stack(forces),
        columns=(f"X {source}", f"Y {source}", "XForce", "YForce"),
        stress_pair="force",
        time_s=_quantity(table, "time", "time", rows),
        gradient=gradient,
        lines=table.lines[rows],
        rows_in_file=table.rows,
        notes=(*table.notes, *notes),
        assumptions=tuple(assumptions),
    )


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
        problem = "no tracked points X1, Y1, X2, Y2, X3, Y3 ... in these rows"
        remedy = f"use `stretch_from=rake`; {table.listing}"
        raise InputError(problem, file=table.path, remedy=remedy)
    return None


def _deformation_gradient(points: np.ndarray, table: Table, rows: np.ndarray) -> np.ndarray:
    """In-plane deformation gradient of points by least squares, (n, 2, 2), from rows at rest."""
    reference = points[0]
    for _ in range(2):
        X = reference - reference.mean(axis=0)
        metric = X.T @ X
        if np.linalg.cond(metric) > 1e6:
            problem = "the tracked points lie on one line"
            remedy = "use `stretch_from=rake`"
            raise InputError(problem, file=table.path, row=int(table.lines[rows[0]]), remedy=remedy)
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
        problem = f"the unit of {table.names[index]!r} is not clear"
        remedy = f"name it like XForce_mN or XSize_um; {table.listing}"
        raise InputError(problem, file=table.path, column=table.names[index], remedy=remedy)
    return table.numbers(index, rows) * unit.factor


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
            problem = f"no column '{axis.upper()}Size_um', so the distance of the rakes is unknown"
            raise InputError(problem, file=table.path, remedy=table.listing)
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
