"""CellScale BioTester exports: sets, numbered phases, rake distance, tracked points."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.cycles import RecordedCycle, chosen_number, cycle_label, settling
from biaxbayes.machines.gauge import Gauge
from biaxbayes.machines.recording import Recording
from biaxbayes.specimens.protocol import rest_rows
from biaxbayes.tables.table import Table

PHASE = re.compile(r"\s*(\d+)\s*-\s*(\w+)")
ENOUGH_TRACKED = 5
"""Rows in which all points are tracked, at least."""


def recordings(table: Table, choice: Choice, gauge: Gauge) -> list[Recording]:
    """Take the branch of a cycle from each wanted set of a BioTester export.

    The columns are ``Cycle`` (1-Preload, 1-Stretch, 1-Hold, 1-Recover ...), ``XForce_mN``,
    ``YForce_mN``, and the rake (``XSize_um``, ``XDisplacement_um`` ...) or tracked points (``X1``,
    ``Y1`` to ``X4``, ``Y4``); optionally ``SetName`` and ``Time_S``. Cycles are counted in each
    set. A branch is the Stretch phase, the Recover phase turned round, or both; Hold, Preload and
    Rest stay out. Columns, sets, cycles or points that are missing or not clear are refused.
    """
    phases = _phases(table)
    wanted, left_out = _sets(table, choice.sets)
    notes = []
    if left_out:
        notes = [f"sets left out: {', '.join(left_out)} (--set NAME or --set all takes them)"]
    taken = []
    for name, rows in wanted:
        cycles = _cycles(table, phases, name, rows)
        labels = [cycle.label for cycle in cycles]
        number = chosen_number(choice.cycle, labels, table)
        curves = Curves.read(table, _branch(table, cycles[number], choice.branch), choice, gauge)
        read, assumptions = [*table.notes, *curves.notes], list(curves.assumptions)
        if number > 0:
            last_two = [
                Curves.read(table, _branch(table, cycle, "loading"), choice, gauge)
                for cycle in cycles[number - 1 : number + 1]
            ]
            words, settled = settling(*((c.stretch, c.load) for c in last_two))
            if settled:
                read.append(words)
            else:
                assumptions.append(f"{name}: {words}" if name else words)
        time = _quantity(table, "time", "time", curves.rows)
        taken.append(
            Recording(
                name=name,
                source=table.path.name + (f", set {name}" if name else ""),
                stretch=curves.stretch,
                load=curves.load,
                columns=(f"X {curves.source}", f"Y {curves.source}", "XForce", "YForce"),
                stress_pair="force",
                time_s=None if choice.branch == "unloading" else time,
                gradient=curves.gradient,
                lines=table.lines[curves.rows],
                rows_in_file=table.rows,
                cycle=cycle_label(labels, number),
                branch=choice.branch,
                notes=(*read, *notes),
                assumptions=tuple(assumptions),
            )
        )
    return taken


def is_other_table(table: Table, choice: Choice) -> bool:
    """Whether a sheet is no export of a BioTester."""
    return table.by_stem("cycle") is None and table.by_stem("xforce") is None


# --- sets and phases ------------------------------------------------------------------------------


def _phases(table: Table) -> np.ndarray:
    """Number and lower-case name of the phase of each row, shape (n, 2)."""
    index = table.by_stem("cycle")
    if index is None:
        raise InputError(
            "no column 'Cycle', so no BioTester export",
            file=table.path,
            remedy=f"use `machine=generic` with `columns`; {table.listing}",
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
            raise InputError(
                "no column 'SetName', so no sets", file=table.path, remedy=table.listing
            )
        return [("", np.arange(table.rows))], []
    labels = np.array(table.text(index))
    names = list(dict.fromkeys(labels.tolist()))
    wanted = tuple(names) if wanted == ("all",) else wanted or (names[-1],)
    for name in wanted:
        if name not in names:
            raise InputError(
                f"no set {name[:40]!r}", file=table.path, remedy=f"found {', '.join(names)[:200]}"
            )
    taken = [(name, np.flatnonzero(labels == name)) for name in wanted]
    return taken, [name for name in names if name not in wanted]


def _cycles(table: Table, phases: np.ndarray, name: str, rows: np.ndarray) -> list[RecordedCycle]:
    """Cycles of a set that have a Stretch phase."""
    numbers, phase = phases[rows].T
    labels = dict.fromkeys(numbers[phase == "stretch"].tolist())
    if not labels:
        raise InputError(
            f"no Stretch phase in set {name!r}" if name else "no Stretch phase",
            file=table.path,
            column="Cycle",
            remedy=f"found {', '.join(sorted(set(phase.tolist())))[:80]}",
        )
    return [
        RecordedCycle(
            label,
            rows[(numbers == label) & (phase == "stretch")],
            rows[(numbers == label) & (phase == "recover")],
        )
        for label in labels
    ]


def _branch(table: Table, cycle: RecordedCycle, branch: str) -> np.ndarray:
    """Rows of a branch of a cycle, two at least."""
    rows = cycle.rows(branch)
    if rows.size < 2:
        raise InputError(
            f"{rows.size} rows in the {branch} branch of cycle {cycle.label}",
            file=table.path,
            remedy="choose another `cycle` or `branch`",
        )
    return rows


# --- stretches and forces of some rows ------------------------------------------------------------


@dataclass(frozen=True)
class Curves:
    """Stretches and forces of some rows, and where the stretches are from."""

    rows: np.ndarray
    stretch: np.ndarray
    load: np.ndarray
    gradient: np.ndarray | None
    source: str
    notes: tuple[str, ...]
    assumptions: tuple[str, ...] = ()

    @classmethod
    def read(cls, table: Table, rows: np.ndarray, choice: Choice, gauge: Gauge) -> Curves:
        """Stretches of the tracked points where there are any, else of the rake, unless chosen."""
        points = _tracked_points(table, rows, required=choice.stretch_from == "tracked")
        if points is None or choice.stretch_from == "rake":
            stretch, assumptions = _rake_stretch(table, rows, gauge)
            notes: tuple[str, ...] = ("stretch from the rakes, not from the tissue",)
            load = _forces(table, rows)
            return cls(rows, stretch, load, None, "Size_um", notes, tuple(assumptions))
        complete = np.isfinite(points).all(axis=(1, 2))
        notes = (f"stretch from {points.shape[1]} tracked points",)
        if not complete.all():
            notes += (f"{int((~complete).sum())} rows without tracked points left out",)
        rows = rows[complete]
        gradient = _deformation_gradient(points[complete], table, rows)
        stretch = np.column_stack([gradient[:, 0, 0], gradient[:, 1, 1]])
        return cls(rows, stretch, _forces(table, rows), gradient, "tracked points", notes)


def _tracked_points(table: Table, rows: np.ndarray, *, required: bool) -> np.ndarray | None:
    """Positions of tracked points, shape (n, points, 2), NaN where one is lost."""
    pairs = []
    for number in range(1, 100):
        x, y = (table.by_stem(f"{axis}{number}") for axis in "xy")
        if x is None or y is None:
            break
        pairs.append([table.sparse_numbers(x, rows), table.sparse_numbers(y, rows)])
    if len(pairs) >= 3:
        points = np.moveaxis(np.array(pairs), 2, 0)
        # Trackers write 0, 0 for a point that they lost.
        points[(points == 0.0).all(axis=2)] = np.nan
        if np.isfinite(points).all(axis=(1, 2)).sum() >= ENOUGH_TRACKED:
            return points
    if required:
        raise InputError(
            "no tracked points X1, Y1, X2, Y2, X3, Y3 ... in these rows",
            file=table.path,
            remedy=f"use `stretch_from=rake`; {table.listing}",
        )
    return None


def _deformation_gradient(points: np.ndarray, table: Table, rows: np.ndarray) -> np.ndarray:
    """In-plane deformation gradient of points by least squares, shape (n, 2, 2).

    The reference is the mean position over the rows at rest, which are determined from a first
    estimate relative to the first row.
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
    forces = []
    for axis in "XY":
        force = _quantity(table, f"{axis}force".lower(), "force", rows)
        if force is None:
            raise InputError(f"no column '{axis}Force_mN'", file=table.path, remedy=table.listing)
        forces.append(force)
    return np.column_stack(forces)


def _rake_stretch(table: Table, rows: np.ndarray, gauge: Gauge) -> tuple[np.ndarray, list[str]]:
    """Stretches by the distance of the rakes, and what had to be assumed for them."""
    columns, assumptions = [], []
    for k, axis in enumerate("XY"):
        size = _quantity(table, f"{axis}size".lower(), "length", rows)
        moved = _quantity(table, f"{axis}displacement".lower(), "length", rows)
        if size is not None:
            # XSize is the rake distance at every moment, or that at the start
            length = size if moved is None or np.ptp(size) > 0.0 else size + moved
        elif moved is not None:
            name = f"{axis}Displacement"
            first = _quantity(table, name.lower(), "length", np.array([0]))
            assert first is not None
            length, note = gauge.from_displacement(moved, float(first[0]), k, name, table.path)
            assumptions.append(note)
        else:
            raise InputError(
                f"no column '{axis}Size_um', so no rake distance",
                file=table.path,
                remedy=table.listing,
            )
        if length.min() <= 0.0:
            raise InputError(
                f"a rake distance of {length.min():g} mm in {axis.lower()}",
                file=table.path,
                row=int(table.lines[rows[int(length.argmin())]]),
                remedy="check the size and displacement columns",
            )
        columns.append(length)
    lengths = np.column_stack(columns)
    resting = rest_rows(lengths[:, 0], lengths[:, 1])
    return lengths / lengths[:resting].mean(axis=0), assumptions
