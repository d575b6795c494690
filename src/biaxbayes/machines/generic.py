"""Any table of a test, by a map of its columns: ``stretch_x=F11,piola_x_kPa=P11_kPa``."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.experiments.experiment import Column
from biaxbayes.machines.biotester import PHASE
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.columns import (
    IGNORE,
    OF_AXES,
    SHEAR,
    TARGETS,
    Columns,
    Header,
    Source,
    names_needed,
    parse_columns,
    side_by_side,
)
from biaxbayes.machines.cycles import (
    TOLERATED_FALL,
    Cycle,
    cut,
    quieter_path,
    scatter_of,
    what_it_does,
)
from biaxbayes.machines.readings import (
    ask_about_falls_of_one,
    ask_about_jumps,
    ask_about_signs,
    ask_about_steps,
)
from biaxbayes.machines.record import Record, outside
from biaxbayes.specimens.keys import KEYS
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import Table
from biaxbayes.text_files import first_few

JOINS = {
    "join=time": "stretches are interpolated at the times of the loads",
    "join=stretch": "curves of one ratio, each load over the stretch of its direction",
}
"""How tables of their own time or length may belong together."""
LEAST_JOINED = 5
"""Rows of a part that is joined to another."""
LEAST_OVERLAP = 0.3
"""Duration of a part over that of the other, below which their units are asked about."""
ENDS_EARLY = 2
"""Rows by which a column may end before the others."""
SMALL_TEST = 0.01
"""Change of the stretches that no test is made for."""
SHOWN_ROWS = 3
"""Rows that the account shows before and after a source."""
STARTS = {True: (0.4, 2.5), False: (0.4, 1.8)}
"""Stretches that a test starts at, by whether they are of a tube: an artery in place is up to twice
as long as one cut out."""


def records(table: Table, choice: Choice, header: Header) -> list[Record]:
    """The record of a table, with the cycles of each of its protocols."""
    wanted = wanted_of(choice)
    protocols = side_by_side(table, wanted) or {"": (wanted, {})}
    found = []
    for protocol, (mine, starred) in protocols.items():
        try:
            found.append(replace(_record(table, mine, choice, header), name=protocol))
        except Question as question:
            question.rename(starred, assumed=True)  # an answer holds for all protocols
            raise
    return found


def _record(table: Table, wanted: Mapping[str, str], choice: Choice, header: Header) -> Record:
    """The record of the columns of one protocol, or of all."""
    sources = Columns(table, wanted, header, choice.test).sources()
    ignored = [table.column(name) for name in wanted.get(IGNORE, "").split("\n") if name]
    if choice.join is None:
        _ask_about_times(table, sources, ignored)
    reasons = _left_out(table, sources, choice)
    rows = np.flatnonzero(reasons == "")
    values = {t: s.values(table, rows, header) for t, s in sources.items() if s.unit is not None}
    part = Part(table, sources, rows, values)
    record = _of_values([part], values, reasons, choice, header)
    return _with_cycles(record, _labels(table, sources, choice), sources, choice)


def wanted_of(choice: Choice) -> dict[str, str]:
    """Sources by target, with columns that separate specimens and protocols."""
    wanted = parse_columns(choice.columns)
    if choice.specimen_by is not None:
        wanted["specimen"] = choice.specimen_by
    if choice.protocols_by not in (None, "ratio", "load-ratio", "level", "none"):
        wanted["protocol"] = choice.protocols_by
    return wanted


def names_of(choice: Choice) -> list[list[str]]:
    """For each column that is read the names that it may have."""
    return names_needed(v for k, v in wanted_of(choice).items() if k != IGNORE)


def recognises(table: Table, choice: Choice) -> bool:
    """True if a sheet has any column of the map."""
    wanted = wanted_of(choice)
    names = [name for names in names_needed(wanted.values()) for name in names]
    has_some = any(map(table.has_column, names)) or bool(side_by_side(table, wanted))
    return not choice.columns or has_some


def _labels(table: Table, sources: Mapping[str, Source], choice: Choice) -> dict[str, np.ndarray]:
    """Protocol and cycle of each row, from columns of labels, or from lines that repeat names."""
    columns = {t: sources[t].indices[0] for t in ("protocol", "cycle") if t in sources}
    labels = {t: np.array(table.labels(i, choice.fill_labels)) for t, i in columns.items()}
    if any(map(PHASE.fullmatch, labels.get("cycle", ()))) and "cycle" not in wanted_of(choice):
        text = sources["cycle"].text
        gives = {f"columns=ignore={text}": "cycles are cut from the curves",
                 f"columns=cycle={text}": "each label is a cycle"}  # fmt: skip
        problem = f"{text!r} has phases of cycles, such as {str(labels['cycle'][-1])!r}, as a "
        problem += "BioTester writes them for `machine=biotester`"
        raise Question(problem, gives, file=table.path)
    if table.blocks and choice.blocks is None:
        counts = Counter(table.blocks)
        shown = first_few([f"{n}: {count} rows" for n, count in counts.items()], 6)
        gives = {"blocks=protocols": "each a protocol", "blocks=cycles": "cycles of one",
                 "blocks=record": "one record that goes on"}  # fmt: skip
        problem = f"the names are repeated, which begins {len(counts)} blocks ({shown})"
        raise Question(problem, gives, file=table.path)
    if table.blocks and choice.blocks != "record":
        labels[str(choice.blocks).removesuffix("s")] = np.array([str(n) for n in table.blocks])
    return labels


def _left_out(table: Table, columns: Mapping[str, Source], choice: Choice) -> np.ndarray:
    """Why each row is left out before anything is converted: specimen, lines, missing readings."""
    reasons = outside(table.lines, choice.rows, table.path)
    reasons[table.hidden] = "hidden"
    if "specimen" in columns:
        labels = np.array(table.labels(columns["specimen"].indices[0], choice.fill_labels))
        counts = Counter(labels.tolist())
        if choice.specimen not in counts and len(counts) > 1:
            gives = {f"specimen={name}": f"{count} rows" for name, count in counts.items()}
            other = f", and none is named {choice.specimen[:40]!r}" if choice.specimen else ""
            raise Question(f"holds several specimens{other}", gives, file=table.path)
        if len(counts) > 1:
            reasons[(labels != choice.specimen) & (reasons == "")] = "another specimen"
    indices = [i for s in columns.values() if s.unit is not None for i in s.indices]
    filled = [np.array([*map(bool, table.text(i))]) for i in indices]
    reasons[~np.any(filled, axis=0) & (reasons == "")] = "no reading"
    lacking = table.lacking(indices, np.flatnonzero(reasons == ""), drop=choice.drop_missing)
    reasons[lacking] = "a reading is missing"
    return reasons


def _with_cycles(
    record: Record, labels: Mapping[str, np.ndarray], sources: Mapping[str, Source], choice: Choice
) -> Record:
    """A record with the cycles of its protocols; asks about readings that may not be of it."""
    rows = np.flatnonzero(record.reasons == "")
    protocols = labels.get("protocol", np.full(record.lines.size, ""))
    of_each = {name: rows[protocols[rows] == name] for name in dict.fromkeys(protocols[rows])}
    for of_protocol in of_each.values() if choice.rows is None else ():
        ask_about_jumps(record, of_protocol)
        ask_about_steps(record, of_protocol)
    ask_about_signs(record, rows, sources)
    for name, of_protocol in of_each.items():
        cycles = _cycles(record, of_protocol, labels.get("cycle"))
        if not cycles:
            record.leave_out(of_protocol, f"protocol {name} without a loading branch")
            continue
        record.cycles[name] = cycles
        if choice.rows is None:
            ask_about_falls_of_one(record, of_protocol, cycles)
    if not record.cycles:
        stretch, load = record.pulled(rows)
        does = what_it_does(quieter_path(stretch, load))
        back = 0 if record.time_s is None else int((np.diff(record.time_s[rows]) < 0.0).sum())
        if back > 2:
            does = f"the time runs backwards in {back} of {rows.size} rows"
        problem, row = f"no loading branch of five rows: {does}", int(record.lines[rows[0]])
        remedy = "check the columns and their signs, or name the rows with `rows`"
        raise InputError(problem, file=record.path, row=row, remedy=remedy)
    return record


def _cycles(record: Record, rows: np.ndarray, labels: np.ndarray | None) -> list[Cycle]:
    """Cycles of a protocol, by the labels of a column, otherwise from the curves."""
    path = np.full(record.lines.size, np.nan)
    path[rows] = quieter_path(*record.pulled(rows))
    groups = {"": rows}
    if labels is not None:
        groups = {str(k): rows[labels[rows] == k] for k in dict.fromkeys(labels[rows].tolist())}
    cycles = []
    for label, of_label in groups.items():
        back = np.zeros(1) if record.time_s is None else np.diff(record.time_s[of_label])
        found = cut(path[of_label], label, (np.flatnonzero(back < 0.0) + 1).tolist())
        for c in found[-1 if labels is not None else 0 :]:
            loading, hold, unloading = (of_label[p] for p in c.parts)
            load = record.pulled(loading)[1].sum(axis=1)
            tolerated = TOLERATED_FALL * np.ptp(load) + 6.0 * scatter_of(load)
            if unloading.size and load[-2] - load[-1] > tolerated:
                # at the peak the load has fallen already, by hysteresis
                fall = np.union1d(np.append(hold, loading[-1:]), unloading)
                loading, hold, unloading = loading[:-1], hold[:0], fall
            cycles.append(Cycle(c.label, loading, hold, unloading))
    return cycles


def _of_values(
    parts: Sequence[Part],
    values: Mapping[str, np.ndarray],
    reasons: np.ndarray,
    choice: Choice,
    header: Header,
    *notes: str,
) -> Record:
    """The record of the values of each target, in the rows of the first part's table."""
    table, rows = parts[0].table, np.flatnonzero(reasons == "")
    sources = {target: source for part in parts for target, source in part.sources.items()}
    kinds = choice.experiment.loads
    loads = next(name for name, of in kinds.items() if set(of.columns) & set(sources))
    of_loads = kinds[loads].columns
    load = np.column_stack([values.get(t, np.zeros(table.rows)) for t in of_loads])
    stretch = np.ones((table.rows, 2))
    for k, names in enumerate(OF_AXES):
        for target in (target for target in names if target in values):
            of = choice.experiment.columns.get(target)
            stretch[:, k] = _stretch(table, sources[target], values[target], rows, header, of)
    _check_per_cent(table, sources, float(np.ptp(stretch[rows], axis=0).max()))
    gradient, sheared = None, sources.keys() & SHEAR.keys()
    if sheared:
        gradient = stretch[:, :, None] * np.eye(2)
        gradient[:, 0, 1], gradient[:, 1, 0] = (values.get(target, 0.0) for target in SHEAR)
        if sheared == SHEAR.keys():
            # the stretch of a line along x is |F e_x|: a rotation of the specimen leaves it
            stretch = np.sqrt((gradient**2).sum(axis=1))
    shown = []
    for target, source in sources.items():
        text = f"{target} = {source}"
        if target in values:
            part = next(p for p in parts if target in p.sources)
            before = []
            for i in source.indices:
                name = part.table.names[i] if len(source.indices) > 1 else ""
                cells = part.table.text(i, part.rows[:SHOWN_ROWS])
                before.append(" ".join(filter(None, [name, *cells])))
            after = " ".join(f"{value:.5g}" for value in values[target][rows[:SHOWN_ROWS]])
            text += f": {', '.join(before)}{' ' if before else ''}-> {after}"
        shown.append(text)
    conflicts = [s.conflict for s in sources.values() if s.conflict]
    computed = [f"{t} = {s}" for t, s in sources.items() if s.computed]
    return Record(
        name="",
        path=table.path,
        lines=table.lines,
        stretch=stretch,
        load=load,
        time_s=values.get("time_s"),
        gradient=gradient,
        columns=tuple(
            next((sources[t].text for t in names if t in sources), "")
            for names in (*OF_AXES, *((name,) for name in of_loads))
        ),
        experiment=choice.experiment,
        loads=loads,
        cycles={},
        reasons=reasons,
        notes=(*table.notes, *shown, *notes),
        assumptions=(*conflicts, *computed, *notes),
    )


def _stretch(
    table: Table,
    source: Source,
    values: np.ndarray,
    rows: np.ndarray,
    header: Header,
    column: Column | None,
) -> np.ndarray:
    """Stretches of a target; of a length as its column of a specimen file says."""
    target, first, over = source.target, float(values[rows[0]]), ""
    if column is not None and column.follows is not None:
        for key in column.needs:
            if key not in header:
                # over a length of which the first row is 1.1
                near = column.follows({target: values[rows]}, {key: first})[0] * first / 1.1
                problem = f"{source.text!r} is a length and needs the {key}"
                gives, assumed = {f"{key}=MM": KEYS[key].meaning}, f"{key}={near:.6g}"
                raise Question(problem, gives, file=table.path, assumed=assumed)
        values = column.follows({target: values}, header)
        first = float(values[rows[0]])
        over = "".join(f" over {key} of {header[key]}" for key in column.needs)
    low, high = STARTS[bool(over)]
    if not low < first < high:
        problem = f"{target}{over} starts at {first:.4g}, and a stretch starts near 1"
        remedy = f"it is read as {source}: check the expression, or the kind of the column"
        raise table.error(problem, remedy, row=int(rows[0]))
    return values


def _check_per_cent(table: Table, sources: Mapping[str, Source], change: float) -> None:
    """Refuse strains in per cent that are too small for any test, as spreadsheets store them."""
    for i in (i for t, s in sources.items() if t.startswith("stretch") for i in s.indices):
        if change <= SMALL_TEST and "percent" in [unit.name for unit in table.units(i)]:
            problem = f"the stretches change by {change:.2%} only if {table.names[i]!r} is in per "
            remedy = "spreadsheets store 20 % as 0.2: leave the factor out of the expression if so"
            raise table.error(f"{problem}cent", remedy, column=i)


# --- columns of their own time or length ----------------------------------------------------------


class Part(NamedTuple):
    """Rows that have all readings of loads, of stretches, or of a direction."""

    table: Table
    sources: dict[str, Source]
    rows: np.ndarray
    values: dict[str, np.ndarray]  # in these rows, by target


def joined(tables: Sequence[Table], choice: Choice, header: Header) -> list[Record]:
    """The record of loads and stretches, or of x and y, that are two tables or parts of one."""
    wanted, by_time = wanted_of(choice), choice.join == "time"
    times = {"time_s": "loads", "stretch_time_s": "stretches"}
    if by_time and "time_s" in wanted and len(tables) > 1:
        wanted.setdefault("stretch_time_s", wanted["time_s"])
    of: dict[str, dict[str, str]] = {}
    for target, source in wanted.items():
        kind = "loads" if TARGETS.get(target) in ("force", "stress") else "stretches"
        name = times.get(target, kind) if by_time else target.split("_")[1][:1]
        if target != IGNORE and (by_time or target not in times):
            of.setdefault(name, {})[target] = source
    parts = {}
    for name, mine in of.items():
        table = _table_with(tables, mine)
        for target in (t for t in times if by_time and times[t] == name and t not in mine):
            _ask_for_time(table, target, name, mine)
        # lines are those of the loads: stretches of another time are in others
        lines = choice.rows if name == "loads" else None
        parts[name] = _part(Columns(table, wanted, header), mine, lines)
    expected = ("loads", "stretches") if by_time else ("x", "y")
    if set(parts) != set(expected):
        problem = f"`join={choice.join}` needs {' and '.join(expected)}"
        raise InputError(problem, remedy="name both in `columns`")
    first, second = (parts[name] for name in expected)
    if by_time:
        values, kept, note = _joined_by_time(first, second, in_doubt=choice.rows is None)
    else:
        values, kept, note = _joined_by_stretch(first, second)
    second.sources.pop("stretch_time_s", None)
    table = first.table
    reasons = np.full(table.rows, "no reading", dtype=object)
    reasons[first.rows] = np.where(kept, "", "outside the times of the stretches")
    others = outside(table.lines, choice.rows, table.path)
    reasons = np.where(others == "", reasons, others)
    whole = {t: np.full(table.rows, np.nan) for t in values}
    for target, curve in values.items():
        whole[target][first.rows] = curve
    record = _of_values([first, second], whole, reasons, choice, header, note)
    return [_with_cycles(record, {}, first.sources | second.sources, choice)]


def _table_with(tables: Sequence[Table], wanted: Mapping[str, str]) -> Table:
    """The only table that has the columns of some sources."""
    names = names_needed(wanted.values())
    having = [t for t in tables if all(any(map(t.has_column, each)) for each in names)]
    if len(having) != 1:
        listed = ", ".join(each[-1] for each in names)[:120]
        found = f"{len(having)} tables have" if having else "no table has"
        problem = f"{found} the columns {listed}"
        raise tables[0].error(problem, f"name the files and sheets; {tables[0].listing}")
    return having[0]


def _ask_for_time(table: Table, target: str, of: str, wanted: Mapping[str, str]) -> None:
    """Ask for the time of a part, the column of times before its columns first."""
    columns = [table.column(names[-1]) for names in names_needed(wanted.values())]
    first, end = min(columns), max(_last_filled(table, i) for i in columns)
    times = [i for i in times_of(table) if _last_filled(table, i) >= end - ENDS_EARLY]
    times.sort(key=lambda i: (i > first, abs(first - i)))
    gives = {f"columns={target}={table.reference(i)}": f"the time of the {of}" for i in times}
    indices = range(len(table.names)) if not times else ()
    counts = [f"columns={target}={{{table.reference(i)}}}" for i in indices
              if _counts(table.finite(i))]  # fmt: skip
    gives |= {f"{count} * FACTOR": "a count, times the seconds of each" for count in counts}
    gives[f"columns={target}=COLUMN"] = "another column"
    assumed = counts[0] if counts else ""
    problem = f"no column for {target}, the time of the {of}"
    raise Question(problem, gives, file=table.path, assumed=assumed)


def _counts(values: np.ndarray) -> bool:
    """Whether whole numbers increase evenly, as frames do."""
    steps = np.diff(values)
    even = steps.size > 1 and steps[0] > 0.0 and bool(np.all(steps == steps[0]))
    return even and bool(np.all(values == np.round(values)))


def _part(columns: Columns, mine: Mapping[str, str], lines: str | None) -> Part:
    """The rows of a table that have readings of some sources."""
    table, sources = columns.table, {t: columns.said(t) for t in mine}
    numbers = [table.sparse_numbers(i, texts=True) for s in sources.values() for i in s.indices]
    inside = outside(table.lines, lines, table.path) == ""
    rows = np.flatnonzero(np.isfinite(numbers).all(axis=0) & inside)
    ends = {t: max((_last_filled(table, i) for i in s.indices), default=table.rows)
            for t, s in sources.items()}  # fmt: skip
    early = [t for t in ends if t.endswith("time_s") and ends[t] < max(ends.values()) - ENDS_EARLY]
    for target in early:
        problem = f"{sources[target].text!r} ends in line {table.lines[ends[target]]}, before what "
        problem += "was read at that time: is it the time of other columns?"
        raise table.error(problem, f"time_s is that of the loads; {table.listing}")
    if rows.size < LEAST_JOINED:
        problem = f"{rows.size} rows have all of {', '.join(mine.values())[:100]}"
        raise table.error(problem, table.listing)
    values = {t: s.values(table, rows, columns.header)[rows] for t, s in sources.items()}
    return Part(table, sources, rows, values)


def _joined_by_time(
    loads: Part, stretches: Part, *, in_doubt: bool
) -> tuple[dict[str, np.ndarray], np.ndarray, str]:
    """Loads as they are, with stretches at their times; none outside the times of the stretches."""
    times, at = stretches.values["stretch_time_s"], loads.values["time_s"]
    extents = [float(np.ptp(at)), float(np.ptp(times))]
    if in_doubt and min(extents) < LEAST_OVERLAP * max(extents):  # as in another unit
        first, second = (f"{t.min():g} to {t.max():g} s" for t in (at, times))
        problem = f"the times of the loads, {first}, and of the stretches, {second}, differ much "
        problem += "in length: are both in the unit that is read?"
        gives = {"columns=stretch_time_s=EXPRESSION": "such as {Frame} * 0.1, in seconds",
                 "rows=all": "they are in the same unit"}  # fmt: skip
        raise Question(problem, gives, file=loads.table.path, likely=False)
    backward = np.diff(times) <= 0.0, np.diff(at) < 0.0
    for part, of, back in zip((stretches, loads), ("stretches", "loads"), backward, strict=True):
        if back.any():
            row = int(part.rows[np.argmax(back) + 1])
            remedy = "give a time that goes on, such as {Frame} * 0.1, or one run at a time"
            remedy += ", the loads' by `rows`" * (of == "loads")
            raise part.table.error(f"the time of the {of} does not increase", remedy, row=row)
    inside = (at >= times[0]) & (at <= times[-1])
    if inside.sum() < LEAST_JOINED:
        problem = f"times of the loads, {at[0]:g} to {at[-1]:g} s, and of the stretches, "
        problem += f"{times[0]:g} to {times[-1]:g} s, do not overlap"
        problem += f" but in {inside.sum()} rows" * bool(inside.any())
        raise loads.table.error(problem, "shift one of them, as time_s={Time (s)} - 12.5")
    note = f"{times.size} stretches interpolated at the times of {int(inside.sum())} loads"
    interpolated = {t: np.interp(at, times, curve) for t, curve in stretches.values.items()}
    return loads.values | interpolated, inside, note


def _joined_by_stretch(x: Part, y: Part) -> tuple[dict[str, np.ndarray], np.ndarray, str]:
    """Curves of x and y, in proportion from their first to their largest stretch."""
    stretch, other = x.values["stretch_x"], y.values["stretch_y"]
    order = np.argsort(other)
    # both go on in proportion: (ly - ly0) / (ly1 - ly0) = (lx - lx0) / (lx1 - lx0)
    at = other.min() + (stretch - stretch.min()) / np.ptp(stretch) * np.ptp(other)
    curves = {t: np.interp(at, other[order], curve[order]) for t, curve in y.values.items()}
    note = "the curve in y is interpolated at the rows of x, both stretches in proportion"
    return x.values | curves, np.ones(at.size, dtype=bool), note


def _ask_about_times(table: Table, sources: Mapping[str, Source], ignored: Sequence[int]) -> None:
    """Ask whether rows belong together where columns have their own times, or end early."""
    ends = {}
    for target, source in sources.items():
        for i in source.indices if source.unit is not None and target not in SHEAR else ():
            ends[source.text] = _last_filled(table, i)
    short = [k for k, end in ends.items() if end < max(ends.values()) - ENDS_EARLY]
    times = times_of(table)
    readings = {s.indices[0] for s in sources.values() if s.indices and TARGETS[s.target] != "time"}
    # times that stand before all readings are of the same rows
    same = [i for i in times if i < min(readings, default=0)] or times[:1]
    curves = {i: table.sparse_numbers(i, texts=True) for i in times}
    copies = [
        i for i in times
        if any(np.array_equal(curves[k], curves[i], equal_nan=True) for k in same)
    ]  # fmt: skip
    own = [i for i in times if i not in (*same, *ignored, *copies)]
    if not own and not short:
        return
    gives = {k: v for k, v in JOINS.items() if times or k != "join=time"}
    gives["join=rows"] = "cells of a row belong together"
    if short:
        line = table.lines[min(ends[k] for k in short)]
        what = f"{first_few([repr(k) for k in short], 4)} end in line {line}, before the other "
        what += "columns: rows may not belong together"
    else:
        gives[f"columns={IGNORE}={table.reference(own[0])}"] = "nothing is read at that time"
        other = next(i for i in times if i != own[0])
        names = " and ".join(repr(table.names[i]) for i in sorted((other, own[0])))
        what = f"{names} are two times: rows may not belong together"
    raise Question(what, gives, file=table.path)


def _last_filled(table: Table, index: int) -> int:
    """The last row in which a column has a number; the number of rows without one."""
    filled = np.flatnonzero(np.isfinite(table.sparse_numbers(index, texts=True)))
    return int(filled[-1]) if filled.size else table.rows


def times_of(table: Table) -> list[int]:
    """Columns of times: increasing numbers with a unit of time, or that name."""
    found = []
    for index, name in enumerate(table.names):
        unit = next((u.quantity for u in table.units(index)), "")
        named = re.match(r"(time|zeit|t)(?![a-z])", name.lower())
        values = table.finite(index) if unit == "time" or (named and not unit) else np.zeros(0)
        if values.size > 2 and np.all(np.diff(values) >= 0.0) and np.ptp(values) > 0.0:
            found.append(index)
    return found
