"""CellScale BioTester exports: sets, numbered phases, rake distance, tracked points."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.columns import Columns, Header, Source, parse_columns
from biaxbayes.machines.cycles import Cycle
from biaxbayes.machines.readings import ask_about_jumps, ask_about_signs
from biaxbayes.machines.record import Record, outside
from biaxbayes.specimens.protocol import rest_rows
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import Table

PHASE = re.compile(r"\s*(\d+)\s*-\s*(\w+)")
PHASES = ("stretch", "hold", "recover")


def records(table: Table, choice: Choice, header: Header) -> list[Record]:
    """The record of each selected set of a BioTester export, with its cycles."""
    index, wanted = table.by_stem("setname"), tuple(choice.sets)
    sets = np.full(table.rows, "") if index is None else np.array(table.text(index))
    counts = Counter(sets.tolist())
    if [*counts] == [""] and wanted:
        raise table.error("no column 'SetName', so the file has no sets", table.listing)
    for name in wanted if wanted != ("all",) else ():
        if name not in counts:
            raise table.error(f"no set {name[:40]!r}", f"sets are {', '.join(counts)[:200]}")
    if not wanted and len(counts) > 1:
        gives = {f"sets={name}": f"{count} rows" for name, count in counts.items()}
        gives["sets=all"] = "each a protocol"
        raise Question(f"holds {len(counts)} sets", gives, file=table.path)
    chosen = dict.fromkeys(counts if wanted in ((), ("all",)) else wanted)
    left = [f"{name} ({count} rows)" for name, count in counts.items() if name not in chosen]
    notes = [f"sets left out: {', '.join(left)}"] if left else []
    return [
        _record(table.without(np.flatnonzero(sets != name), *notes), name, choice, header)
        for name in chosen
    ]


def recognises(table: Table, choice: Choice) -> bool:
    """True if a sheet is an export of a BioTester."""
    return table.by_stem("cycle") is not None or table.by_stem("xforce") is not None


def _phases(table: Table) -> tuple[np.ndarray, np.ndarray]:
    """Number of the cycle and lower-case name of the phase of each row."""
    index = table.by_stem("cycle")
    if index is None:
        problem = "no column 'Cycle', so this is not a BioTester export"
        raise table.error(problem, f"use `machine=generic` with `columns`; {table.listing}")
    numbers, phases = [], []
    for row, cell in enumerate(table.text(index)):
        match = PHASE.match(cell)
        if match is None:
            remedy = "a BioTester writes 1-Preload, 1-Stretch, 1-Hold, 1-Recover"
            problem = f"{cell[:30]!r} is not a phase of a cycle"
            raise table.error(problem, remedy, column=index, row=row)
        numbers.append(match[1].lstrip("0") or "0")
        phases.append(match[2].lower())
    return np.array(numbers), np.array(phases)


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
        mine = rows[numbers[rows] == label]
        stretch, hold, recover = (mine[phases[mine] == phase] for phase in PHASES)
        before = rows[rows < stretch[0]]
        stretching = np.flatnonzero(phases[before] != "rest")
        rest = before[stretching[-1] + 1 :] if stretching.size else before
        # rest rows before a cycle are its mounted state
        cycles.append(Cycle(label, np.concatenate([rest, stretch]), hold, recover))
    return cycles


def _record(table: Table, name: str, choice: Choice, header: Header) -> Record:
    """Convert a set; stretches are those of tracked points if there are any."""
    numbers, phases = _phases(table)
    reasons = outside(table.lines, choice.rows, table.path)
    rows = np.flatnonzero(reasons == "")
    cycles = _cycles(table, numbers, phases, name, rows)
    chosen = next((c for c in cycles if c.label == choice.cycles), cycles[-1])
    start = chosen.rows("unloading" if choice.branch == "unloading" else "loading")
    points = _tracked_points(table, start, required=choice.stretch_from == "tracked")
    gradient: np.ndarray | None = None
    read = _directions(table, choice, rakes=points is None)
    if points is None or choice.stretch_from == "rake":
        source, note = "Size_um", "stretch from the rakes, not from the tissue"
        stretch = _rake_stretch(table, rows, start, read)
    else:
        source, note = "tracked points", f"stretch from {points.shape[1]} tracked points"
        complete = np.isfinite(points).all(axis=(1, 2))
        reasons[rows[~complete[rows]]] = "points not tracked"
        gradient = _deformation_gradient(points, start[complete[start]], table)
        stretch = np.sqrt((gradient**2).sum(axis=1))  # |F e_x| and |F e_y|
    for phase in set(phases[rows]) - {*PHASES, "rest"}:
        reasons[rows[phases[rows] == phase]] = f"phase {phase}"
    wanted, sources = parse_columns(choice.columns), dict[str, Source]()
    for target in (t for t in wanted if t not in ("force_x_N", "force_y_N")):
        problem = f"`columns`: {target} is not read from a column of a BioTester export"
        raise table.error(problem, "leave it out, or use `machine=generic` for all columns")
    for target, axis in ((f"force_{axis}_N", axis.upper()) for axis in read):
        index = table.by_stem(f"{axis.lower()}force")
        if index is None:
            raise table.error(f"no column '{axis}Force_mN'", table.listing)
        sources[target] = Columns(table, {target: table.names[index]} | wanted, header).said(target)
    force = np.zeros((table.rows, 2))
    for target, origin in sources.items():
        force[:, "xy".index(target[6])] = origin.values(table, rows, header)
    columns = [
        f"{axis.upper()}{of}" if axis in read else ""
        for of in (f" {source}", "Force")
        for axis in "xy"
    ]
    record = Record(
        name=name,
        path=table.path,
        lines=table.lines,
        stretch=stretch,
        load=force,
        time_s=_quantity(table, "time", "time", rows),
        gradient=gradient,
        columns=tuple(columns),
        experiment=choice.experiment,
        loads="force",
        cycles={name: [Cycle(c.label, *(r[reasons[r] == ""] for r in c.parts)) for c in cycles]},
        reasons=reasons,
        notes=(*table.notes, note),
        assumptions=tuple(f"{t} = {s}" for t, s in sources.items() if s.computed),
    )
    taken = np.sort(np.concatenate([c.rows("both") for c in record.cycles[name]]))
    if choice.rows is None:
        ask_about_jumps(record, taken)
    ask_about_signs(record, taken, sources)
    return record


def _directions(table: Table, choice: Choice, *, rakes: bool) -> str:
    """Directions that are read; asks where the file has one only."""
    if not choice.experiment.is_mounted:
        raise table.error(f"a BioTester tests no {choice.test}s", "leave out `test`")
    stems = ("force", "size") if rakes else ("force",)
    having = [axis for axis in "xy"
              if all(table.by_stem(axis + stem) is not None for stem in stems)]  # fmt: skip
    if choice.test is None and len(having) == 1:
        other = "XY"[having == ["x"]]
        lacking = "Force_mN" if table.by_stem(f"{other.lower()}force") is None else "Size_um"
        gives = {f"test=strip {having[0]}": f"a strip pulled along {having[0]}"}
        raise Question(f"no column '{other}{lacking}'; {table.listing}", gives, file=table.path)
    return "".join("xy"[k] for k in choice.experiment.axes)


def _tracked_points(table: Table, start: np.ndarray, *, required: bool) -> np.ndarray | None:
    """Positions of tracked points, shape (n, points, 2), NaN where one is lost."""
    pairs = []
    for number in range(1, 100):
        x, y = table.by_stem(f"x{number}"), table.by_stem(f"y{number}")
        if x is None or y is None:
            break
        pairs.append([table.sparse_numbers(x), table.sparse_numbers(y)])
    if len(pairs) >= 3:
        points = np.moveaxis(np.array(pairs), 2, 0)
        # Trackers write 0, 0 for a point that they lost.
        points[(points == 0.0).all(axis=2)] = np.nan
        if np.isfinite(points[start]).all(axis=(1, 2)).sum() >= 5:  # rows with all points
            return points
    if required:
        problem = "no tracked points X1, Y1, X2, Y2, X3, Y3 ... in these rows"
        raise table.error(problem, f"use `stretch_from=rake`; {table.listing}")
    return None


def _deformation_gradient(points: np.ndarray, start: np.ndarray, table: Table) -> np.ndarray:
    """In-plane gradient (n, 2, 2) of points by least squares from the rest of the rows `start`."""
    reference = points[start[0]]
    for _ in range(2):
        X = reference - reference.mean(axis=0)
        metric = X.T @ X
        if np.linalg.cond(metric) > 1e6:
            remedy = "use `stretch_from=rake`"
            raise table.error("the tracked points lie on one line", remedy, row=start[0])
        x = points - points.mean(axis=1, keepdims=True)
        # x = F X for every point, in the least-squares sense: F = (sum x X^T) (sum X X^T)^-1
        gradient = np.einsum("nmi,mj->nij", x, X) @ np.linalg.inv(metric)
        resting = rest_rows(gradient[start, 0, 0], gradient[start, 1, 1])
        reference = points[start[:resting]].mean(axis=0)
    return gradient


def _quantity(table: Table, stem: str, quantity: str, rows: np.ndarray) -> np.ndarray | None:
    """A column in N, mm or s, which has to be readable in some rows; None where there is none."""
    index = table.by_stem(stem)
    if index is None:
        return None
    unit = table.unit(index)
    if unit is None or unit.quantity != quantity:
        problem = f"the unit of {table.names[index]!r} is not clear"
        remedy = f"name it like XForce_mN or XSize_um; {table.listing}"
        raise table.error(problem, remedy, column=index)
    return table.values(index, rows) * unit.factor


def _rake_stretch(table: Table, rows: np.ndarray, start: np.ndarray, read: str) -> np.ndarray:
    """Stretches from the distance of the rakes; one in a direction that is not read."""
    lengths = np.ones((table.rows, 2))
    for axis in read:
        size = _quantity(table, f"{axis}size", "length", rows)
        if size is None:
            problem = f"no column '{axis.upper()}Size_um', so the distance of the rakes is unknown"
            raise table.error(problem, table.listing)
        moved = _quantity(table, f"{axis}displacement", "length", rows)
        # XSize is the rake distance at every moment, or that at the start
        at_start = moved is not None and np.ptp(size[rows]) == 0.0
        lengths[:, "xy".index(axis)] = size + moved if at_start else size
    resting = rest_rows(lengths[start, 0], lengths[start, 1])
    return np.asarray(lengths / lengths[start[:resting]].mean(axis=0))
