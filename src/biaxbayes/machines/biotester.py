"""CellScale BioTester exports: sets, numbered phases, rake distance, tracked points."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.conversion import Choice, Gauge, Recording
from biaxbayes.machines.cycles import chosen_number, cycle_label, settling
from biaxbayes.specimens.protocol import rest_rows
from biaxbayes.tables.table import Table
from biaxbayes.tables.units import Unit

# --- points tracked on the tissue by a camera, and the deformation gradient that they show -------


ENOUGH_TRACKED = 5


def tracked_points(table: Table, rows: np.ndarray, *, required: bool) -> np.ndarray | None:
    """Positions of the tracked points, shape (n, points, 2), NaN where one is lost."""
    pairs = []
    for number in range(1, 100):
        x, y = (table.by_stem(f"{axis}{number}") for axis in "xy")
        if x is None or y is None:
            break
        pairs.append((x, y))
    points = None
    if len(pairs) >= 3:
        points = np.stack(
            [
                np.column_stack([table.sparse_numbers(index, rows) for index in pair])
                for pair in pairs
            ],
            axis=1,
        )
        # Trackers write 0, 0 for a point that they lost.
        points[(points == 0.0).all(axis=2)] = np.nan
        if np.isfinite(points).all(axis=(1, 2)).sum() < ENOUGH_TRACKED:
            points = None
    if points is None and required:
        raise InputError(
            "no tracked points X1, Y1, X2, Y2, X3, Y3 ... in these rows",
            file=table.path,
            remedy=f"use --stretch-from rake; {table.found}",
        )
    return points


def deformation_gradient(points: np.ndarray, table: Table, rows: np.ndarray) -> np.ndarray:
    """In-plane deformation gradient of tracked points by least squares.

    The reference is the mean position over the rows at rest, which are found from a first
    estimate relative to the first row.

    Parameters
    ----------
    points : ndarray, shape (n, m, 2)
        Positions of m >= 3 points.
    table : Table
    rows : ndarray of int, shape (n,)
        For messages.

    Returns
    -------
    ndarray, shape (n, 2, 2)
    """
    reference = points[0]
    for _ in range(2):
        X = reference - reference.mean(axis=0)
        metric = X.T @ X
        if np.linalg.cond(metric) > 1e6:
            raise InputError(
                "the tracked points lie on one line",
                file=table.path,
                row=int(table.lines[rows[0]]),
                remedy="use --stretch-from rake",
            )
        x = points - points.mean(axis=1, keepdims=True)
        # x = F X for every point, in the least-squares sense: F = (sum x X^T) (sum X X^T)^-1
        gradient = np.einsum("nmi,mj->nij", x, X) @ np.linalg.inv(metric)
        resting = rest_rows(gradient[:, 0, 0], gradient[:, 1, 1])
        reference = points[:resting].mean(axis=0)
    return gradient


# --- sets, phases and the distance of the rakes --------------------------------------------------


PHASE = re.compile(r"\s*(\d+)\s*-\s*(\w+)")
BRANCH_PHASES = {"loading": ("stretch",), "unloading": ("recover",), "both": ("stretch", "recover")}


def recordings(table: Table, choice: Choice, gauge: Gauge) -> list[Recording]:
    """Take the branch of a cycle from each wanted set of a BioTester export.

    Parameters
    ----------
    table : Table
        Columns ``Cycle`` (1-Preload, 1-Stretch, 1-Hold, 1-Recover ...), ``XForce_mN``,
        ``YForce_mN``, and the rake (``XSize_um``, ``XDisplacement_um`` ...) or tracked points
        (``X1``, ``Y1`` to ``X4``, ``Y4``); optionally ``SetName`` and ``Time_S``.
    choice : Choice
        Its cycle is counted in each set. Its branch is the Stretch phase, the Recover phase
        turned round, or both; Hold, Preload and Rest stay out. Stretches are those of the
        tracked points where there are any, else of the rake, unless it says which. Its sets may
        be ``all``.
    gauge : Gauge
        Rake distances, where the file holds displacements only.

    Returns
    -------
    list of Recording
        Stretches relative to the rows at rest at the start of the branch.

    Raises
    ------
    InputError
        For columns, sets, cycles or points that are not there or not clear.
    """
    phases = _phases(table)
    found = []
    wanted, left = _sets(table, choice.sets)
    for name, rows in wanted:
        cycles = _cycles(table, phases, name, rows)
        number = chosen_number(choice.cycle, cycles, table)
        taken = _branch_rows(table, phases, cycles[number], rows, choice.branch)
        recording = _recording(table, name, taken, cycle_label(cycles, number), choice, gauge)
        if number > 0:
            last_two = (
                _loading(table, phases, name, cycle, rows, choice, gauge)
                for cycle in cycles[number - 1 : number + 1]
            )
            words, settled = settling(*last_two)
            if settled:
                recording = replace(recording, notes=(*recording.notes, words))
            else:
                named = f"{name}: {words}" if name else words
                recording = replace(recording, assumptions=(*recording.assumptions, named))
        found.append(recording)
    if left:
        note = f"sets left out: {', '.join(left)} (--set NAME or --set all takes them)"
        found = [replace(r, notes=(*r.notes, note)) for r in found]
    return found


def is_other_table(table: Table, choice: Choice) -> bool:
    """Whether a sheet is no export of a BioTester."""
    return table.by_stem("cycle") is None and table.by_stem("xforce") is None


def _cycles(table: Table, phases: np.ndarray, name: str, rows: np.ndarray) -> list[str]:
    """Numbers of the cycles of a set that have a Stretch phase."""
    cycles = list(dict.fromkeys(n for n, what in phases[rows].tolist() if what == "stretch"))
    if not cycles:
        raise InputError(
            f"no Stretch phase in set {name!r}" if name else "no Stretch phase",
            file=table.path,
            column="Cycle",
            remedy=f"found {', '.join(sorted({w for _, w in phases[rows].tolist()}))[:80]}",
        )
    return cycles


def _branch_rows(
    table: Table, phases: np.ndarray, cycle: str, rows: np.ndarray, branch: str
) -> np.ndarray:
    """Rows of the wanted branch of a cycle of a set, from rest on."""
    of_branch = np.isin(phases[rows, 1], BRANCH_PHASES[branch])
    taken = rows[(phases[rows, 0] == cycle) & of_branch]
    if taken.size < 2:
        raise InputError(
            f"{taken.size} rows in the {branch} branch of cycle {cycle}",
            file=table.path,
            remedy="choose another --cycle or --branch",
        )
    return taken[::-1] if branch == "unloading" else taken


def _loading(
    table: Table,
    phases: np.ndarray,
    name: str,
    cycle: str,
    rows: np.ndarray,
    choice: Choice,
    gauge: Gauge,
) -> tuple[np.ndarray, np.ndarray]:
    """Stretches and loads of the loading branch of a cycle."""
    taken = _branch_rows(table, phases, cycle, rows, "loading")
    recording = _recording(table, name, taken, None, choice, gauge)
    return recording.stretch, recording.load


def _phases(table: Table) -> np.ndarray:
    """Number and lower-case name of the phase of each row, shape (n, 2)."""
    index = table.by_stem("cycle")
    if index is None:
        raise InputError(
            "no column 'Cycle', so no BioTester export",
            file=table.path,
            remedy=f"use --machine generic --columns ...; {table.found}",
        )
    phases = []
    for cell, line in zip(table.text(index), table.lines, strict=True):
        match = PHASE.match(cell)
        if match is None:
            raise InputError(
                f"{cell[:30]!r} is no phase of a cycle",
                file=table.path,
                row=int(line),
                column=table.names[index],
                remedy="a BioTester writes 1-Preload, 1-Stretch, 1-Hold, 1-Recover",
            )
        phases.append((match[1].lstrip("0") or "0", match[2].lower()))
    return np.array(phases)


def _sets(table: Table, wanted: tuple[str, ...]) -> tuple[list[tuple[str, np.ndarray]], list[str]]:
    """Rows of the wanted sets by their names, and the names of the others."""
    index = table.by_stem("setname")
    if index is None:
        if wanted:
            raise InputError("no column 'SetName', so no sets", file=table.path, remedy=table.found)
        return [("", np.arange(table.rows))], []
    labels = np.array(table.text(index))
    names = list(dict.fromkeys(labels.tolist()))
    if not wanted:
        wanted = (names[-1],)
    elif wanted == ("all",):
        wanted = tuple(names)
    for name in wanted:
        if name not in names:
            raise InputError(
                f"no set {name[:40]!r}", file=table.path, remedy=f"found {', '.join(names)[:200]}"
            )
    taken = [(name, np.flatnonzero(labels == name)) for name in wanted]
    return taken, [name for name in names if name not in wanted]


def _quantity(table: Table, stem: str, quantity: str, rows: np.ndarray) -> np.ndarray | None:
    """A column in N, mm or s; None where the file has none."""
    index = table.by_stem(stem)
    if index is None:
        return None
    unit: Unit | None = table.unit(index)
    if unit is None or unit.quantity != quantity:
        raise InputError(
            f"the unit of {table.names[index]!r} is not clear",
            file=table.path,
            column=table.names[index],
            remedy=f"name it like XForce_mN or XSize_um; {table.found}",
        )
    return table.numbers(index, rows) * unit.factor


def _recording(
    table: Table,
    set_name: str,
    rows: np.ndarray,
    cycle: str | None,
    choice: Choice,
    gauge: Gauge,
) -> Recording:
    tracked = tracked_points(table, rows, required=choice.stretch_from == "tracked")
    notes: tuple[str, ...]
    gradient = None
    assumptions: list[str] = []
    if choice.stretch_from != "rake" and tracked is not None:
        kept = np.isfinite(tracked).all(axis=(1, 2))
        points = tracked.shape[1]
        notes = (f"stretch from {points} tracked points",)
        if not kept.all():
            notes += (f"{int((~kept).sum())} rows without tracked points left out",)
        rows = rows[kept]
        gradient = deformation_gradient(tracked[kept], table, rows)
        stretch = np.column_stack([gradient[:, 0, 0], gradient[:, 1, 1]])
    else:
        stretch, assumptions = _rake_stretch(table, rows, gauge)
        notes = ("stretch from the rakes, not from the tissue",)
    seen = "tracked points" if gradient is not None else "Size_um"
    time = _quantity(table, "time", "time", rows) if choice.branch != "unloading" else None
    return Recording(
        name=set_name,
        source=table.path.name + (f", set {set_name}" if set_name else ""),
        stretch=stretch,
        load=np.column_stack([_force(table, axis, rows) for axis in "XY"]),
        columns=(f"X {seen}", f"Y {seen}", "XForce", "YForce"),
        stress_pair="force",
        time_s=time,
        gradient=gradient,
        lines=table.lines[rows],
        rows_in_file=table.rows,
        cycle=cycle,
        branch=choice.branch,
        notes=(*table.notes, *notes),
        assumptions=tuple(assumptions),
    )


def _force(table: Table, axis: str, rows: np.ndarray) -> np.ndarray:
    force = _quantity(table, f"{axis}force".lower(), "force", rows)
    if force is None:
        raise InputError(f"no column '{axis}Force_mN'", file=table.path, remedy=table.found)
    return force


def _rake_stretch(table: Table, rows: np.ndarray, gauge: Gauge) -> tuple[np.ndarray, list[str]]:
    """Stretches by the distance of the rakes, and what had to be assumed for them."""
    columns, assumptions = [], []
    for k, axis in enumerate("xy"):
        size = _quantity(table, f"{axis}size", "length", rows)
        moved = _quantity(table, f"{axis}displacement", "length", rows)
        if size is None and moved is None:
            raise InputError(
                f"no column '{axis.upper()}Size_um', so no rake distance",
                file=table.path,
                remedy=table.found,
            )
        if size is not None:
            # XSize is the rake distance at every moment, or that at the start
            length = size if moved is None or np.ptp(size) > 0.0 else size + moved
        else:
            assert moved is not None
            first = _quantity(table, f"{axis}displacement", "length", np.array([0]))
            assert first is not None
            name = f"{axis.upper()}Displacement"
            length, note = gauge.displaced(moved, float(first[0]), k, name, table.path)
            assumptions.append(note)
        if length.min() <= 0.0:
            raise InputError(
                f"a rake distance of {length.min():g} mm in {axis}",
                file=table.path,
                row=int(table.lines[rows[int(length.argmin())]]),
                remedy="check the size and displacement columns",
            )
        columns.append(length)
    lengths = np.column_stack(columns)
    resting = rest_rows(lengths[:, 0], lengths[:, 1])
    return lengths / lengths[:resting].mean(axis=0), assumptions
